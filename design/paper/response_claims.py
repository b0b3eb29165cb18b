"""Check what the paper prints of step responses and robustness: Figs 9 to 11."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from design.closed_loop.comparison import Candidate
from design.closed_loop.specifications import PAPER
from design.models.controller import Controller
from design.paper.checked_claim import CheckedClaim, check_number, check_statement
from design.paper.evidence import Evidence
from design.synthesis import baselines
from design.synthesis.structures import STRUCTURES

_LIMITS = {specification.quantity: specification.limit for specification in PAPER}
_LOW_RAD_S, _HIGH_RAD_S = 0.01, 1000.0
"""Frequencies at which the paper's "low" and "high" are read."""


def check_responses(evidence: Evidence) -> Iterator[CheckedClaim]:
    """Check the step responses of Fig. 9 (tuning rules) and Fig. 10 (PPID and HLS)."""
    yield from _tuning_rules(evidence)
    ppid, hls = (evidence.measures[name] for name in ("PPID (20)", "HLS (18)"))
    yield check_number("Fig. 10", "overshoot of PPID", 1.0, 100.0 * ppid.overshoot, 0.5, "about", unit=" %")
    yield check_number(
        "Fig. 10", "overshoot of HLS", 0.0, 100.0 * hls.overshoot, 0.5, "none is visible", unit=" %"
    )
    yield check_number("Fig. 10", "2 % settling of HLS", 1.1, hls.settling_s, 0.06, "about", unit=" s")
    response = evidence.problem.step(evidence.candidates["PPID (20)"], 6.0)
    late_error = np.abs(response.y[0, response.time_s >= 1.1] - 1.0).max()
    yield check_number(
        "Fig. 10",
        "2 % settling of PPID",
        1.1,
        ppid.settling_s,
        0.06,
        f"about; the response is within 2 % from {ppid.settling_s:.2f} s on, and within "
        f"{100.0 * late_error:.1f} % from 1.1 s on",
        unit=" s",
        must_agree=False,
    )
    yield check_statement(
        "Fig. 10",
        "no steady-state error",
        f"PPID {100 * ppid.error:.3f} %, HLS {100 * hls.error:.3f} %",
        max(ppid.error, hls.error) < _LIMITS["error"],
        f"below {_LIMITS['error']:g}, the limit of eq. (9)",
    )


def check_robustness(evidence: Evidence) -> Iterator[CheckedClaim]:
    """Check Fig. 11: disturbance gain and the perturbations that the loop survives."""
    ppid, hls = (evidence.measures[name] for name in ("PPID (20)", "HLS (18)"))
    yield check_number(
        "Fig. 11 (c)",
        "largest gain from input disturbance",
        0.08,
        ppid.disturbance_peak,
        0.005,
        "about",
        unit=" m/V",
    )
    yield check_statement(
        "Fig. 11 (c)",
        "PPID rejects disturbances as well as HLS",
        f"peaks {ppid.disturbance_peak:.4f} and {hls.disturbance_peak:.4f} m/V",
        ppid.disturbance_peak <= 1.05 * hls.disturbance_peak,
    )
    omega = np.array([_LOW_RAD_S, _HIGH_RAD_S])
    ppid_gains, hls_gains = (
        evidence.problem.gains(evidence.candidates[name], omega) for name in ("PPID (20)", "HLS (18)")
    )
    low, high = ppid_gains.disturbance
    yield check_statement(
        "Fig. 11 (c)",
        "that gain is small at low and high frequency",
        f"{low:.2g} m/V at {_LOW_RAD_S:g} rad/s, {high:.2g} at {_HIGH_RAD_S:g}",
        bool(max(low, high) < 0.1 * ppid.disturbance_peak),
        "below a tenth of the peak",
    )
    yield check_number(
        "Fig. 11 (a)",
        "multiplicative perturbation that the loop survives at low frequency",
        1.0,
        float(1.0 / ppid_gains.complementary[0]),
        0.02,
        f"relative to the plant, at {_LOW_RAD_S:g} rad/s",
    )
    for where, ratios in (
        ("Fig. 11 (a)", ppid_gains.complementary / hls_gains.complementary),
        ("Fig. 11 (b)", ppid_gains.effort / hls_gains.effort),
    ):
        low, high = ratios
        yield check_statement(
            where,
            "HLS survives larger perturbations at high frequency, the same at low",
            f"{high:.3g} times as large at {_HIGH_RAD_S:g} rad/s, {low:.3g} at {_LOW_RAD_S:g}",
            bool(high > 1.5 and abs(low - 1.0) < 0.05),
        )


def _tuning_rules(evidence: Evidence) -> Iterator[CheckedClaim]:
    zn, tlc = (evidence.measures[name] for name in ("ZN", "TLC"))
    cycle = baselines.ultimate_cycle(evidence.plant.transfer_function())
    for name, measures, rule, expected_percent, tolerance in (
        ("ZN", zn, baselines.ziegler_nichols, 45.0, 2.0),
        ("TLC", tlc, baselines.tyreus_luyben, 10.0, 1.0),
    ):
        K = STRUCTURES["pid"].controller(np.array([rule(cycle).values]))
        other_percent = 100.0 * evidence.problem.measure(_with(K, evidence.candidates[name])).overshoot
        yield check_number(
            "Fig. 9",
            f"overshoot of {name}",
            expected_percent,
            100.0 * measures.overshoot,
            tolerance,
            "about; ultimate cycle of the loop sampled at 0.0112 s, continuous response, derivative filter "
            f"N = 10; with the ultimate cycle of the continuous loop {other_percent:.1f} %",
            unit=" %",
        )
    misses = [m.overshoot > _LIMITS["overshoot"] or m.settling_s > _LIMITS["settling_s"] for m in (zn, tlc)]
    yield check_statement(
        "Fig. 9",
        "ZN and TLC miss the specifications",
        f"overshoot {100 * zn.overshoot:.0f} and {100 * tlc.overshoot:.0f} %, "
        f"settling {zn.settling_s:.2f} and {tlc.settling_s:.2f} s",
        all(misses),
    )


def _with(controller: Controller, candidate: Candidate) -> Candidate:
    """Return a candidate with another controller; its law, which stays, has no influence on the overshoot."""
    return Candidate("", "", controller, candidate.law, {})
