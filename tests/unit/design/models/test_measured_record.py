"""A record compared with the model, against python-control's simulation; and the records that are refused."""

from __future__ import annotations

import re

import control
import msgspec
import numpy as np
import pytest
from support.constants import PERIOD_S

from design.models.measured_record import POOR_PERCENT, compare
from design.models.plant import paper_plant
from hil.core.errors import DocumentError


def record(noise_m: float = 0.0, from_sample: int = 0, offset_m: float = 0.0) -> str:
    """Return a record of the paper's plant that begins in the middle of a motion, by python-control."""
    random = np.random.default_rng(5)
    u = np.repeat(random.choice([-0.4, 0.4], 60), 10)
    t = np.arange(len(u)) * PERIOD_S
    plant = paper_plant()
    held = control.sample_system(control.tf(plant.num, plant.den), PERIOD_S, "zoh")
    y = control.forced_response(held, t, u).outputs + offset_m + noise_m * random.standard_normal(len(u))
    rows = zip(t[from_sample:], u[from_sample:], y[from_sample:], strict=True)
    return "time_s,u,y\n" + "".join(f"{a:.7f},{b},{c}\n" for a, b, c in rows)


def test_the_true_model_fits_with_any_initial_state_and_offset() -> None:
    fit = compare(paper_plant(), record(from_sample=87, offset_m=0.03), "r.csv")
    assert fit.fit_percent == pytest.approx(100.0, abs=1e-6)
    np.testing.assert_allclose(fit.model, fit.measured, atol=1e-9)
    assert fit.time_s[0] == 0.0


def test_noise_lowers_the_fit_by_its_share() -> None:
    clean, noisy = compare(paper_plant(), record(), "r"), compare(paper_plant(), record(0.002), "r")
    share = 0.002 / clean.measured.std()
    assert noisy.fit_percent == pytest.approx(100.0 * (1.0 - share), abs=10.0 * share)
    assert noisy.fit_percent < clean.fit_percent - 50.0 * share


def changed(text: str, u: float = 1.0, y: float = 1.0) -> str:
    """Return the record in other units."""
    rows = [[float(cell) for cell in line.split(",")] for line in text.splitlines()[1:]]
    return "time_s,u,y\n" + "".join(f"{row[0]},{row[1] * u},{row[2] * y}\n" for row in rows)


@pytest.mark.parametrize(
    ("changes", "warned"),
    [
        ({"y": 1000.0}, "its y is 1000 times what the model says.* y in mm, the model in m\\?"),
        ({"y": 57.2958}, "its y is 57 times what the model says.* y in degrees"),
        ({"y": -1.0}, "its y is -1 times what the model says.* the other way round"),
        ({"u": -1.0}, "its y is -1 times what the model says.* the other way round"),
        ({"u": 1000.0}, "its y is 0.001 times what the model says.* u in mV\\?"),
        ({"y": 7.0}, "its y is 7 times what the model says.* other units, or another plant\\?"),
    ],
)
def test_a_record_in_other_units_is_recognised_by_its_factor(changes: dict[str, float], warned: str) -> None:
    fit = compare(paper_plant(), changed(record(from_sample=87), **changes), "r.csv")
    assert fit.fit_percent < POOR_PERCENT
    assert re.match(f"r.csv: the model follows this record to .* % only: {warned}", fit.doubt)


def test_swapped_columns_and_another_plant_are_recognised() -> None:
    swapped = record(0.002).replace("time_s,u,y", "time_s,y,u")
    assert "are the columns swapped?" in compare(paper_plant(), swapped, "r.csv").doubt
    other = msgspec.structs.replace(paper_plant(), num=[1.0], den=[1.0, 0.5, 400.0])
    assert "another plant or axis" in compare(other, record(), "r.csv").doubt


def test_a_record_with_noise_brings_no_warning() -> None:
    assert compare(paper_plant(), record(0.002), "r.csv").doubt == ""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,u\n0,1\n", "r.csv: column y is missing"),
        ("", "r.csv: column time_s, u, y is missing"),
        ("time_s,u,y\n0,0,0\n", "r.csv: 1 rows are too few"),
        ("time_s,u,y\n" + "".join(f"{k},0,1\n" for k in range(20)), "r.csv: y never changes"),
        (
            "time_s,u,y\n" + "".join(f"{k if k < 9 else k + 3},0,{k}\n" for k in range(20)),
            "r.csv: row 11: 4 s after the row before, but the mean is",
        ),
        ("time_s,u,y\n" + "".join(f"{k},0,{k}\n" for k in range(9)) + "9,x,1\n", "r.csv: row 11: u: 'x'"),
        (
            "time_s,u,y\n" + "".join(f"{k},0,{k}\n" for k in range(9)) + "9,nan,1\n",
            "r.csv: row 11: not a finite",
        ),
    ],
)
def test_refused_with_file_and_row(text: str, message: str) -> None:
    with pytest.raises(DocumentError, match=message):
        compare(paper_plant(), text, "r.csv")
