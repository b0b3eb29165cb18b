"""Performance specifications, eqs. (8) and (9): what is read off a loop, its limit, and the violation.

Any of the quantities may be specified, for continuous and sampled loops. The paper does not say to which loop
its specifications refer; here every reading names its loop. A violation is relative to the limit, and 0 where
the specification holds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from design.closed_loop.loops import ClosedLoops
from design.errors import DesignError
from design.mathematics.polynomials import Array
from design.robustness import margins

MAX_VIOLATION = 1e2
"""Largest violation of one specification; a reading that does not exist counts as this."""
ROUNDING = 1e-7
"""Excess over a limit, relative to it, that still counts as met.

A search drives readings up to their limits, and a loop that is evaluated alone differs in its last digits.
"""


@dataclass(frozen=True)
class Quantity:
    """Something that can be specified."""

    unit: str
    is_upper_limit: bool
    """True if the reading may not be over the limit, False if it may not be under the limit."""
    reading: str
    """What is read, in words; may contain {desired}, the symbol of the open loop, and {at}."""
    read: Callable[[ClosedLoops, float], Array]
    """Function that returns the values (B,) of loops, given the specification's ``at``."""
    takes: str | None = None
    """Meaning of the specification's ``at``, with its unit; None if the quantity has no such argument."""
    needs_step_response: bool = False
    """True if a step response must be simulated, which takes longer than all other readings together."""

    @property
    def reads_open_loop_shape(self) -> bool:
        """True if the quantity is read off the desired open loop, which is Gs while a weight is selected."""
        return "{desired}" in self.reading


QUANTITIES = {
    "overshoot": Quantity(
        "",
        True,
        "largest y of the closed loop's unit step over its final value, less 1",
        lambda loops, _: loops.overshoot,
        needs_step_response=True,
    ),
    "settling_s": Quantity(
        "s",
        True,
        "time from which the closed loop's step stays within 2 % of its final value",
        lambda loops, _: loops.settling_s,
        needs_step_response=True,
    ),
    "rise_s": Quantity(
        "s",
        True,
        "time from 10 to 90 % of the closed loop's step",
        lambda loops, _: loops.rise_s,
        needs_step_response=True,
    ),
    "error": Quantity(
        "", True, "|1 - y| of the closed loop's unit step as t goes to infinity", lambda loops, _: loops.error
    ),
    "bandwidth_rad_s": Quantity(
        "rad/s",
        False,
        "crossover of {desired}",
        lambda loops, _: loops.true_frequency(margins.crossover(loops.desired)),
    ),
    "closed_bandwidth_rad_s": Quantity(
        "rad/s",
        False,
        "-3 dB of the closed loop from setpoint to output",
        lambda loops, _: loops.true_frequency(margins.bandwidth(loops.G, loops.K.feedback, loops.K.num_r)),
    ),
    "gain_db": Quantity(
        "dB",
        False,
        "smallest gain of {desired} up to {at} rad/s",
        lambda loops, at: _db(margins.lowest_gain(loops.desired, _plane_frequency(loops, at))),
        takes="highest frequency of the band in rad/s",
    ),
    "gain_margin_db": Quantity(
        "dB",
        False,
        "smallest factor over 1 that brings GK to -1",
        lambda loops, _: _db(margins.gain_margins(loops.open)[1]),
    ),
    "phase_margin_deg": Quantity(
        "deg",
        False,
        "smallest angle between GK and -1 where |GK| = 1",
        lambda loops, _: np.degrees(margins.phase_margin(loops.open)),
    ),
    "effort_v": Quantity(
        "V",
        True,
        "largest |u| after a setpoint step of {at}",
        lambda loops, at: at * loops.effort,
        takes="size of the step in the axis' unit",
        needs_step_response=True,
    ),
    "disturbance_peak": Quantity(
        "",
        True,
        "‖G/(1 + GK)‖∞, output unit per V",
        lambda loops, _: margins.disturbance_peak(loops.G, loops.K.feedback),
    ),
}
"""All quantities that can be specified, by the names that a design file uses."""


@dataclass(frozen=True)
class Specification:
    """A limit on one of the :data:`QUANTITIES`; ``at`` is the argument that some of them take.

    Raises DesignError for a quantity that does not exist, and for a limit that is not over 0 (except in dB).
    """

    quantity: str
    limit: float
    at: float = 1.0

    def __post_init__(self) -> None:
        if self.quantity not in QUANTITIES:
            raise DesignError(
                f"specification {self.quantity!r} does not exist; there are " + ", ".join(QUANTITIES)
            )
        if not self.limit > 0.0 and self.kind.unit != "dB":
            limit = f"{self.limit:g} {self.kind.unit}".rstrip()
            raise DesignError(f"specification {self.quantity}: the limit {limit} is not over 0")

    @property
    def kind(self) -> Quantity:
        """The quantity that is limited."""
        return QUANTITIES[self.quantity]

    def read(self, loops: ClosedLoops) -> Array:
        """Return the values (B,) of the quantity."""
        return np.asarray(self.kind.read(loops, self.at))

    def violation(self, value: Array) -> Array:
        """Return by how much values (B,) violate the limit, relative to it; 0 where it holds."""
        size = max(abs(self.limit), 1e-12)
        excess = (value - self.limit) / size
        excess = excess if self.kind.is_upper_limit else -excess
        return np.clip(np.where(np.isnan(excess), MAX_VIOLATION, excess), 0.0, MAX_VIOLATION)


@dataclass(frozen=True)
class Reading:
    """The value of one specification for one loop, beside its limit."""

    quantity: str
    value: float
    limit: float
    unit: str
    reading: str
    """What was read and off which loop, in words."""
    met: bool

    def __str__(self) -> str:
        sign = "<=" if QUANTITIES[self.quantity].is_upper_limit else ">="
        verdict = "met" if self.met else "NOT met"
        return f"{self.quantity} {self.value_text} {verdict} ({sign} {self.limit:g}; {self.reading})"

    @property
    def value_text(self) -> str:
        """The value with its unit, as text."""
        value = f"{self.value:.4g}" if np.isfinite(self.value) else "∞"
        return f"{value} {self.unit}".rstrip()


PAPER = (
    Specification("overshoot", 0.05),
    Specification("settling_s", 1.2),
    Specification("error", 0.001),
    Specification("bandwidth_rad_s", 4.0),
    Specification("gain_db", 20.0, at=0.4),
)
"""The paper's specifications, eq. (9) with the limits of Sec. IV: OV, St, SE, BW, and Gu below ω_l.

The limits stand only here. The defaults of a design file, the example file, the paper's own design and its
verdicts all take them from here.
"""


def violations(
    specifications: Sequence[Specification], loops: ClosedLoops, cutoff: Array | None = None
) -> Array:
    """Return the sum (B,) of the violations of all specifications; 0 where all of them hold.

    Where the sum is over ``cutoff`` (B,), any value over the cutoff may be returned, which saves simulating a
    step response. An unstable loop has the largest violation of every reading that needs a step response.
    """
    total = np.zeros(len(loops.stable))
    for specification in specifications:
        if not specification.kind.needs_step_response:
            total += specification.violation(specification.read(loops))
    simulated = [s for s in specifications if s.kind.needs_step_response]
    chosen = np.flatnonzero(total <= (np.inf if cutoff is None else cutoff))
    if simulated and len(chosen):
        some = loops if len(chosen) == len(total) else loops.subset(chosen)
        for specification in simulated:
            total[chosen] += specification.violation(specification.read(some))
    return total


def readings(specifications: Sequence[Specification], loops: ClosedLoops) -> tuple[Reading, ...]:
    """Return the reading of each specification for a batch of one loop; an unstable loop meets none."""
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
    """Return the text of an InfeasibleError: what fails, and by how much, at the best candidate found."""
    at = ", ".join(f"{name} {value:.4g}" for name, value in parameters.items())
    failed = "".join(f"\n  {reading}" for reading in read if not reading.met)
    advice = "relax what fails, or choose another structure"
    if at_bounds:
        advice = f"at a search bound: {', '.join(at_bounds)}; widen the bounds, or relax what fails"
    return (
        f"no {what} within the search bounds meets all specifications. Best compromise ({at}):{failed}\n"
        f"Next: {advice}"
    )


def wanted_crossover(specifications: Sequence[Specification]) -> float:
    """Return the largest bandwidth that is specified, in rad/s; 0 if none is."""
    return max((s.limit for s in specifications if s.quantity.endswith("bandwidth_rad_s")), default=0.0)


def _db(gain: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.asarray(20.0 * np.log10(gain))


def _plane_frequency(loops: ClosedLoops, omega: float) -> float:
    """Return a true frequency in rad/s as a frequency of the loop's plane."""
    if loops.sampling is None:
        return omega
    half_sampling = np.pi / loops.sampling.period_s
    if not omega < half_sampling:
        raise DesignError(
            f"specification gain_db: up_to_rad_s {omega:g} is not under half the sampling frequency, "
            f"{half_sampling:.4g} rad/s at a period of {loops.sampling.period_s:g} s; lower it"
        )
    return float(loops.sampling.warp(omega))
