"""Values of a rig file are changed without touching anything else in it."""

import pytest
from support.gateway_bench import EXAMPLE_RIG as EXAMPLE

from hil.core.errors import DocumentError
from hil.core.rig import read_rig
from hil.core.rig_edit import ORIGIN, with_values

TABLE = ("axes", "vertical", "potentiometer")
VALUES = {"y_at_0v": -0.2, "y_at_10v": 0.2123456789}


def lines_changed(before: str, after: str) -> list[tuple[str, str]]:
    return [(b, a) for b, a in zip(before.splitlines(), after.splitlines(), strict=True) if b != a]


def test_the_values_change_and_comments_keep_their_places() -> None:
    edited = with_values(EXAMPLE, TABLE, VALUES, "today", "my.toml")
    header = "[axes.vertical.potentiometer]\n"
    assert f"{header}{ORIGIN}today\n" in edited
    before, after = (text.replace(f"{ORIGIN}today\n", "") for text in (EXAMPLE, edited))
    assert lines_changed(before, after) == [
        (
            "y_at_0v = -0.165                # 330 mm over 10 V",
            "y_at_0v = -0.2                  # 330 mm over 10 V",
        ),
        ("y_at_10v = 0.165", "y_at_10v = 0.212346"),
    ]
    pot = read_rig(edited, "my.toml").axes["vertical"].potentiometer
    assert (pot.y_at_0v, pot.y_at_10v) == (-0.2, 0.212346)


def test_a_second_calibration_replaces_the_comment() -> None:
    once = with_values(EXAMPLE, TABLE, VALUES, "yesterday", "my.toml")
    twice = with_values(once, TABLE, VALUES, "today", "my.toml")
    assert twice == with_values(EXAMPLE, TABLE, VALUES, "today", "my.toml")


def test_a_missing_key_is_added_and_a_file_without_a_last_line_end_works() -> None:
    text = "[axes.a.valve]\nmax_v = 9.0\n\n[ axes . a . other ] # spaces"
    edited = with_values(text, ("axes", "a", "valve"), {"centre_v": 5.01}, "today", "my.toml")
    assert edited == text.replace("]\nmax", f"]\n{ORIGIN}today\ncentre_v = 5.01\nmax")
    edited = with_values(text, ("axes", "a", "other"), {"x": 1.0}, "today", "my.toml")
    assert edited == f"{text}\n{ORIGIN}today\nx = 1.0\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "axes.a.valve = { centre_v = 5.0 }\n",
            r"there is no table \[axes\.a\.valve\] with a header of its own",
        ),
        ('[axes.a.valve]\n"centre_v" = 5.0\n', "my.toml: Cannot overwrite a value|cannot be changed safely"),
        ("[axes.a.valve]\ntext = '''\ncentre_v = 5.0\n'''\n", "cannot be changed safely"),
    ],
)
def test_other_forms_are_refused(text: str, message: str) -> None:
    with pytest.raises(DocumentError, match=message):
        with_values(text, ("axes", "a", "valve"), {"centre_v": 5.1}, "today", "my.toml")
