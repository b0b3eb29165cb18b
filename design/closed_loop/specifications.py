"""Performance specifications, eqs. (8) and (9): what is read off a loop, its limit, and by how much it fails.

Any subset may be asked for, of a continuous or a sampled loop. The paper does not say of which loop its
specifications are; each reading names its own. Violations are relative to the limit, 0 where it holds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from design.closed_loop.loops import ClosedLoops
from design.errors import DesignError
from design.mathematics.polynomials import Array
from design.robustness import margins

UNSTABLE = 1e3
"""Violation from which on a loop is unstable."""
_WORST = 1e2
ROUNDING = 1e-7
"""Relative to a limit: a search goes up to it, and read alone a loop differs in its last digits."""


@dataclass(frozen=True)
class Quantity:
    """Something that can be specified: how it reads, in which unit, and whether its limit is the largest."""

    unit: str
    is_upper_limit: bool
    reading: str
    read: Callable[[ClosedLoops, float], Array]
    """Values (B,) of loops, given the specification's ``at``."""
    takes: str | None = None
    """What ``at`` is, with its unit; None if it has none."""
    needs_step_response: bool = False
    """Whether a step response has to be followed for it, which takes its time."""

    @property
    def reads_open_loop_shape(self) -> bool:
        """Whether it is read off the open loop whose shape is specified: Gs while weights are selected."""
        return "{desired}" in self.reading


QUANTITIES = {
    "overshoot": Quantity(
        "",
        True,
        "largest y of the closed loop's unit step over its final value, less 1",
        lambda q, _: q.overshoot,
        needs_step_response=True,
    ),
    "settling_s": Quantity(
        "s",
        True,
        "time from which the closed loop's step stays within 2 % of its final value",
        lambda q, _: q.settling_s,
        needs_step_response=True,
    ),
    "rise_s": Quantity(
        "s", True, "10 to 90 % of the closed loop's step", lambda q, _: q.rise_s, needs_step_response=True
    ),
    "error": Quantity(
        "", True, "|1 - y| of the closed loop's unit step as t goes to infinity", lambda q, _: q.error
    ),
    "bandwidth_rad_s": Quantity(
        "rad/s",
        False,
        "crossover of {desired}",
        lambda q, _: q.true_frequency(margins.crossover(q.desired)),
    ),
    "closed_bandwidth_rad_s": Quantity(
        "rad/s",
        False,
        "-3 dB of the closed loop from setpoint to output",
        lambda q, _: q.true_frequency(margins.bandwidth(q.G, q.K.feedback, q.K.num_r)),
    ),
    "gain_db": Quantity(
        "dB",
        False,
        "smallest gain of {desired} up to {at} rad/s",
        lambda q, at: _db(margins.lowest_gain(q.desired, _plane(q, at))),
        takes="the highest frequency of the band, rad/s",
    ),
    "gain_margin_db": Quantity(
        "dB",
        False,
        "smallest factor over 1 that brings GK to -1",
        lambda q, _: _db(margins.gain_margins(q.open)[1]),
    ),
    "phase_margin_deg": Quantity(
        "deg",
        False,
        "smallest angle between GK and -1 where |GK| = 1",
        lambda q, _: np.degrees(margins.phase_margin(q.open)),
    ),
    "effort_v": Quantity(
        "V",
        True,
        "largest |u| after a setpoint step of {at}",
        lambda q, at: at * q.effort,
        takes="the size of the step, in the axis' unit",
        needs_step_response=True,
    ),
    "disturbance_peak": Quantity(
        "", True, "‖G/(1 + GK)‖∞, output unit per V", lambda q, _: margins.disturbance_peak(q.G, q.K.feedback)
    ),
}


@dataclass(frozen=True)
class Specification:
    """A limit on a quantity of :data:`QUANTITIES`; ``at`` is what some of them take."""

    quantity: str
    limit: float
    at: float = 1.0

    def __post_init__(self) -> None:
        if self.quantity not in QUANTITIES:
            raise DesignError(f"specification {self.quantity!r}: there are " + ", ".join(QUANTITIES))
        if not self.limit > 0.0 and self.kind.unit != "dB":
            limit = f"{self.limit:g} {self.kind.unit}".rstrip()
            raise DesignError(f"specification {self.quantity}: limit {limit}: not over 0")

    @property
    def kind(self) -> Quantity:
        """What is read."""
        return QUANTITIES[self.quantity]

    def read(self, loops: ClosedLoops) -> Array:
        """Values (B,)."""
        return np.asarray(self.kind.read(loops, self.at))

    def violation(self, value: Array) -> Array:
        """By how much values (B,) fail, relative to the limit; 0 where it holds."""
        size = max(abs(self.limit), 1e-12)
        excess = (value - self.limit) / size
        excess = excess if self.kind.is_upper_limit else -excess
        return np.clip(np.where(np.isnan(excess), _WORST, excess), 0.0, _WORST)


@dataclass(frozen=True)
class Reading:
    """One specification of one loop: its value, its limit, and what exactly was read."""

    quantity: str
    value: float
    limit: float
    unit: str
    reading: str
    met: bool

    def __str__(self) -> str:
        sign = "<=" if QUANTITIES[self.quantity].is_upper_limit else ">="
        verdict = "met" if self.met else "NOT met"
        return f"{self.quantity} {self.value_text} {verdict} ({sign} {self.limit:g}; {self.reading})"

    @property
    def value_text(self) -> str:
        """The value with its unit."""
        value = f"{self.value:.4g}" if np.isfinite(self.value) else "∞"
        return f"{value} {self.unit}".rstrip()


def violations(
    specifications: Sequence[Specification], loops: ClosedLoops, enough: Array | None = None
) -> Array:
    """Summed violations (B,); over 1000 where a loop is unstable, 0 where everything holds.

    Where they are over ``enough`` (B,), some value over it is returned, and sooner.
    """
    total = np.where(loops.stable, 0.0, UNSTABLE)
    for specification in specifications:
        if not specification.kind.needs_step_response:
            total += specification.violation(specification.read(loops))
    followed = [specification for specification in specifications if specification.kind.needs_step_response]
    chosen = np.flatnonzero(total <= (np.inf if enough is None else enough))
    if followed and len(chosen):
        some = loops if len(chosen) == len(total) else loops.some(chosen)
        for specification in followed:
            total[chosen] += specification.violation(specification.read(some))
    return total


def enough_violation(worth: Array, fitness: Array) -> Array:
    """For :func:`violations` (B,): ``fitness`` counts if all holds, and what is below ``worth`` is lost."""
    return np.where(worth > 0.0, np.where(fitness >= worth, 0.0, -1.0), -worth)


def readings(specifications: Sequence[Specification], loops: ClosedLoops) -> tuple[Reading, ...]:
    """What a single loop reads."""
    result = []
    for specification in specifications:
        kind = specification.kind
        value = specification.read(loops)
        met = bool(loops.stable[0] and specification.violation(value)[0] <= ROUNDING)
        name = kind.reading.format(desired=loops.desired_name, at=specification.at)
        result.append(
            Reading(specification.quantity, float(value[0]), specification.limit, kind.unit, name, met)
        )
    return tuple(result)


def compromise(
    what: str, parameters: Mapping[str, float], at_bounds: Sequence[str], read: Sequence[Reading]
) -> str:
    """The text of an InfeasibleError: what fails, and by how much, at the best that was found."""
    at = ", ".join(f"{name} {value:.4g}" for name, value in parameters.items())
    failed = "".join(f"\n  {reading}" for reading in read if not reading.met)
    advice = "relax what fails, or choose another structure"
    if at_bounds:
        advice = f"{', '.join(at_bounds)} at an end of the box: widen it, or relax what fails"
    return f"no {what} in its box meets all specifications. Best compromise ({at}):{failed}\nNext: {advice}"


def wanted_crossover(specifications: Sequence[Specification]) -> float:
    """The largest bandwidth asked for in rad/s; 0 if none is."""
    return max((s.limit for s in specifications if s.quantity.endswith("bandwidth_rad_s")), default=0.0)


PAPER = (
    Specification("overshoot", 0.05),
    Specification("settling_s", 1.2),
    Specification("error", 0.001),
    Specification("bandwidth_rad_s", 4.0),
    Specification("gain_db", 20.0, at=0.4),
)
"""Sec. IV: OV, St, SE, BW and Gu below ω_l."""


def _db(gain: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.asarray(20.0 * np.log10(gain))


def _plane(loops: ClosedLoops, omega: float) -> float:
    return omega if loops.sampling is None else float(loops.sampling.warp(omega))
