"""Compares what a controller file promises with what was measured in a run.

A controller that ``hil design`` made names its specifications in ``origin.specifications``: quantity, limit,
the value that the design predicts, and whether it meets the limit. Overshoot, settling time, rise time and
error can be read off a step.
"""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Any, NamedTuple

from hil.views.summary import StepResponse

LABELS = {
    "overshoot": "overshoot",
    "settling_s": "2 % settling time",
    "rise_s": "rise time from 10 to 90 %",
    "error": "steady-state error over the step's size",
}
"""Quantities that a step shows, in words. Their limits are upper limits."""
PARTS = frozenset({"overshoot", "error"})
"""Quantities that are parts of the step's size. They are shown in per cent."""
NOT_JUDGED = frozenset({"error"})
"""Quantities that are shown and not judged.

The promised error is that of the linear loop as t goes to infinity. A measured one contains friction and the
resolution of the potentiometer.
"""


class Outcome(StrEnum):
    """Verdict on one promise."""

    MET = "met"
    MISSED = "not met"
    NOT_MEASURED = "not measured"
    SHOWN = "not judged"


class Promise(NamedTuple):
    """One specification of a controller file, beside its measurement."""

    axis: str
    quantity: str
    """The quantity in words."""
    sign: str
    """"≤" if the value may not exceed the limit, "≥" if it may not be below it, empty if that is unknown."""
    limit: float
    predicted: float | None
    """Value that the design predicts; None if the file has none."""
    measured: float | None
    """Value of the run; None if the run does not show it."""
    unit: str
    """Unit of the limit and of both values; "%" for parts of the step's size."""
    outcome: Outcome


def promises(axis: str, origin: dict[str, Any], measured: object) -> list[Promise]:
    """Return the promises in the ``origin`` of a controller file; empty if it has none.

    ``measured``: the figures of the axis in the run, as ``views.summary`` gives them. What is not a
    :class:`StepResponse` shows none of the quantities.
    """
    found = []
    entries = origin.get("specifications")
    for entry in entries if isinstance(entries, list) else []:
        if not isinstance(entry, dict) or not isinstance(entry.get("limit"), int | float):
            continue
        quantity = str(entry.get("quantity", ""))
        limit = float(entry["limit"])
        value = _measured(quantity, measured) if isinstance(measured, StepResponse) else None
        predicted = float(entry["value"]) if isinstance(entry.get("value"), int | float) else None
        scale, unit = (100.0, "%") if quantity in PARTS else (1.0, str(entry.get("unit", "")))
        found.append(
            Promise(
                axis,
                LABELS.get(quantity, str(entry.get("reading") or quantity)),
                _sign(quantity, predicted, limit, entry.get("met")),
                scale * limit,
                None if predicted is None else scale * predicted,
                None if value is None else scale * value,
                unit,
                _outcome(quantity, value, limit),
            )
        )
    return found


def _sign(quantity: str, predicted: float | None, limit: float, is_met: object) -> str:
    """Return on which side of the limit the value must be: the file says whether its prediction is there."""
    if quantity in LABELS:
        return "≤"
    if predicted is None or predicted == limit or not isinstance(is_met, bool):
        return ""
    return "≤" if (predicted < limit) == is_met else "≥"


def _measured(quantity: str, step: StepResponse) -> float | None:
    match quantity:
        case "overshoot":
            return step.overshoot_percent / 100.0
        case "settling_s":
            return math.inf if step.settling_s is None else step.settling_s
        case "rise_s":
            return math.inf if step.rise_s is None else step.rise_s
        case "error":
            return abs(step.steady_state_error / (step.step_to - step.step_from))
    return None


def _outcome(quantity: str, value: float | None, limit: float) -> Outcome:
    if value is None:
        return Outcome.NOT_MEASURED
    if quantity in NOT_JUDGED:
        return Outcome.SHOWN
    return Outcome.MET if value <= limit else Outcome.MISSED
