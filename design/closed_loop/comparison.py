"""Controllers compared on one plant: the readings of the report's table, and the curves of its figures.

All readings belong to the loop that is designed for: the sampled loop with its hold and delay, or the
continuous loop. Only the margin ε is given for both.
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
from design.models.plant import Plant
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction
from design.robustness import margins
from design.robustness.central_controller import optimal_margins
from design.robustness.loop_shaping import shaped
from hil.core.controller_file import Law

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Candidate:
    """A controller in the comparison: its polynomials (1, n + 1) in s, and the law for the daemon."""

    name: str
    method: str
    controller: Controller
    law: Law
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Measures:
    """All readings of one controller; ∞ where a reading has no finite value."""

    eps_continuous: float
    """Margin ε of the continuous loop; NaN if the plant has a dead time, which that loop cannot represent."""
    eps_sampled: float
    """Margin ε of the law as the daemon realises it, in the loop with the rig's hold and delay."""
    stable: bool
    overshoot: float
    settling_s: float
    error: float
    crossover_rad_s: float
    bandwidth_rad_s: float
    gain_margin: float
    """Smallest factor over 1 on the loop gain that makes the loop unstable."""
    phase_margin_rad: float
    disturbance_peak: float
    """Largest gain from input disturbance to output, in axis units per V."""
    effort_v: float
    """Largest |u| in V after a setpoint step of one axis unit."""
    nyquist_rad_s: float
    """Nyquist frequency of the loop that is designed for; ∞ for a continuous loop."""


class Gains(NamedTuple):
    """The closed-loop gains of Table 1, each (k,); for one input and one output, σ̄ is the modulus."""

    disturbance: Array
    """|G/(1 + GK)|: gain from input disturbance to plant output."""
    complementary: Array
    """|GK/(1 + GK)|: its inverse is the largest multiplicative perturbation at the plant output."""
    effort: Array
    """|K/(1 + GK)|: gain from output disturbance to valve.

    Its inverse is the largest additive perturbation.
    """


@dataclass(frozen=True)
class Row:
    """One row of the table: what is read, in which unit, and how a value is written as text."""

    label: str
    unit: str
    text: Callable[[Measures], str]
    specified_as: str | None = None
    """Name of the specification that may limit this reading; None if there is none."""
    value: Callable[[Measures], float] = lambda _: 0.0
    """Function that returns the value to be compared with that limit."""


def delay_text(sampling: Sampling, plant: Plant | None = None) -> str:
    """Return the transport delay of the loop, and the dead time of the plant if it has one, in words."""
    text = f"{sampling.delay_samples} sample{'' if sampling.delay_samples == 1 else 's'} of delay"
    if plant is None or plant.is_rational:
        return text
    if plant.own_dead_time_s < 0.0:
        return f"{text}, {plant.contains_delay_samples} of which the plant's num and den contain"
    return f"{text}, {plant.own_dead_time_s:g} s of dead time"


def table_rows(axis_unit: str) -> tuple[Row, ...]:
    """Return the rows of the table for an axis in ``axis_unit``."""
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
        Row("crossover of GK", "rad/s", lambda m: _frequency(m, m.crossover_rad_s)),
        Row("bandwidth, −3 dB of T", "rad/s", lambda m: _frequency(m, m.bandwidth_rad_s)),
        Row("gain margin", "dB", lambda m: _number(m, 20.0 * float(np.log10(m.gain_margin)), 1)),
        Row("phase margin", "°", lambda m: _number(m, float(np.degrees(m.phase_margin_rad)), 1)),
        Row("disturbance peak", f"{axis_unit}/V", lambda m: _number(m, m.disturbance_peak, 4)),
        Row("largest |u|, unit step", f"V/{axis_unit}", lambda m: _number(m, m.effort_v, 1)),
    )


def eps_text(eps: float) -> str:
    """Return a margin as text; 0 means that the loop is unstable, NaN that it has no margin."""
    if np.isnan(eps):
        return "–"
    return number_text(eps, 4) if eps > 0.0 else "unstable"


def number_text(value: float, decimals: int, *, vanishing: bool = False) -> str:
    """Return a number with ``decimals`` decimals; a small one keeps two digits, unless ``vanishing``."""
    if not np.isfinite(value):
        return "∞"
    if vanishing or value == 0.0 or abs(value) >= 0.95 * 10.0 ** (1 - decimals):
        return f"{value:.{decimals}f}"
    return f"{value:.2g}"


def _frequency(measures: Measures, value_rad_s: float) -> str:
    """Return a crossing frequency; ``> 280.5`` above the Nyquist frequency, ``none`` without a crossing."""
    if measures.stable and value_rad_s == np.inf and np.isfinite(measures.nyquist_rad_s):
        return f"> {measures.nyquist_rad_s:.1f}"
    if measures.stable and value_rad_s in (0.0, np.inf):
        return "none"
    return _number(measures, value_rad_s, 2)


def _number(measures: Measures, value: float, decimals: int, *, vanishing: bool = False) -> str:
    return number_text(value, decimals, vanishing=vanishing) if measures.stable else "unstable"


@dataclass(frozen=True)
class Problem:
    """What all candidates have in common: the plant, the weight, and the loop.

    ``sampling`` is None if the controllers are designed for the continuous loop. ``rig_sampling`` is that of
    the rig, whichever loop they are designed for.
    """

    plant: Plant
    weight: TransferFunction
    sampling: Sampling | None
    rig_sampling: Sampling

    @cached_property
    def loop_plant(self) -> TransferFunction:
        """The plant as the loop that is designed for sees it."""
        return self.plant.transfer_function(self.sampling)

    @cached_property
    def eps_opt(self) -> float:
        """The largest margin of any controller in this loop with this weight, Appendix A."""
        return float(optimal_margins(shaped(self.loop_plant, self.weight))[0])

    def eps(self, measures: Measures) -> float:
        """Return the margin ε in the loop that is designed for."""
        return measures.eps_continuous if self.sampling is None else measures.eps_sampled

    def loops(self, K: Controller) -> ClosedLoops:
        """Return the loop of one controller, as a batch of one."""
        return ClosedLoops(self.loop_plant, K, W=self.weight, sampling=self.sampling)

    def measure(self, candidate: Candidate) -> Measures:
        """Return all readings of one candidate."""
        K = candidate.controller.feedback
        q = self.loops(candidate.controller)
        rig_G = self.plant.transfer_function(self.rig_sampling)
        running = controller_of_law(candidate.law, self.rig_sampling.period_s).feedback
        return Measures(
            eps_continuous=self._continuous_margin(K),
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
            nyquist_rad_s=np.inf if self.sampling is None else np.pi / self.sampling.period_s,
        )

    def step(self, candidate: Candidate, horizon_s: float) -> StepResponses:
        """Return the unit step response of one candidate: time_s (k,), y and u (1, k)."""
        return self.loops(candidate.controller).response(horizon_s)

    def frequencies(self, points: int = 400) -> Array:
        """Return true frequencies (points,) in rad/s around the plant's corner frequencies.

        For a sampled loop they lie below half the sampling frequency.
        """
        G = self.plant.rational_part
        corners = np.abs(np.concatenate([np.roots(G.num), np.roots(G.den)]))
        corners = corners[corners > 0.0]
        slowest, fastest = (corners.min(), corners.max()) if len(corners) else (1.0, 1.0)
        # Close to half the sampling frequency, the zeros of Tustin's rule at z = -1 hide the plant.
        top = 0.9 * np.pi / self.rig_sampling.period_s
        low = 10.0 ** np.floor(np.log10(min(slowest, 0.1 * top) / 20.0))
        high = 10.0 ** np.ceil(np.log10(max(fastest, top)))
        return np.geomspace(low, high if self.sampling is None else top, points)

    def response(self, H: TransferFunction, omega: Array) -> ComplexArray:
        """Return H (k,) at true frequencies in rad/s; H is given in the plane of this loop."""
        s = 1j * (omega if self.sampling is None else self.sampling.warp(omega))
        return np.asarray(np.polyval(np.ravel(H.num), s) / np.polyval(np.ravel(H.den), s))

    def gains(self, candidate: Candidate, omega: Array) -> Gains:
        """Return the gains of Table 1 at true frequencies (k,) in rad/s."""
        G, K = self.loop_plant, candidate.controller.feedback
        closed = margins.characteristic(G, K)
        above = (poly.multiply(G.num, K.den), poly.multiply(G.num, K.num), poly.multiply(K.num, G.den))
        return Gains(*(np.abs(self.response(TransferFunction(num, closed), omega)) for num in above))

    def _continuous_margin(self, K: TransferFunction) -> float:
        if not self.plant.is_rational:
            return float("nan")
        return float(margins.stability_margin(self.plant.transfer_function(), K, self.weight)[0])
