"""The record beside the model: against python-control's simulation, and what is refused."""

from __future__ import annotations

import control
import numpy as np
import pytest

from design.measured import compare
from design.plant import paper_plant
from hil.errors import DocumentError

PERIOD_S = 0.0112


def record(noise_m: float = 0.0, from_sample: int = 0, offset_m: float = 0.0) -> str:
    """A record of the paper's plant, by python-control, that begins in the middle of a motion."""
    random = np.random.default_rng(5)
    u = np.repeat(random.choice([-0.4, 0.4], 60), 10)
    t = np.arange(len(u)) * PERIOD_S
    plant = paper_plant()
    held = control.sample_system(control.tf(plant.num, plant.den), PERIOD_S, "zoh")
    y = control.forced_response(held, t, u).outputs + offset_m + noise_m * random.standard_normal(len(u))
    rows = zip(t[from_sample:], u[from_sample:], y[from_sample:], strict=True)
    return "time_s,u,y\n" + "".join(f"{a:.7f},{b},{c}\n" for a, b, c in rows)


def test_the_right_model_fits_whatever_the_initial_state_and_offset() -> None:
    fit = compare(paper_plant(), record(from_sample=87, offset_m=0.03), "r.csv")
    assert fit.fit_percent == pytest.approx(100.0, abs=1e-6)
    np.testing.assert_allclose(fit.model, fit.measured, atol=1e-9)
    assert fit.time_s[0] == 0.0


def test_fit_falls_with_noise_by_its_share() -> None:
    clean, noisy = compare(paper_plant(), record(), "r"), compare(paper_plant(), record(0.002), "r")
    share = 0.002 / clean.measured.std()
    assert noisy.fit_percent == pytest.approx(100.0 * (1.0 - share), abs=10.0 * share)
    assert noisy.fit_percent < clean.fit_percent - 50.0 * share


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,u\n0,1\n", "r.csv: column y is missing"),
        ("", "r.csv: column time_s, u, y is missing"),
        ("time_s,u,y\n0,0,0\n", "r.csv: 1 rows are too few"),
        ("time_s,u,y\n" + "".join(f"{k},0,1\n" for k in range(20)), "r.csv: y never changes"),
        (
            "time_s,u,y\n" + "".join(f"{k if k < 9 else k + 3},0,{k}\n" for k in range(20)),
            "r.csv: row 11: 4 s since the row before, the mean is",
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
