"""Tables in other units than they are read in: the orders of magnitude of a pneumatic axis."""

from __future__ import annotations

import numpy as np
import pytest
from support.identification_data import PERIOD_S, paper_record

from design.identification.checks.unit_checks import check_units
from design.identification.findings import Kind, Severity
from design.identification.records.experiment import Experiment, Names

RECORD = paper_record(1)
U, Y = np.array(RECORD.u), np.array(RECORD.y)


def test_a_pneumatic_axis_in_si_units_is_not_mentioned() -> None:
    assert list(check_units(RECORD)) == []
    rotation = Experiment(U, 3.0 * Y / np.ptp(Y), PERIOD_S, names=Names(y_unit="rad"))
    assert list(check_units(rotation)) == []


@pytest.mark.parametrize(
    ("u", "y", "period_s", "unit", "signal", "kind", "remedy"),
    [
        (U, 1000.0 * Y, PERIOD_S, "m", "y", Kind.UNITS, "convert it to m"),
        (U, 40.0 * Y / np.ptp(Y), PERIOD_S, "rad", "y", Kind.UNITS, "if it is in degrees"),
        (1000.0 * U, Y, PERIOD_S, "m", "u", Kind.UNITS, "if it is in mV"),
        (U, Y, 1000.0 * PERIOD_S, "m", "sample time", Kind.SAMPLE_TIME, "if the times are in ms"),
        (U, Y, PERIOD_S / 1000.0, "m", "sample time", Kind.SAMPLE_TIME, "convert them to s"),
    ],
)
def test_a_factor_of_a_thousand_is_a_warning_with_figure_limit_and_remedy(
    u: np.ndarray, y: np.ndarray, period_s: float, unit: str, signal: str, kind: Kind, remedy: str
) -> None:
    (finding,) = check_units(Experiment(u, y, period_s, names=Names(y_unit=unit)))
    assert (finding.kind, finding.severity, finding.signal) == (kind, Severity.WARN, signal)
    assert f"{finding.limit:g}" in finding.text
    assert remedy in finding.remedy
