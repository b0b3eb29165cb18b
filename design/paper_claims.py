"""What the paper prints, each figure beside what this package computes, with a verdict that is computed too.

Kaitwanidvilai and Parnichkun, "Design of Structured Controller Satisfying H∞ Loop Shaping using Evolutionary
Optimization: Application to a Pneumatic Robot Arm". Lives here: the printed figures, how each is read where
the paper leaves that open, and its tolerance. The experiments, Figs 13 to 15, need an arm and are not here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from design import baselines, margins
from design import polynomials as poly
from design.central_controller import optimal_margins
from design.comparison import Candidate, Measures, Problem
from design.loop_shaping import shaped
from design.plant import Plant, TransferFunction
from design.polynomials import Array
from design.specifications import Reading
from design.structures import STRUCTURES, Controller
from design.synthesis import Synthesis
from design.weight_selection import WeightSelection

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


@dataclass(frozen=True)
class Verdict:
    """One printed figure, ours, and whether they agree; ``must_agree`` where disagreement is our mistake."""

    where: str
    what: str
    printed: str
    ours: str
    agrees: bool
    must_agree: bool
    why: str

    @property
    def failed(self) -> bool:
        """Whether something does not reproduce that should."""
        return self.must_agree and not self.agrees

    @property
    def text(self) -> str:
        """In a word or two."""
        if self.agrees:
            return "reproduced"
        return "DOES NOT REPRODUCE" if self.must_agree else "differs"


@dataclass(frozen=True)
class Evidence:
    """What the verdicts are computed from; candidates and their measures by name."""

    plant: Plant
    problem: Problem
    """The continuous loop with W1 of eq. (16)."""
    selecting: Sequence[Reading]
    """The specifications, read off the loop of eq. (16)."""
    genetic_weights: Sequence[WeightSelection]
    """What the paper's genetic algorithm found on the seeds on which it found any."""
    best_weight: WeightSelection
    genetic: Sequence[Synthesis]
    """What it found on each seed."""
    optimum: Synthesis
    candidates: Mapping[str, Candidate]
    measures: Mapping[str, Measures]


def judge(evidence: Evidence) -> tuple[Verdict, ...]:
    """Every verdict, in the paper's order."""
    parts = (_model, _weight, _loop_shaping, _synthesis, _responses, _robustness)
    return tuple(verdict for part in parts for verdict in part(evidence))


def _number(
    where: str,
    what: str,
    printed: float,
    ours: float,
    tolerance: float,
    why: str = "",
    *,
    unit: str = "",
    must_agree: bool = True,
) -> Verdict:
    """Agrees where |ours - printed| is within the tolerance; it is stated beside the reading."""
    told = f"{why}; " if why else ""
    return Verdict(
        where,
        what,
        f"{printed:.6g}{unit}",
        f"{ours:.{_digits(printed)}g}{unit}",
        bool(abs(ours - printed) <= tolerance),
        must_agree,
        f"{told}tolerance {tolerance:.2g}{unit}",
    )


def _digits(printed: float) -> int:
    """Two more significant digits than are printed."""
    return max(len(f"{printed:g}".replace(".", "").strip("0")) + 2, 3)


def _statement(
    where: str, what: str, ours: str, holds: bool, why: str = "", *, must_agree: bool = True
) -> Verdict:
    return Verdict(where, what, "stated", ours, bool(holds), must_agree, why)


def _model(e: Evidence) -> Iterator[Verdict]:
    num = _held_output_error_model(e.plant)
    why = "OE(1,3,1) with eq. (15)'s poles and static gain, zero-order hold inverted"
    yield _number("eq. (15)", "gain of the identified model", 0.47947, float(num[1]), 1e-5, why)
    yield _number(
        "eq. (15)",
        "its zero",
        90.76,
        float(num[2] / num[1]),
        0.005,
        f"{why}; a term {num[0]:.2g} s² was dropped in print, an artefact of sampling, not physics",
        unit=" rad/s",
    )
    eps = {damping: _eps_opt(_with_damping(damping)) for damping in (DAMPING, MISPRINTED_DAMPING)}
    yield _number(
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
    yield _number("Sec. IV", "ε_opt of W1 (16), Appendix A", EPS_OPT, _eps_opt(G), 5e-6)
    Gs = shaped(G, W1)
    yield _number(
        "Sec. IV", "crossover of the shaped plant", 4.0, float(margins.crossover(Gs)[0]), 0.1, unit=" rad/s"
    )
    met = sum(reading.met for reading in e.selecting)
    yield _statement(
        "eq. (9)",
        "W1 (16) meets the specifications",
        f"{met} of {len(e.selecting)} met",
        met == len(e.selecting),
        "gain and crossover of Gs, times of the closed loop with K = W1 K∞: "
        + "; ".join(map(_short, e.selecting)),
    )
    best = e.best_weight
    at = ", ".join(f"{name} {value:.5g}" for name, value in best.parameters.items())
    yield _number(
        "Fig. 6",
        "largest ε_opt that meets them",
        EPS_OPT,
        best.eps_opt,
        5e-6,
        f"eq. (16) is {100.0 * (1.0 - EPS_OPT / best.eps_opt):.1f} % short of the optimum of eq. (8) at {at}",
        must_agree=False,
    )
    runs, found = len(e.genetic), [selection.eps_opt for selection in e.genetic_weights]
    told = f", ε_opt {min(found):.3f} to {max(found):.3f}" if found else ""
    yield _statement(
        "Fig. 6",
        "the paper's genetic algorithm finds such a weight",
        f"on {len(found)} of {runs} seeds{told}",
        len(found) > runs / 2,
        "100 chromosomes, 20 generations; on most seeds",
    )


def _loop_shaping(e: Evidence) -> Iterator[Verdict]:
    G = e.plant.transfer_function()
    yield _number(
        "Sec. IV", "ε of the conventional controller", HLS_EPS, _eps_opt(G) / 1.1, 5e-6, "γ = 1.1 γ_opt"
    )
    K = baselines.loop_shaping_controller(G, W1, 1.1)
    num, den = (np.ravel(p) / np.ravel(K.den)[0] for p in (K.num, K.den))
    num = np.trim_zeros(np.where(np.abs(num) < 1e-9 * np.abs(num).max(), 0.0, num), "f")
    yield _statement(
        "eq. (18)", "order of the controller is five", f"order {len(den) - 1}", len(den) == len(HLS.den)
    )
    for name, ours, printed in (("numerator", num, HLS.num), ("denominator", den, HLS.den)):
        for power, (mine, theirs) in enumerate(zip(ours[::-1], printed[::-1], strict=True)):
            if (name, power) != ("denominator", 5):
                what = f"{name}, s{str(power).translate(_SUPERSCRIPTS)}"
                yield _number("eq. (18)", what, float(theirs), float(mine), 5e-4 * abs(float(theirs)))
    achieved = e.measures["HLS (18)"].eps_continuous
    yield _statement(
        "eq. (6)", "its margin is at least the ε asked for", f"ε {achieved:.4f}", achieved >= HLS_EPS - 5e-6
    )


def _synthesis(e: Evidence) -> Iterator[Verdict]:
    ppid = e.measures["PPID (20)"].eps_continuous
    yield _number("Fig. 8", "ε of PPID (20), eq. (13)", PPID_EPS, ppid, 5e-4)
    at = ", ".join(f"{name} {value:.5g}" for name, value in e.optimum.parameters.items())
    yield _number(
        "eq. (20)",
        "largest ε of a PID in the paper's box",
        PPID_EPS,
        e.optimum.eps,
        5e-4,
        f"eq. (20) is not the optimum: {e.optimum.search.searcher} finds {at}",
        must_agree=False,
    )
    found = sorted(synthesis.eps for synthesis in e.genetic)
    yield _statement(
        "Fig. 8",
        "the paper's genetic algorithm comes to such a margin",
        f"ε {found[0]:.3f} to {found[-1]:.3f} on {len(found)} seeds",
        0.95 * found[0] <= PPID_EPS <= found[-1],
        f"200 chromosomes, 30 generations, linear binary coding; {PPID_EPS} is at most 5 % under their worst",
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
    yield _number(
        "Fig. 9", "overshoot of ZN", 45.0, 100.0 * zn.overshoot, 2.0, why.format(continuous[0]), unit=" %"
    )
    yield _number(
        "Fig. 9", "overshoot of TLC", 10.0, 100.0 * tlc.overshoot, 1.0, why.format(continuous[1]), unit=" %"
    )
    failing = [m.overshoot > 0.05 or m.settling_s > 1.2 for m in (zn, tlc)]
    yield _statement(
        "Fig. 9",
        "ZN and TLC miss the specifications",
        f"overshoot {100 * zn.overshoot:.0f} and {100 * tlc.overshoot:.0f} %, "
        f"settling {zn.settling_s:.2f} and {tlc.settling_s:.2f} s",
        all(failing),
    )
    yield _number("Fig. 10", "overshoot of PPID", 1.0, 100.0 * ppid.overshoot, 0.5, "about", unit=" %")
    yield _number(
        "Fig. 10", "overshoot of HLS", 0.0, 100.0 * hls.overshoot, 0.5, "none to be seen", unit=" %"
    )
    yield _number("Fig. 10", "2 % settling of HLS", 1.1, hls.settling_s, 0.06, "about", unit=" s")
    response = e.problem.step(e.candidates["PPID (20)"], 6.0)
    late = np.abs(response.y[0, response.time_s >= 1.1] - 1.0).max()
    yield _number(
        "Fig. 10",
        "2 % settling of PPID",
        1.1,
        ppid.settling_s,
        0.06,
        f"about; within 2 % from {ppid.settling_s:.2f} s on, from 1.1 s on within {100.0 * late:.1f} %",
        unit=" s",
        must_agree=False,
    )
    yield _statement(
        "Fig. 10",
        "no steady-state error",
        f"PPID {100 * ppid.error:.3f} %, HLS {100 * hls.error:.3f} %",
        max(ppid.error, hls.error) < 0.001,
        "below eq. (9)'s 0.001",
    )


def _robustness(e: Evidence) -> Iterator[Verdict]:
    names = ("PPID (20)", "HLS (18)")
    ppid, hls = (e.measures[name] for name in names)
    yield _number(
        "Fig. 11 (c)",
        "largest gain from input disturbance",
        0.08,
        ppid.disturbance_peak,
        0.005,
        "about",
        unit=" m/V",
    )
    yield _statement(
        "Fig. 11 (c)",
        "PPID rejects disturbances as well as HLS",
        f"peaks {ppid.disturbance_peak:.4f} and {hls.disturbance_peak:.4f} m/V",
        ppid.disturbance_peak <= 1.05 * hls.disturbance_peak,
    )
    omega = np.array([0.01, 1000.0])
    closed = {name: e.problem.gains(e.candidates[name], omega) for name in names}
    gains = closed["PPID (20)"].disturbance
    yield _statement(
        "Fig. 11 (c)",
        "that gain is small at low and high frequency",
        f"{gains[0]:.2g} m/V at 0.01 rad/s, {gains[1]:.2g} at 1000",
        bool((gains < 0.1 * ppid.disturbance_peak).all()),
        "below a tenth of the peak",
    )
    multiplicative = {name: 1.0 / value.complementary for name, value in closed.items()}
    additive = {name: 1.0 / value.effort for name, value in closed.items()}
    yield _number(
        "Fig. 11 (a)",
        "perturbation borne at low frequency, of the plant",
        1.0,
        float(multiplicative["PPID (20)"][0]),
        0.02,
        "at 0.01 rad/s",
    )
    for where, borne in (("Fig. 11 (a)", multiplicative), ("Fig. 11 (b)", additive)):
        low, high = borne["HLS (18)"] / borne["PPID (20)"]
        yield _statement(
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
