"""The verdict at the top of a report: how the run ended, what it lost, and which promises it kept."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from hil.recording.reader import Recording
from hil.views.promises import LABELS, Outcome, Promise
from hil.views.report_tables import limit_text, value_text
from hil.views.summary import Summary, losses

SLOWED_BY_FRICTION = frozenset({LABELS["settling_s"], LABELS["rise_s"]})
"""Quantities, in words, that dry friction makes longer than those of the linear plant."""
FRICTION_HINT = (
    " The linear plant has no dry friction. In an axis that has it, it is the usual cause of a longer time; "
    "a design with a smaller limit leaves room for it."
)


UNKNOWN_CAUSE = "an unknown cause; the daemon, or the process of the run, was killed or crashed"
"""Ending of a recording that its recorder closed although the run did not say why it ended."""


class Statement(NamedTuple):
    """A sentence of the verdict; ``style`` is a class of the style sheet: well, caution, or empty for bad."""

    style: str
    text: str


def verdict(summary: Summary, recording: Recording, promises: list[Promise]) -> list[Statement]:
    """Return the statements about a run; ``promises`` are those of its controller files."""
    return [*_endings(summary, recording), *_kept(promises)]


def _endings(summary: Summary, recording: Recording) -> Iterator[Statement]:
    fault = recording.metadata.get("ending", {}).get("fault", "")
    if not summary.complete:
        yield Statement("caution", "The recording was cut off. Everything here is about its contents.")
    elif summary.ending == "completed":
        yield Statement("well", f"The run was completed: {summary.controlled_s:.1f} s under control.")
    elif summary.ending == "interrupted":
        yield Statement(
            "caution", f"The run was interrupted after {summary.controlled_s:.1f} s under control."
        )
    else:
        ending = summary.ending or UNKNOWN_CAUSE
        yield Statement("", f"The run ended by {ending}{fault and ': '}{fault}")
    lost = losses(summary)
    if lost:
        yield Statement("", f"Lost or rejected: {', '.join(lost)}.")
    if summary.missed_periods or summary.periods_without_sample:
        yield Statement(
            "caution",
            f"{summary.missed_periods} of {summary.periods} periods were missed, and "
            f"{summary.periods_without_sample} had no good sample.",
        )


def _kept(kept: list[Promise]) -> Iterator[Statement]:
    judged = [p for p in kept if p.outcome in (Outcome.MET, Outcome.MISSED)]
    missed = [p for p in judged if p.outcome is Outcome.MISSED]
    if missed:
        texts = [
            f"{p.axis}: {p.quantity} {value_text(p.measured, p.unit)}, which must be {limit_text(p)} and was "
            f"predicted as {value_text(p.predicted, p.unit)} for the linear plant"
            for p in missed
        ]
        hint = FRICTION_HINT if any(p.quantity in SLOWED_BY_FRICTION for p in missed) else ""
        yield Statement("", f"Specifications not met: {'; '.join(texts)}.{hint}")
    elif judged:
        yield Statement("well", f"All {len(judged)} specifications that this run shows are met.")
    elif kept:
        yield Statement("caution", "The run shows none of the specifications: it has no step from rest.")
    else:
        yield Statement(
            "caution", "The controller files name no specifications, so there is no verdict on them."
        )
