"""Specifications: what is read, off which loop, and by how much it violates its limit."""

from __future__ import annotations

import numpy as np
import pytest
from support.paper_loop import BEST_PID, G0, HLS, PERIOD_S, PPID, W1, pid

from design.closed_loop.loops import ClosedLoops
from design.closed_loop.specifications import (
    PAPER,
    QUANTITIES,
    Specification,
    compromise,
    readings,
    violations,
)
from design.errors import DesignError
from design.models.controller import one_degree_of_freedom
from design.models.plant import paper_plant
from design.models.sampling import Sampling, to_z
from design.models.transfer_function import TransferFunction
from design.robustness.loop_shaping import shaped
from design.robustness.margins import gain_margins, phase_margin

SHAPING = ClosedLoops(G0, one_degree_of_freedom(HLS.num, HLS.den), W=W1, desired=shaped(G0, W1))


def read(quantity: str, loops: ClosedLoops, at: float = 1.0) -> float:
    return float(Specification(quantity, 1.0, at).read(loops)[0])


def test_the_papers_weight_meets_the_papers_specifications() -> None:
    values = {reading.quantity: reading for reading in readings(PAPER, SHAPING)}
    assert all(reading.met for reading in values.values())
    assert values["bandwidth_rad_s"].value == pytest.approx(4.070, abs=5e-4)
    assert values["bandwidth_rad_s"].reading == "crossover of Gs"
    assert values["gain_db"].value == pytest.approx(20.24, abs=5e-3)
    assert values["gain_db"].reading == "smallest gain of Gs up to 0.4 rad/s"
    assert values["settling_s"].value == pytest.approx(1.06, abs=5e-3)
    assert violations(PAPER, SHAPING)[0] == 0.0


def test_readings_name_their_loop() -> None:
    loops = ClosedLoops(G0, pid(*BEST_PID))
    assert readings([Specification("bandwidth_rad_s", 4.0)], loops)[0].reading == "crossover of GK"


def test_every_quantity_can_be_read_and_printed() -> None:
    loops = ClosedLoops(G0, pid(*PPID))
    for quantity, kind in QUANTITIES.items():
        (reading,) = readings([Specification(quantity, 1.0, at=0.5)], loops)
        assert np.isfinite(reading.value)
        assert quantity in str(reading)
        assert kind.unit == reading.unit
        assert "{" not in reading.reading


def test_readings_of_a_sampled_loop_are_true_frequencies() -> None:
    sampling = Sampling(PERIOD_S, 1)
    loops = ClosedLoops(paper_plant().transfer_function(sampling), pid(*BEST_PID), sampling=sampling)
    G, K = to_z(loops.G, PERIOD_S), to_z(loops.K.feedback, PERIOD_S)

    def gain(omega: float) -> float:
        z = np.exp(1j * omega * PERIOD_S)
        values = [np.polyval(np.ravel(H.num), z) / np.polyval(np.ravel(H.den), z) for H in (G, K)]
        return float(abs(values[0] * values[1]))

    assert gain(read("bandwidth_rad_s", loops)) == pytest.approx(1.0, abs=1e-6)
    # 150 rad/s is 199 rad/s in the bilinear plane.
    assert read("gain_db", loops, at=150.0) == pytest.approx(20.0 * np.log10(gain(150.0)), abs=1e-6)


def test_margins_are_in_decibels_and_degrees() -> None:
    loops = ClosedLoops(G0, pid(*PPID))
    assert read("gain_margin_db", loops) == pytest.approx(20.0 * np.log10(gain_margins(loops.open)[1][0]))
    assert read("phase_margin_deg", loops) == pytest.approx(np.degrees(phase_margin(loops.open)[0]))


def test_effort_is_proportional_to_the_specified_step() -> None:
    kp, _, kd, tau_d = BEST_PID
    loops = ClosedLoops(G0, pid(*BEST_PID))
    one, tenth = read("effort_v", loops, at=1.0), read("effort_v", loops, at=0.1)
    assert one == pytest.approx(kp + kd / tau_d)
    assert tenth == pytest.approx(0.1 * one)


@pytest.mark.parametrize(
    ("quantity", "limit", "named"),
    [("overshot", 0.05, "overshoot, settling_s"), ("settling_s", 0.0, "the limit 0 s is not over 0")],
)
def test_impossible_specifications_are_refused(quantity: str, limit: float, named: str) -> None:
    with pytest.raises(DesignError, match=f"specification .?{quantity}") as refusal:
        Specification(quantity, limit)
    assert named in str(refusal.value)
    Specification("gain_db", -3.0, at=10.0)


def test_violations_are_relative_to_the_limit_and_add_up() -> None:
    loops = ClosedLoops(G0, pid(*PPID))
    settling = read("settling_s", loops)
    tight = [Specification("settling_s", settling / 2.0), Specification("bandwidth_rad_s", 1e9)]
    assert tight[0].violation(np.array([settling]))[0] == pytest.approx(1.0)
    assert violations(tight[:1], loops)[0] == pytest.approx(1.0)
    assert violations(tight, loops)[0] == pytest.approx(2.0, abs=1e-6)
    assert Specification("settling_s", 1.0).violation(np.array([np.inf, np.nan, 0.5])).tolist() == [
        100.0,
        100.0,
        0.0,
    ]


def test_a_reading_within_rounding_of_its_limit_is_met() -> None:
    loops = ClosedLoops(G0, pid(*PPID))
    settling = read("settling_s", loops)
    for limit, met in ((settling * (1.0 - 1e-9), True), (settling * (1.0 - 1e-5), False)):
        (reading,) = readings([Specification("settling_s", limit)], loops)
        assert reading.met == met


def test_an_unstable_loop_meets_no_specification() -> None:
    assert not any(reading.met for reading in readings(PAPER, ClosedLoops(G0, pid(500.0, 5.0, 0.01, 1.0))))


def test_a_crossover_that_is_never_reached_is_infinite_in_a_sampled_loop_too() -> None:
    """The gain of 5 never falls below 1; half the sampling frequency is no crossover."""
    sampling = Sampling(PERIOD_S, 0)
    five = TransferFunction(np.array([5.0]), np.array([1.0]))
    loops = ClosedLoops(five, one_degree_of_freedom(np.ones((1, 1)), np.ones((1, 1))), sampling=sampling)
    assert read("bandwidth_rad_s", loops) == np.inf


def test_a_band_beyond_half_the_sampling_frequency_is_refused() -> None:
    loops = ClosedLoops(
        paper_plant().transfer_function(Sampling(PERIOD_S)), pid(*PPID), sampling=Sampling(PERIOD_S)
    )
    with pytest.raises(DesignError, match=r"up_to_rad_s 300 is not under half the sampling .* 280\.5 rad/s"):
        read("gain_db", loops, at=300.0)


def test_the_compromise_names_what_fails_and_by_how_much() -> None:
    loops = ClosedLoops(G0, pid(*PPID))
    text = compromise("controller", {"kp": 11.013}, (), readings([Specification("settling_s", 0.5)], loops))
    assert "kp 11.01" in text
    assert "settling_s 0.8" in text
    assert "<= 0.5" in text
