"""Errors of all commands: one sentence, and the nearest option to a mistyped one."""

from __future__ import annotations

from argparse import ArgumentTypeError

import pytest

from hil.host.command_parser import CommandParser, duration, seconds


def make_parser() -> CommandParser:
    parser = CommandParser(
        prog="hil test", description="First paragraph.", epilog="Forms:\n  a:B\n  c:D\n\nEnd."
    )
    parser.add_argument("--setpoint")
    parser.add_argument("--scenario")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--bus", required=True)
    parser.add_argument("file", nargs="?")
    return parser


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--bus", "b", "--setpiont", "x"], "unknown option --setpiont; did you mean --setpoint?"),
        (["--bus", "b", "--setpiont=x"], "unknown option --setpiont; did you mean --setpoint?"),
        (["--bsu", "b"], "unknown option --bsu; did you mean --bus?"),
        (["--seat", "b"], "unknown option --seat"),
        (["--bus", "b", "--quaternion"], "unknown option --quaternion"),
        (["--bus", "b", "--seed", "1.5"], "argument --seed: '1.5' is not a whole number"),
        (["--bus", "b", "--seed", "-1s"], "argument --seed: '-1s' is not a whole number"),
        (["--bus", "b", "one", "two"], "unexpected argument 'two'"),
        (["--bus"], "argument --bus: expected one argument"),
        ([], "the following arguments are required: --bus"),
        (["--s", "1", "--bus", "b"], "ambiguous option: --s could match --setpoint, --scenario, --seed"),
    ],
)
def test_an_error_is_one_sentence(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        make_parser().parse_args(arguments)
    assert caught.value.code == 2
    assert capsys.readouterr().err == f"hil test: {said}\n`hil test --help` lists the arguments.\n"


def test_valid_arguments_are_parsed() -> None:
    options = make_parser().parse_args(["--bus", "b", "--seed", "3", "f"])
    assert (options.bus, options.seed, options.file) == ("b", 3, "f")
    for value in ("-1e-3", "-.5s", "-inf", "-nan"):
        assert make_parser().parse_args(["--bus", value]).bus == value
    assert make_parser().parse_args(["--bus", "b", "--", "--not-an-option"]).file == "--not-an-option"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.2", 0.2), ("0.2s", 0.2), ("200ms", 0.2), (" 1 s", 1.0), ("5min", 300.0), ("1h", 3600.0),
        ("1e-3", 0.001), ("-1s", -1.0),
    ],
)  # fmt: skip
def test_times(text: str, value: float) -> None:
    assert seconds(text) == pytest.approx(value)


@pytest.mark.parametrize("text", ["soon", "s", "", "1m", "1d", "nan", "infs", "1e400", "1e308h"])
def test_a_text_that_is_no_time_is_refused_with_the_units(text: str) -> None:
    with pytest.raises(ArgumentTypeError) as refused:
        seconds(text)
    assert str(refused.value) == (
        f"{text!r} is not a time; write seconds, or a number with the unit ms, s, min or h, such as 0.2s"
    )


@pytest.mark.parametrize("text", ["0", "0ms", "-1s"])
def test_a_duration_is_more_than_0(text: str) -> None:
    assert duration("1e-9") == 1e-9
    with pytest.raises(ArgumentTypeError, match="must be more than 0 s"):
        duration(text)


@pytest.mark.parametrize("columns", ["40", "80"])
def test_help_fills_paragraphs_and_keeps_indented_lines(
    columns: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    parser = CommandParser(
        prog="hil test", epilog=f"{'word ' * 40}\n{'word ' * 40}\n\nForms:\n  a:B\n  c:D\n\nEnd."
    )
    lines = parser.format_help().splitlines()
    assert all(len(line) <= int(columns) for line in lines)
    assert lines[-6:] == ["", "Forms:", "  a:B", "  c:D", "", "End."]
    assert sum(line.count("word") for line in lines) == 80
    filled = [line for line in lines if "word" in line]
    assert all(len(line) > int(columns) - 10 for line in filled[:-1])
