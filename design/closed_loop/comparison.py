"""Controllers side by side on one plant: what the table of the report says, and the curves of its figures.

Every reading is of the loop that is designed for (sampled with hold and delay, or continuous), except the
margins ε, which are given for both. No drawing, no designing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from design.closed_loop.loops import ClosedLoops
from design.closed_loop.responses import StepResponses
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array
from design.models.controller import Controller, controller_of_law
from design.models.plant import Plant, Sampling, TransferFunction
from design.robustness import margins
from design.robustness.central_controller import optimal_margins
from design.robustness.loop_shaping import shaped
from hil.core.controller_file import Law

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Candidate:
    """A controller in the comparison: polynomials (1, n + 1) in s, and the law that the daemon would run."""

    name: str
    method: str
    controller: Controller
    law: Law
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Measures:
    """One column of the table. Times in s, frequencies in rad/s; ∞ where a reading has no finite value."""

    eps_continuous: float
    eps_sampled: float
    """Of the law as the daemon realises it, with the rig's hold and delay."""
    stable: bool
    overshoot: float
    settling_s: float
    error: float
    crossover_rad_s: float
    bandwidth_rad_s: float
    gain_margin: float
    """Smallest factor over 1 that makes the loop unstable."""
    phase_margin_rad: float
    disturbance_peak: float
    """Axis unit per V."""
    effort_v: float
    """Largest |u| after a step of one axis unit."""


class Gains(NamedTuple):
    """Closed-loop gains of Table 1, each (k,); with one input and one output σ̄ is the modulus."""

    disturbance: Array
    """|G/(1 + GK)|, from input disturbance to plant output."""
    complementary: Array
    """|GK/(1 + GK)|; its inverse is the largest output multiplicative perturbation."""
    effort: Array
    """|K/(1 + GK)|, from output disturbance to valve; its inverse is the largest additive perturbation."""


@dataclass(frozen=True)
class Row:
    """One row of the table: what is read, in which unit, and how a value is written."""

    label: str
    unit: str
    text: Callable[[Measures], str]
    specified_as: str | None = None
    """The specification that limits this reading of the designed loop, if it is asked for."""
    value: Callable[[Measures], float] = lambda _: 0.0


def delay_text(sampling: Sampling) -> str:
    """The transport delay in words."""
    return f"{sampling.delay_samples} sample{'' if sampling.delay_samples == 1 else 's'} of delay"


def table_rows(axis_unit: str) -> tuple[Row, ...]:
    """The rows of the table for an axis in ``axis_unit``."""
    return (
        Row("ε, continuous loop", "", lambda m: eps_text(m.eps_continuous)),
        Row("ε, sampled loop", "", lambda m: eps_text(m.eps_sampled)),
        Row(
            "overshoot",
            "%",
            lambda m: _number(m, 100.0 * m.overshoot, 1, vanishing=True),
            "overshoot",
            lambda m: m.overshoot,
        ),
        Row(
            "2 % settling",
            "s",
            lambda m: _number(m, m.settling_s, 2),
            "settling_s",
            lambda m: m.settling_s,
        ),
        Row(
            "steady-state error",
            "%",
            lambda m: _number(m, 100.0 * m.error, 3, vanishing=True),
            "error",
            lambda m: m.error,
        ),
        Row("crossover of GK", "rad/s", lambda m: _number(m, m.crossover_rad_s, 2)),
        Row("bandwidth, −3 dB of T", "rad/s", lambda m: _number(m, m.bandwidth_rad_s, 2)),
        Row("gain margin", "dB", lambda m: _number(m, 20.0 * float(np.log10(m.gain_margin)), 1)),
        Row("phase margin", "°", lambda m: _number(m, float(np.degrees(m.phase_margin_rad)), 1)),
        Row("disturbance peak", f"{axis_unit}/V", lambda m: _number(m, m.disturbance_peak, 4)),
        Row("largest |u|, unit step", f"V/{axis_unit}", lambda m: _number(m, m.effort_v, 1)),
    )


def eps_text(eps: float) -> str:
    """A margin; 0 is what an unstable loop has."""
    return number_text(eps, 4) if eps > 0.0 else "unstable"


def number_text(value: float, decimals: int, *, vanishing: bool = False) -> str:
    """A number to so many decimals, but to two digits at least unless it may vanish."""
    if not np.isfinite(value):
        return "∞"
    if vanishing or value == 0.0 or abs(value) >= 0.95 * 10.0 ** (1 - decimals):
        return f"{value:.{decimals}f}"
    return f"{value:.2g}"


def _number(measures: Measures, value: float, decimals: int, *, vanishing: bool = False) -> str:
    return number_text(value, decimals, vanishing=vanishing) if measures.stable else "unstable"


@dataclass(frozen=True)
class Problem:
    """What all candidates share: plant, weight, the loop designed for, and the rig's sampling."""

    plant: Plant
    weight: TransferFunction
    sampling: Sampling | None
    rig_sampling: Sampling

    @cached_property
    def loop_plant(self) -> TransferFunction:
        """The plant as the loop designed for sees it."""
        return self.plant.transfer_function(self.sampling)

    @cached_property
    def eps_opt(self) -> float:
        """The most that any controller reaches in this loop with this weight, Appendix A."""
        return float(optimal_margins(shaped(self.loop_plant, self.weight))[0])

    def eps(self, measures: Measures) -> float:
        """The margin in the loop designed for."""
        return measures.eps_continuous if self.sampling is None else measures.eps_sampled

    def loops(self, K: Controller) -> ClosedLoops:
        """The loop of one controller."""
        return ClosedLoops(self.loop_plant, K, W=self.weight, sampling=self.sampling)

    def measure(self, candidate: Candidate) -> Measures:
        """All readings of one candidate."""
        K = candidate.controller.feedback
        q = self.loops(candidate.controller)
        G, rig_G = self.plant.transfer_function(), self.plant.transfer_function(self.rig_sampling)
        running = controller_of_law(candidate.law, self.rig_sampling.period_s).feedback
        return Measures(
            eps_continuous=float(margins.stability_margin(G, K, self.weight)[0]),
            eps_sampled=float(margins.stability_margin(rig_G, running, self.weight)[0]),
            stable=bool(q.stable[0]),
            overshoot=float(q.overshoot[0]),
            settling_s=float(q.settling_s[0]),
            error=float(q.error[0]),
            crossover_rad_s=float(q.true_frequency(margins.crossover(q.open))[0]),
            bandwidth_rad_s=float(q.true_frequency(margins.bandwidth(q.G, K, q.K.num_r))[0]),
            gain_margin=float(margins.gain_margins(q.open)[1][0]),
            phase_margin_rad=float(margins.phase_margin(q.open)[0]),
            disturbance_peak=float(margins.disturbance_peak(q.G, K)[0]),
            effort_v=float(q.effort[0]),
        )

    def step(self, candidate: Candidate, horizon_s: float) -> StepResponses:
        """Unit step response of one candidate: time_s (k,), y and u (1, k)."""
        return self.loops(candidate.controller).response(horizon_s)

    def frequencies(self, points: int = 400) -> Array:
        """True frequencies (points,) in rad/s around the plant's corners, below half the sampling rate."""
        G = self.plant.transfer_function()
        corners = np.abs(np.concatenate([np.roots(G.num), np.roots(G.den)]))
        corners = corners[corners > 0.0]
        slowest, fastest = (corners.min(), corners.max()) if len(corners) else (1.0, 1.0)
        # Nearer to half the sampling rate, Tustin's zeros at z = -1 say nothing of the plant.
        top = 0.9 * np.pi / self.rig_sampling.period_s
        low = 10.0 ** np.floor(np.log10(min(slowest, 0.1 * top) / 20.0))
        high = 10.0 ** np.ceil(np.log10(max(fastest, top)))
        return np.geomspace(low, high if self.sampling is None else top, points)

    def response(self, H: TransferFunction, omega: Array) -> ComplexArray:
        """H (k,) at true frequencies in rad/s, of polynomials in this loop's plane."""
        s = 1j * (omega if self.sampling is None else self.sampling.warp(omega))
        return np.asarray(np.polyval(np.ravel(H.num), s) / np.polyval(np.ravel(H.den), s))

    def gains(self, candidate: Candidate, omega: Array) -> Gains:
        """Table 1 at true frequencies (k,) in rad/s."""
        G, K = self.loop_plant, candidate.controller.feedback
        closed = margins.characteristic(G, K)
        above = (poly.multiply(G.num, K.den), poly.multiply(G.num, K.num), poly.multiply(K.num, G.den))
        return Gains(*(np.abs(self.response(TransferFunction(num, closed), omega)) for num in above))
