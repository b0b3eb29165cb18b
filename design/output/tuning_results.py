"""Everything that a tuning found: what ``design.tuning`` computes and the tuning report shows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from hil.core.documents import Document

if TYPE_CHECKING:
    from design.closed_loop.specifications import Reading
    from design.identification.identify import Identification
    from design.models.plant import Plant
    from design.synthesis.design_file import DesignFile
    from design.synthesis.procedure import Design
    from hil.views.summary import StepResponse


MEASURED = ("overshoot", "settling_s", "error")
"""Names of the specifications that are read off a measured step."""
LABELS = {
    "overshoot": "overshoot",
    "settling_s": "settling time",
    "rise_s": "rise time",
    "error": "steady-state error",
    "bandwidth_rad_s": "crossover",
    "closed_bandwidth_rad_s": "closed-loop bandwidth",
    "gain_db": "low-frequency gain",
    "gain_margin_db": "gain margin",
    "phase_margin_deg": "phase margin",
    "effort_v": "valve voltage",
    "disturbance_peak": "disturbance gain",
}
"""Names of the specifications in words."""
MEASURED_ERROR_ALLOWANCE = 0.01
"""Share of the step by which a measured steady-state error may exceed the specified limit.

The specified error is that of the linear loop as t goes to infinity. A measured one contains the friction
that holds the axis, and the resolution of the potentiometer. The allowance is half of the settling band.
"""


class Condition(Document, frozen=True):
    """One condition under which the axis is identified and verified."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,40}$")]
    instruction: str = ""
    """What to do to the rig before the experiments, for the user of a real one."""
    events: list[str] = msgspec.field(default_factory=list)
    """Events on the simulated arm, as ``hil run --event`` takes them."""
    centre: float = 0.0
    """Position about which the axis is excited, in its unit."""


class Job(Document, frozen=True):
    """What is tuned; a results folder belongs to one job (``tune.json``)."""

    axis: str
    amplitude: float
    duration_s: float
    structure: str
    conditions: list[Condition]
    rig: str | None = None
    bus: str | None = None
    """Bus of the boards; None for lockstep."""
    design: str | None = None
    step: float | None = None
    controller: str | None = None
    digests: dict[str, str] = msgspec.field(default_factory=dict)
    """SHA-256 of the rig, controller and design file: a folder is resumed with the same contents only."""
    overrides: list[str] = msgspec.field(default_factory=list)
    """Checks of the gateway that do not keep it from arming. They are no part of what is tuned."""


@dataclass(frozen=True)
class Model:
    """The model of one condition."""

    condition: Condition
    plant: Plant
    identification: Identification
    plant_file: Path


@dataclass(frozen=True)
class MeasuredReading:
    """The value of one specification, read off a measured step, beside its limit."""

    quantity: str
    value: float
    """In the unit of the specification; infinite for a step that did not settle."""
    limit: float
    """Limit that the measured value is judged by."""
    specified: float
    """Limit of the design file. That of the steady-state error is smaller than ``limit``."""

    @property
    def met(self) -> bool:
        """True if the value is not over the limit."""
        return self.value <= self.limit

    @property
    def uses_allowance(self) -> bool:
        """True if the value is over the specified limit, and not over the one that it is judged by."""
        return self.met and self.value > self.specified

    def __str__(self) -> str:
        value, limit = value_text(self.quantity, self.value), value_text(self.quantity, self.limit)
        return f"{LABELS[self.quantity]} {value}, limit {limit}"


@dataclass(frozen=True)
class Verified:
    """A step of the axis with the new controller under one condition."""

    condition: Condition
    recording: Path
    measured: StepResponse
    failures: tuple[str, ...]
    """Specifications that the measured step does not meet, in words."""


@dataclass(frozen=True)
class Tuning:
    """Everything that a tuning found."""

    job: Job
    models: tuple[Model, ...]
    """Models of all conditions; the first is the nominal one, which the controller was designed for."""
    design_file: DesignFile
    requested_settling_s: float | None
    """Limit on the settling time that was asked for first; None where a design file states it."""
    design: Design
    controller_file: Path
    verified: tuple[Verified, ...]
    """Measured steps, one for each condition."""
    warnings: tuple[str, ...] = ()

    @property
    def is_guaranteed(self) -> bool:
        """True if the margin alone proves that every identified model is stabilised."""
        return all(guarantee.guaranteed for guarantee in self.design.guarantees)

    @property
    def is_stable_on_all(self) -> bool:
        """True if the controller stabilises every identified model, by direct computation."""
        return self.design.measures[0].stable and all(g.eps_there > 0.0 for g in self.design.guarantees)

    @property
    def judged(self) -> frozenset[str]:
        """Names of the specifications that apply to the designed loop.

        Those that eq. (9) reads off the shaped plant Gs apply only if ``must_meet_specifications`` is set.
        """
        is_binding = self.design_file.controller.must_meet_specifications
        pairs = zip(self.design.weight.readings, self.design.designed_readings, strict=True)
        return frozenset(
            designed.quantity
            for selecting, designed in pairs
            if is_binding or selecting.reading == designed.reading
        )

    @property
    def predictions(self) -> tuple[tuple[Reading, ...], ...]:
        """Specifications read off the loop of the designed controller with each model, in their order."""
        from design.closed_loop.specifications import readings

        specifications = self.design.design_file.specifications.requested()
        controller = self.design.designed.controller
        return tuple(
            readings(specifications, replace(self.design.problem, plant=model.plant).loops(controller))
            for model in self.models
        )

    @property
    def missed_predictions(self) -> tuple[tuple[Model, Reading], ...]:
        """Judged specifications that the loop with a model does not meet."""
        judged = self.judged
        return tuple(
            (model, reading)
            for model, read in zip(self.models, self.predictions, strict=True)
            for reading in read
            if reading.quantity in judged and not reading.met
        )

    @property
    def meets_specifications(self) -> bool:
        """True if the loops with all models, and every measured step, meet the specifications."""
        return not self.missed_predictions and not any(verified.failures for verified in self.verified)


def measured_readings(measured: StepResponse, design_file: DesignFile) -> tuple[MeasuredReading, ...]:
    """Return the specifications that a measured step shows, in the order of the design file."""
    size = abs(measured.step_to - measured.step_from)
    values = {
        "overshoot": 0.01 * measured.overshoot_percent,
        "settling_s": math.inf if measured.settling_s is None else measured.settling_s,
        "error": abs(measured.steady_state_error) / size,
    }
    return tuple(
        MeasuredReading(
            s.quantity,
            values[s.quantity],
            s.limit + (MEASURED_ERROR_ALLOWANCE if s.quantity == "error" else 0.0),
            s.limit,
        )
        for s in design_file.specifications.requested()
        if s.quantity in MEASURED
    )


def failures(measured: StepResponse, design_file: DesignFile) -> tuple[str, ...]:
    """Return the judged specifications that a measured step does not meet, in words."""
    read = measured_readings(measured, design_file)
    return tuple(str(reading) for reading in read if not reading.met)


def value_text(quantity: str, value: float) -> str:
    """Return a value of a specification with its unit; shares of the step are in per cent."""
    from design.closed_loop.specifications import QUANTITIES

    if not math.isfinite(value):
        return "never" if quantity.endswith("_s") and not quantity.endswith("rad_s") else "∞"
    if quantity in ("overshoot", "error"):
        return f"{100.0 * value:.3g} %"
    return f"{value:.4g} {QUANTITIES[quantity].unit}".rstrip()
