"""Terminal output: no word is cut at any width, piped output is not wrapped, and file names are no markup."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from rich.console import Console
from support.designs import plain_design, reproduction, sampled_design

from design.output import terminal
from design.output.results import WrittenDesign
from design.output.terminal import print_design, print_reproduction
from design.synthesis.procedure import Design
from design.synthesis.recommendation import recommend


def make_terminal(width: int) -> Console:
    return Console(file=io.StringIO(), width=width, force_terminal=True, no_color=True, highlight=False)


def output_of(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    text = console.file.getvalue()
    for code in ("\x1b[1m", "\x1b[0m"):
        text = text.replace(code, "")
    return text


def printed(design: Design, width: int, plant_file: Path | None = None) -> str:
    console = make_terminal(width)
    recommendation = recommend(design)
    written = WrittenDesign(Path("out/report.html"), Path("out/controller.json"), recommendation)
    print_design(console, design, written, None, plant_file)
    return output_of(console)


def words(text: str) -> set[str]:
    return set(text.split())


@pytest.mark.parametrize("width", [40, 60, 80])
def test_no_word_of_a_design_is_cut(width: int) -> None:
    """A narrow terminal shows the same words, in lines that fit, except for the command to copy."""
    for design in (plain_design(), sampled_design()):
        text = printed(design, width)
        assert words(text) == words(printed(design, 300))
        assert "…" not in text
        for line in text.splitlines():
            assert len(line.rstrip()) <= width or line.startswith("next"), line


@pytest.mark.parametrize("width", [40, 80, 120])
def test_no_word_of_the_reproduction_is_cut(width: int) -> None:
    console = make_terminal(width)
    print_reproduction(console, reproduction(), Path("out/report.html"))
    text = output_of(console)
    for claim in reproduction().claims:
        for part in (claim.where, claim.what, claim.printed, claim.computed, claim.result):
            assert words(part) <= {word.strip(",:;") for word in words(text)} | words(text), part
    assert max(len(line.rstrip()) for line in text.splitlines()) <= width


def test_piped_output_is_not_wrapped(capsys: pytest.CaptureFixture[str]) -> None:
    print_reproduction(terminal.make_console(), reproduction(), Path("out/report.html"))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + len(reproduction().claims) + reproduction().explained + 2
    for claim in reproduction().claims:
        assert any(
            all(part in line for part in (claim.where, claim.what, claim.printed, claim.computed))
            for line in lines
        ), claim.what


def test_names_and_texts_are_not_markup() -> None:
    design = plain_design()
    plant = msgspec.structs.replace(design.plant, name="[/b]", warnings=["[red]drift"])
    text = printed(replace(design, plant=plant, notes=("[/x] note",)), 80, Path("[bold]a[.json"))
    assert "warning from the plant file: plant [/b]: [red]drift" in text
    assert "not compared: [/x] note" in text
    assert "vertical=[bold]a[.json" in text


def test_a_design_that_should_not_be_run_has_no_run_command() -> None:
    text = printed(sampled_design(), 300)
    assert "plant reversed is unstable with this controller" in text
    assert "do not run this controller as it is" in text
    assert "hil run" not in text
