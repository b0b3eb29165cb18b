"""What the paper prints, each figure beside what this package computes, with a verdict that is computed too.

Kaitwanidvilai and Parnichkun, "Design of Structured Controller Satisfying H∞ Loop Shaping using Evolutionary
Optimization: Application to a Pneumatic Robot Arm". Lives here: the printed figures, how each is read where
the paper leaves that open, and its tolerance. The experiments, Figs 13 to 15, need an arm and are not here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from design.closed_loop.comparison import Candidate, Measures, Problem
from design.closed_loop.specifications import PAPER, Reading
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array
from design.models.controller import Controller
from design.models.plant import Plant
from design.models.transfer_function import TransferFunction
from design.paper.searches import PaperSearches, Runs
from design.paper.verdicts import Verdict, number, statement
from design.robustness import margins
from design.robustness.central_controller import optimal_margins
from design.robustness.loop_shaping import shaped
from design.synthesis import baselines
from design.synthesis.fixed_structure import Synthesis
from design.synthesis.structures import STRUCTURES
from design.synthesis.weight_selection import WeightSelection

W1 = TransferFunction(np.array([15.535, 6.83]), np.array([1.0, 0.001]))
"""Eq. (16)."""
EPS_OPT, HLS_EPS, PPID_EPS = 0.60149, 0.54681, 0.548
HLS = TransferFunction(
    np.array([372.3, 6714.0, 67960.0, 55790.0, 11950.0]), np.array([1.0, 40.0, 701.3, 6310.0, 2648.0, 2.641])
)
"""Eq. (18)."""
PPID = (11.013, 5.6444, 38.639, 74.162)
"""Eq. (20): kp, ki, kd, tau_d."""
PERIOD_S = 0.0112
DAMPING, MISPRINTED_DAMPING = 16.97, 16.67
"""Eq. (15), eq. (17)."""


CONVERGED_AT = 12
"""Generation after which the weight is that of eq. (16)."""
_CLEARLY = 0.75
"""Share of pairs of runs in which one search ends higher than the other."""


@dataclass(frozen=True)
class Evidence:
    """What the verdicts are computed from; candidates and their measures by name."""

    plant: Plant
    problem: Problem
    """The continuous loop with W1 of eq. (16)."""
    selecting: Sequence[Reading]
    """The specifications, read off the loop of eq. (16)."""
    searches: PaperSearches
    """What its genetic algorithm, and chance, find on many seeds."""
    best_weight: WeightSelection
    optimum: Synthesis
    candidates: Mapping[str, Candidate]
    measures: Mapping[str, Measures]


def judge(evidence: Evidence) -> tuple[Verdict, ...]:
    """Every verdict, in the paper's order."""
    parts = (_model, _weight, _loop_shaping, _synthesis, _responses, _robustness)
    return tuple(verdict for part in parts for verdict in part(evidence))


def _model(e: Evidence) -> Iterator[Verdict]:
    num = _held_output_error_model(e.plant)
    why = "OE(1,3,1) with eq. (15)'s poles and static gain, zero-order hold inverted"
    yield number("eq. (15)", "gain of the identified model", 0.47947, float(num[1]), 1e-5, why)
    yield number(
        "eq. (15)",
        "its zero",
        90.76,
        float(num[2] / num[1]),
        0.005,
        f"{why}; a term {num[0]:.2g} s² was dropped in print, an artefact of sampling, not physics",
        unit=" rad/s",
    )
    eps = {damping: _eps_opt(_with_damping(damping)) for damping in (DAMPING, MISPRINTED_DAMPING)}
    yield number(
        "eq. (17)",
        f"ε_opt with the damping term {MISPRINTED_DAMPING} of eq. (17)",
        EPS_OPT,
        eps[MISPRINTED_DAMPING],
        5e-6,
        f"{MISPRINTED_DAMPING} is a misprint of eq. (15)'s {DAMPING}, which gives {eps[DAMPING]:.6f}",
        must_agree=False,
    )


def _weight(e: Evidence) -> Iterator[Verdict]:
    G = e.plant.transfer_function()
    yield number("Sec. IV", "ε_opt of W1 (16), Appendix A", EPS_OPT, _eps_opt(G), 5e-6)
    Gs = shaped(G, W1)
    yield number(
        "Sec. IV", "crossover of the shaped plant", 4.0, float(margins.crossover(Gs)[0]), 0.1, unit=" rad/s"
    )
    met = sum(reading.met for reading in e.selecting)
    yield statement(
        "eq. (9)",
        "W1 (16) meets the specifications",
        f"{met} of {len(e.selecting)} met",
        met == len(e.selecting),
        "gain and crossover of Gs, times of the closed loop with K = W1 K∞: "
        + "; ".join(map(_short, e.selecting)),
    )
    best = e.best_weight
    at = ", ".join(f"{name} {value:.5g}" for name, value in best.parameters.items())
    yield number(
        "Fig. 6",
        "largest ε_opt that meets them",
        EPS_OPT,
        best.eps_opt,
        5e-6,
        f"eq. (16) is {100.0 * (1.0 - EPS_OPT / best.eps_opt):.1f} % short of the optimum of eq. (8) at {at}",
        must_agree=False,
    )
    genetic, random = e.searches.genetic_weights, e.searches.random_weights
    lucky = "; so the paper shows a lucky run" if genetic.reaching(0.99 * EPS_OPT) < len(genetic) / 2 else ""
    near, seeds, then = 0.99 * EPS_OPT, len(genetic), CONVERGED_AT
    yield number(
        "Fig. 6",
        f"ε_opt that its search has found by the {then}th generation",
        EPS_OPT,
        float(np.median(genetic.after(then))),
        0.01 * EPS_OPT,
        f"median of {seeds} seeds; within 1 % or above on {genetic.reaching(near, then)} by then, on "
        f"{genetic.reaching(near)} at the end, no weight at all on {seeds - genetic.reaching(1e-9)}. Random "
        f"search of the same budget: {random.reaching(near, then)}, {random.reaching(near)} and "
        f"{seeds - random.reaching(1e-9)} seeds{lucky}",
        must_agree=False,
    )
    yield _better_than_chance("Fig. 6", genetic, random)


def _loop_shaping(e: Evidence) -> Iterator[Verdict]:
    G = e.plant.transfer_function()
    yield number(
        "Sec. IV", "ε of the conventional controller", HLS_EPS, _eps_opt(G) / 1.1, 5e-6, "γ = 1.1 γ_opt"
    )
    K = baselines.loop_shaping_controller(G, W1, 1.1)
    num, den = (np.ravel(p) / np.ravel(K.den)[0] for p in (K.num, K.den))
    num = np.trim_zeros(np.where(np.abs(num) < 1e-9 * np.abs(num).max(), 0.0, num), "f")
    yield statement(
        "eq. (18)", "order of the controller is five", f"order {len(den) - 1}", len(den) == len(HLS.den)
    )
    for name, ours, printed in (("numerator", num, HLS.num), ("denominator", den, HLS.den)):
        for power, (mine, theirs) in enumerate(zip(ours[::-1], printed[::-1], strict=True)):
            if (name, power) != ("denominator", 5):
                what = f"{name}, s{str(power).translate(_SUPERSCRIPTS)}"
                yield number("eq. (18)", what, float(theirs), float(mine), 5e-4 * abs(float(theirs)))
    achieved = e.measures["HLS (18)"].eps_continuous
    yield statement(
        "eq. (6)", "its margin is at least the ε asked for", f"ε {achieved:.4f}", achieved >= HLS_EPS - 5e-6
    )


def _synthesis(e: Evidence) -> Iterator[Verdict]:
    ppid = e.measures["PPID (20)"].eps_continuous
    yield number("Fig. 8", "ε of PPID (20), eq. (13)", PPID_EPS, ppid, 5e-4)
    at = ", ".join(f"{name} {value:.5g}" for name, value in e.optimum.parameters.items())
    yield number(
        "eq. (20)",
        "largest ε of a PID in the paper's box",
        PPID_EPS,
        e.optimum.eps,
        5e-4,
        f"eq. (20) is not the optimum: {e.optimum.search.searcher} finds {at}",
        must_agree=False,
    )
    genetic, random = e.searches.genetic_controllers, e.searches.random_controllers
    median = float(np.median(genetic.after(-1)))
    yield number(
        "Fig. 8",
        "ε that its search typically finds",
        PPID_EPS,
        median,
        0.01 * PPID_EPS,
        f"median of {len(genetic)} seeds, from {genetic.after(-1).min():.4f} to "
        f"{genetic.after(-1).max():.4f}"
        + ("; the paper's run stopped short of what its search comes to" if median > PPID_EPS else ""),
        must_agree=False,
    )
    reached = PPID_EPS - 5e-4
    yield statement(
        "Fig. 8",
        "its search comes to the margin of PPID (20)",
        f"on {genetic.reaching(reached)} of {len(genetic)} seeds",
        genetic.reaching(reached) >= 0.75 * len(genetic),
        f"{PPID_EPS} or more after 30 generations of 200 chromosomes, on three of four seeds or more; random "
        f"search of the same budget on {random.reaching(reached)}",
    )
    yield _better_than_chance("Fig. 8", genetic, random)


def _better_than_chance(where: str, genetic: Runs, random: Runs) -> Verdict:
    share = genetic.beats(random)
    return Verdict(
        where,
        "its search is better than chance",
        "implied",
        f"in {100.0 * share:.0f} % of pairs of runs",
        share >= _CLEARLY,
        False,
        f"against random search of the same budget, in {100.0 * _CLEARLY:.0f} % or more; medians "
        f"{np.median(genetic.after(-1)):.4f} and {np.median(random.after(-1)):.4f}",
    )


def _responses(e: Evidence) -> Iterator[Verdict]:
    ppid, hls, zn, tlc = (e.measures[name] for name in ("PPID (20)", "HLS (18)", "ZN", "TLC"))
    cycle = baselines.ultimate_cycle(e.plant.transfer_function())
    continuous = [
        100.0 * e.problem.measure(_tuned(tune(cycle), e.candidates["ZN"])).overshoot
        for tune in (baselines.ziegler_nichols, baselines.tyreus_luyben)
    ]
    why = (
        "about; ultimate cycle of the loop sampled at 0.0112 s, response continuous, filter N = 10; "
        "with the continuous ultimate cycle {:.1f} %"
    )
    yield number(
        "Fig. 9", "overshoot of ZN", 45.0, 100.0 * zn.overshoot, 2.0, why.format(continuous[0]), unit=" %"
    )
    yield number(
        "Fig. 9", "overshoot of TLC", 10.0, 100.0 * tlc.overshoot, 1.0, why.format(continuous[1]), unit=" %"
    )
    limits = {specification.quantity: specification.limit for specification in PAPER}
    failing = [m.overshoot > limits["overshoot"] or m.settling_s > limits["settling_s"] for m in (zn, tlc)]
    yield statement(
        "Fig. 9",
        "ZN and TLC miss the specifications",
        f"overshoot {100 * zn.overshoot:.0f} and {100 * tlc.overshoot:.0f} %, "
        f"settling {zn.settling_s:.2f} and {tlc.settling_s:.2f} s",
        all(failing),
    )
    yield number("Fig. 10", "overshoot of PPID", 1.0, 100.0 * ppid.overshoot, 0.5, "about", unit=" %")
    yield number("Fig. 10", "overshoot of HLS", 0.0, 100.0 * hls.overshoot, 0.5, "none to be seen", unit=" %")
    yield number("Fig. 10", "2 % settling of HLS", 1.1, hls.settling_s, 0.06, "about", unit=" s")
    response = e.problem.step(e.candidates["PPID (20)"], 6.0)
    late = np.abs(response.y[0, response.time_s >= 1.1] - 1.0).max()
    yield number(
        "Fig. 10",
        "2 % settling of PPID",
        1.1,
        ppid.settling_s,
        0.06,
        f"about; within 2 % from {ppid.settling_s:.2f} s on, from 1.1 s on within {100.0 * late:.1f} %",
        unit=" s",
        must_agree=False,
    )
    yield statement(
        "Fig. 10",
        "no steady-state error",
        f"PPID {100 * ppid.error:.3f} %, HLS {100 * hls.error:.3f} %",
        max(ppid.error, hls.error) < limits["error"],
        f"below eq. (9)'s {limits['error']:g}",
    )


def _robustness(e: Evidence) -> Iterator[Verdict]:
    names = ("PPID (20)", "HLS (18)")
    ppid, hls = (e.measures[name] for name in names)
    yield number(
        "Fig. 11 (c)",
        "largest gain from input disturbance",
        0.08,
        ppid.disturbance_peak,
        0.005,
        "about",
        unit=" m/V",
    )
    yield statement(
        "Fig. 11 (c)",
        "PPID rejects disturbances as well as HLS",
        f"peaks {ppid.disturbance_peak:.4f} and {hls.disturbance_peak:.4f} m/V",
        ppid.disturbance_peak <= 1.05 * hls.disturbance_peak,
    )
    omega = np.array([0.01, 1000.0])
    closed = {name: e.problem.gains(e.candidates[name], omega) for name in names}
    gains = closed["PPID (20)"].disturbance
    yield statement(
        "Fig. 11 (c)",
        "that gain is small at low and high frequency",
        f"{gains[0]:.2g} m/V at 0.01 rad/s, {gains[1]:.2g} at 1000",
        bool((gains < 0.1 * ppid.disturbance_peak).all()),
        "below a tenth of the peak",
    )
    multiplicative = {name: 1.0 / value.complementary for name, value in closed.items()}
    additive = {name: 1.0 / value.effort for name, value in closed.items()}
    yield number(
        "Fig. 11 (a)",
        "perturbation borne at low frequency, of the plant",
        1.0,
        float(multiplicative["PPID (20)"][0]),
        0.02,
        "at 0.01 rad/s",
    )
    for where, borne in (("Fig. 11 (a)", multiplicative), ("Fig. 11 (b)", additive)):
        low, high = borne["HLS (18)"] / borne["PPID (20)"]
        yield statement(
            where,
            "HLS bears more at high frequency, the same at low",
            f"{high:.3g} times as much at 1000 rad/s, {low:.3g} at 0.01",
            bool(high > 1.5 and abs(low - 1.0) < 0.05),
        )


def _held_output_error_model(plant: Plant) -> Array:
    """Numerator (3,) of the continuous model whose zero-order hold is b z²/(z³ + …), by residues."""
    G = plant.transfer_function()
    poles = poly.roots(G.den)
    z = np.exp(poles * PERIOD_S)
    others = [np.delete(np.arange(3), i) for i in range(3)]
    residues = np.array(
        [poles[i] / (z[i] - 1.0) * z[i] ** 2 / np.prod(z[i] - z[others[i]]) for i in range(3)]
    )
    num = sum(residue * np.poly(poles[keep]) for residue, keep in zip(residues, others, strict=True)).real
    return np.asarray(num * (G.num[-1] / num[-1]))


def _with_damping(damping: float) -> TransferFunction:
    num = 0.47947 * np.array([1.0, 90.76])
    return TransferFunction(num, poly.multiply(np.array([1.0, 0.4231]), np.array([1.0, damping, 167.9])))


def _eps_opt(G: TransferFunction) -> float:
    return float(optimal_margins(shaped(G, W1))[0])


def _tuned(gains: baselines.PidGains, like: Candidate) -> Candidate:
    K: Controller = STRUCTURES["pid"].controller(np.array([gains.values]))
    return Candidate("", "", K, like.law, {})


def _short(reading: Reading) -> str:
    return f"{reading.quantity} {reading.value:.4g}"


_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
