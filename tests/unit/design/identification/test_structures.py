"""Structures as a user writes them."""

from __future__ import annotations

import pytest

from design.errors import DesignError
from design.identification.models.structures import (
    Armax,
    Arx,
    BoxJenkins,
    ContinuousPoles,
    OutputError,
    Structure,
    parameters_of,
    parse_structure,
)


@pytest.mark.parametrize(
    ("text", "structure", "parameters"),
    [
        ("OE(1,3,1)", OutputError(1, 3, 1), 4),
        ("oe", OutputError(), 4),
        (" ARX( 2, 3, 1 ) ", Arx(2, 3, 1), 5),
        ("armax(2,2,1,1)", Armax(2, 2, 1, 1), 5),
        ("BJ(1,2,3,4,5)", BoxJenkins(1, 2, 3, 4, 5), 10),
        ("continuous", ContinuousPoles(), 4),
        ("continuous(real=0, pairs=2, zeros=1)", ContinuousPoles(0, 2, 1), 6),
        ("continuous(integrators=1, max_dead_time_s=0.05)", ContinuousPoles(1, 1, 0, 1, 0.05), 5),
    ],
)
def test_read_and_written(text: str, structure: Structure, parameters: int) -> None:
    assert parse_structure(text) == structure
    assert parse_structure(str(structure)) == structure
    assert parameters_of(structure) == parameters


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("OE(1,3)", "needs 3 whole numbers; write OE"),
        ("OE(1,3,x)", "needs 3 whole numbers"),
        ("OE(-1,3,1)", "needs 3 whole numbers"),
        ("ARMA(1,1)", "is not known"),
        ("OE[1,3,1]", "cannot be read"),
        ("OE(0,3,1)", "nb = 0; it must be at least 1"),
        ("OE(1,13,1)", "nf = 13; at most 12"),
        ("ARX(31,1,1)", "na = 31; at most 30"),
        ("continuous(poles=3)", "'poles=3' cannot be read"),
        ("continuous(real=1.5)", "'real=1.5' cannot be read"),
        ("continuous(real=0, pairs=0)", "it must be at least 1"),
        ("continuous(zeros=3)", "3 zeros with 3 poles"),
        ("continuous(integrators=2)", "at most 1 is supported"),
        ("continuous(max_dead_time_s=-1)", "max_dead_time_s -1.0 s"),
    ],
)
def test_refused(text: str, message: str) -> None:
    with pytest.raises(DesignError) as refusal:
        parse_structure(text)
    assert message in str(refusal.value)
