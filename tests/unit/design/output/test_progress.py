"""Progress bars: they name stage, margin and time left within 80 columns, and stay silent when piped."""

from __future__ import annotations

import io
import re

import pytest
import rich.progress
from rich.console import Console

from design.output import progress
from design.search.searcher import Progress

LONGEST_STAGE = "genetic algorithm, PID"


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """A terminal of 80 columns in place of stderr."""
    file = io.StringIO()
    console = Console(file=file, width=80, force_terminal=True, no_color=True)
    monkeypatch.setattr(progress, "Console", lambda **_: console)
    return file


def lines_of(screen: io.StringIO) -> list[str]:
    return re.split(r"[\r\n]+", re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "\n", screen.getvalue()))


def test_a_bar_names_stage_margin_and_time_within_80_columns(screen: io.StringIO) -> None:
    with progress.progress_bars() as on_progress:
        for k in range(1, 6):
            on_progress(LONGEST_STAGE, Progress(k, 10_000 * k, 0.1 * k), 120_000)
        on_progress("controller", Progress(1, 500, -1.0), 6000)
    lines = lines_of(screen)
    assert any(f"{LONGEST_STAGE} " in line and "ε 0.5000" in line for line in lines)
    assert any("controller" in line and "500/500" in line and "none feasible" in line for line in lines)
    assert any(re.search(r"\d s$", line.rstrip()) for line in lines), "the time that a finished stage took"
    assert not any("…" in line for line in lines)


@pytest.mark.parametrize(("total", "text"), [(1000, "95 s left"), (2000, "3 min left")])
def test_the_time_left_is_in_seconds_or_minutes(total: int, text: str) -> None:
    now_s = 0.0
    bars = rich.progress.Progress(disable=True, get_time=lambda: now_s)
    task_id = bars.add_task("stage", total=total)
    column, task = progress.TimeLeftColumn(), bars.tasks[task_id]
    assert column.render(task).plain == "", "nothing is known yet"
    for second in range(1, 6):
        now_s = float(second)
        bars.update(task_id, completed=10 * second)
    assert column.render(task).plain == text
    bars.update(task_id, total=50)
    assert column.render(task).plain == "5.0 s", "the time that the stage took"


def test_nothing_is_shown_when_piped(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.progress_bars() as on_progress:
        on_progress("controller", Progress(1, 500, 0.5), 6000)
    assert capsys.readouterr() == ("", "")
