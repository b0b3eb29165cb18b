"""The arguments and the printed lines of ``hil identify``."""

from __future__ import annotations

import pytest
from support.identified import identified

from design.identify_command import labelled, model_lines, parser


def error_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit):
        parser().parse_args(["data.csv", *arguments])
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("unit", "advice"),
    [
        ("metre", "did you mean m?"),
        ("radians", "did you mean rad?"),
        ("radan", "did you mean rad?"),
        ("mm", "convert y: 1 mm = 0.001 m"),
        ("deg", "convert y: 1 degree = 0.0174533 rad"),
    ],
)
def test_a_unit_that_a_plant_cannot_have_is_refused_with_advice(
    unit: str, advice: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = error_of(["--unit", unit], capsys)
    assert f"'{unit}' must be m or rad" in text
    assert advice in text


def test_the_units_of_a_plant_are_taken() -> None:
    assert [parser().parse_args(["data.csv", "--unit", unit]).unit for unit in ("m", "rad")] == ["m", "rad"]


def test_a_long_finding_is_filled_to_the_width_behind_its_label() -> None:
    lines = labelled("note", " ".join(["data.mcap: y: a finding"] * 10), 80).splitlines()
    assert lines[0].startswith("note        data.mcap")
    assert all(line.startswith(" " * 12) for line in lines[1:])
    assert len(lines) > 2
    assert max(map(len, lines)) <= 80


def test_conditions_are_numbers_where_they_can_be(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["data.csv", "--condition", "load_kg=3", "--condition", "supply = low"]
    assert parser().parse_args(arguments).condition == [("load_kg", 3.0), ("supply", "low")]
    assert "'3 kg' is not KEY=VALUE, such as load_kg=3" in error_of(["--condition", "3 kg"], capsys)


def test_gain_poles_and_zeros_are_printed_with_their_intervals() -> None:
    lines = model_lines(identified(), "m")
    assert [label for label, _ in lines] == ["gain", "mode", "zero", "dead time"]
    assert all(" ± " in text for label, text in lines if label != "dead time")
