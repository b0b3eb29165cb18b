"""Say in plain words what a tuning found: stability, prediction, measurement, and relaxed limits."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from design.output.tuning_results import (
    LABELS,
    MEASURED_ERROR_ALLOWANCE,
    Tuning,
    measured_readings,
    value_text,
)


class Outcome(Enum):
    """What a statement means for the controller; the value is its sign."""

    GOOD = "✓"
    CAUTION = "!"
    """The reader must know it; nothing failed."""
    BAD = "✗"


@dataclass(frozen=True)
class Statement:
    """One statement of the verdict."""

    text: str
    outcome: Outcome


def verdict(tuning: Tuning) -> list[Statement]:
    """Return the statements of the verdict, in the order in which a reader needs them."""
    return [
        _stability(tuning),
        _prediction(tuning),
        _measurement(tuning),
        *_relaxed(tuning),
        *_allowed_error(tuning),
    ]


def _stability(tuning: Tuning) -> Statement:
    eps, guarantees = tuning.design.eps, tuning.design.guarantees
    if not tuning.is_stable_on_all:
        unstable = [g.plant.name for g in guarantees if not g.eps_there > 0.0]
        if not tuning.design.measures[0].stable:
            unstable.insert(0, tuning.design.plant.name)
        return Statement(
            f"The controller does not stabilise {_listed(unstable)}. Do not run it under these conditions.",
            Outcome.BAD,
        )
    if not guarantees:
        return Statement(
            "Only one model was identified, so nothing is proved for other conditions.", Outcome.CAUTION
        )
    largest = max(guarantees, key=lambda g: g.gap)
    if tuning.is_guaranteed:
        return Statement(
            "Robust stability is guaranteed over what was measured: every ν-gap to the nominal model (the "
            f"largest is {largest.gap:.3f}, {largest.plant.name}) is below ε {eps:.3f}.",
            Outcome.GOOD,
        )
    beyond = [f"{g.plant.name} ({g.gap:.3f})" for g in guarantees if not g.guaranteed]
    return Statement(
        f"Robust stability is not guaranteed by the margin: the ν-gap of {_listed(beyond)} to the nominal "
        f"model is not below ε {eps:.3f}. By direct computation, the controller stabilises each identified "
        "model; nothing is proved for plants between them.",
        Outcome.CAUTION,
    )


def _prediction(tuning: Tuning) -> Statement:
    missed = tuning.missed_predictions
    if not missed:
        return Statement("Prediction: the specifications are met with every identified model.", Outcome.GOOD)
    texts = [
        f"{model.condition.name}: {LABELS[reading.quantity]} "
        f"{value_text(reading.quantity, reading.value)}, limit {value_text(reading.quantity, reading.limit)}"
        for model, reading in missed
    ]
    return Statement(f"Prediction: specifications are not met. {'; '.join(texts)}.", Outcome.BAD)


def _measurement(tuning: Tuning) -> Statement:
    if not tuning.verified:
        return Statement("Measurement: no step was measured with the new controller.", Outcome.BAD)
    texts = [f"{v.condition.name}: {', '.join(v.failures)}" for v in tuning.verified if v.failures]
    if not texts:
        return Statement("Measurement: every measured step meets the specifications.", Outcome.GOOD)
    return Statement(f"Measurement: specifications are not met. {'; '.join(texts)}.", Outcome.BAD)


def _relaxed(tuning: Tuning) -> list[Statement]:
    used, asked = tuning.design_file.specifications.settling_s, tuning.requested_settling_s
    if used is None or asked is None or used == asked:
        return []
    return [
        Statement(
            f"The limit on the settling time was relaxed from {asked:g} s to {used:g} s, since no controller "
            "that was found met it on all models and on the rig. Every verdict on this page is about "
            f"{used:g} s.",
            Outcome.CAUTION,
        )
    ]


def _allowed_error(tuning: Tuning) -> list[Statement]:
    over = [
        f"{verified.condition.name} {value_text(reading.quantity, reading.value)}"
        for verified in tuning.verified
        for reading in measured_readings(verified.measured, tuning.design_file)
        if reading.uses_allowance
    ]
    if not over:
        return []
    allowance = value_text("error", MEASURED_ERROR_ALLOWANCE)
    return [
        Statement(
            f"The measured steady-state error is over the limit for the linear loop ({', '.join(over)}), and "
            f"within the {allowance} of the step that are allowed besides for friction and for the "
            "resolution of the sensor.",
            Outcome.CAUTION,
        )
    ]


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
