"""Overshoot, settling and rise time of random stable loops, against the sum of their exponentials."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.constants import PERIOD_S
from support.given_responses import Modes, both, continuous_loop, readings, sampled_loop
from support.random_systems import patient


def decade(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high).map(lambda exponent: 10.0**exponent)


def signed(size: st.SearchStrategy[float]) -> st.SearchStrategy[complex]:
    return st.builds(lambda value, sign: complex(sign * value), size, st.sampled_from([-1.0, 1.0]))


real = st.tuples(decade(-3.0, 1.5).map(lambda p: complex(-p)), signed(decade(-3.0, 0.0)))
ringing = st.tuples(
    st.builds(
        lambda w, zeta: complex(-zeta * w, w * np.sqrt(1.0 - zeta**2)), decade(-1.0, 1.7), decade(-2.3, -0.02)
    ),
    st.builds(lambda size, phase: size * np.exp(1j * phase), decade(-3.0, 0.0), st.floats(-np.pi, np.pi)),
)


@st.composite
def responses(draw: st.DrawFn) -> Modes:
    modes = draw(st.lists(real, min_size=1, max_size=3)) + draw(st.lists(ringing, max_size=2))
    assume(abs(sum(residue.real for _, residue in modes)) > 0.05)
    p, r = both(modes)
    apart = np.abs(p[:, None] - p[None, :]) + np.eye(len(p)) * np.abs(p)
    # Poles that nearly coincide have enormous residues, and the given response would be rounding.
    assume((apart > 0.02 * np.abs(p)).all() and np.abs(r).max() < 20.0)
    return modes


@settings(patient, max_examples=60)
@given(responses())
def test_readings_of_continuous_loops(modes: Modes) -> None:
    loops, true = continuous_loop(modes), readings(modes)
    assume(loops.stable[0] and not true.knife_edge)
    sizes = float(np.abs(both(modes)[1]).sum())
    assert loops.overshoot[0] == pytest.approx(true.overshoot, abs=1e-4 * (1.0 + sizes))
    assert loops.settling_s[0] == pytest.approx(true.settling_s, rel=2e-3, abs=1e-5)
    assert loops.rise_s[0] == pytest.approx(true.rise_s, rel=5e-3, abs=1e-5)


@settings(patient, max_examples=60)
@given(responses())
def test_readings_of_sampled_loops(modes: Modes) -> None:
    """Only samples are read, so times are within a sample, and peaks within what a mode turns in one."""
    loops, true = sampled_loop(modes, PERIOD_S), readings(modes, PERIOD_S)
    p, r = both(modes)
    between = float((np.abs(r) * np.minimum(np.abs(p * PERIOD_S) ** 2 / 8.0, 1.0)).sum())
    assume(loops.stable[0] and not true.knife_edge and between < 2e-3)
    assert loops.overshoot[0] == pytest.approx(
        true.overshoot, abs=between + 1e-4 * (1.0 + float(np.abs(r).sum()))
    )
    period = 2.0 * np.pi / np.abs(p[np.abs(p.imag) > 0.0]).min(initial=1e9)
    assert loops.settling_s[0] == pytest.approx(true.settling_s, rel=2e-3, abs=PERIOD_S + period)
    assert loops.rise_s[0] == pytest.approx(true.rise_s, rel=5e-3, abs=2.0 * PERIOD_S)
