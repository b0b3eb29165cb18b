"""The verdict at the top of a report: how the run ended, what it lost, and which promises it kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from hil.core.output import LogEntry, Severity
from hil.recording.reader import Recording
from hil.recording.recorder import ARM_EVENTS, BEGINS, EVENT_SOURCE, FAULT_SOURCE, FAULTS_BEGUN
from hil.views.promises import LABELS, Outcome, Promise
from hil.views.report_tables import limit_text, value_text
from hil.views.summary import StepResponse, Summary, losses

SLOWED_BY_FRICTION = frozenset({LABELS["settling_s"], LABELS["rise_s"]})
"""Quantities, in words, that dry friction makes longer than those of the linear plant."""
FRICTION_HINT = (
    " The linear plant has no dry friction. In an axis that has it, it is the usual cause of a longer time; "
    "a design with a smaller limit leaves room for it."
)
UNKNOWN_CAUSE = "an unknown cause; the daemon, or the process of the run, was killed or crashed"
"""Ending of a recording that its recorder closed although the run did not say why it ended."""
IMPORTED = "imported from a bus log"
"""Ending of a recording that was imported completely."""
MAX_LISTED = 5
"""Number of simulated faults or events that the verdict names."""


class Statement(NamedTuple):
    """A sentence of the verdict; ``style`` is a class of the style sheet: well, caution, or empty for bad."""

    style: str
    text: str


def verdict(
    summary: Summary,
    recording: Recording,
    promises: list[Promise],
    log: Sequence[tuple[float, LogEntry]],
    origin: str,
) -> list[Statement]:
    """Return the statements about a run.

    ``promises``: those of its controller files; ``log``: its log, each entry with its time in seconds;
    ``origin``: what happened at time 0, such as "control began".
    """
    faults = [(at_s, entry) for at_s, entry in log if entry.severity == Severity.FATAL]
    return [
        _ending(summary, recording, faults, origin),
        *_simulated(recording, log, origin),
        *_faults(summary, faults, origin),
        *_losses(summary),
        *_kept(promises, summary, recording),
    ]


def _ending(
    summary: Summary, recording: Recording, faults: list[tuple[float, LogEntry]], origin: str
) -> Statement:
    if not summary.complete:
        return Statement("caution", "The recording was cut off. Everything here is about its contents.")
    if "imported" in recording.metadata:
        if summary.ending == IMPORTED:
            text = "The recording was imported from a bus log, which does not tell why the run ended."
            return Statement("well", text)
        return Statement("caution", "The import of the bus log did not finish, so the recording ends early.")
    if summary.ending == "completed":
        return Statement("well", f"The run was completed: {summary.controlled_s:.1f} s under control.")
    if summary.ending == "interrupted":
        # A daemon has no requested duration, so this is its normal end.
        style = "well" if summary.requested_s is None else "caution"
        text = (
            f"The run was ended by an operator or a signal after {summary.controlled_s:.1f} s under control."
        )
        return Statement(style, text)
    fault = recording.metadata.get("ending", {}).get("fault", "")
    at = f", {_since(faults[-1][0], origin)}" if faults and summary.ending == "fault" else ""
    return Statement("", f"The run ended by {summary.ending or UNKNOWN_CAUSE}{at}{fault and ': '}{fault}")


def _since(at_s: float, origin: str) -> str:
    """Return an instant in words, such as "1.949 s after control began"."""
    return f"{abs(at_s):.3f} s {'before' if at_s < 0.0 else 'after'} {origin}"


def _simulated(
    recording: Recording, log: Sequence[tuple[float, LogEntry]], origin: str
) -> Iterator[Statement]:
    """State which faults and events were simulated: what follows from them is no defect of the hardware."""
    begun = _begun(log, FAULT_SOURCE) or [
        (text, None) for text in recording.metadata.get(FAULTS_BEGUN, {}).values()
    ]
    if begun:
        yield Statement(
            "caution",
            f"Simulated faults began: {_timed(begun, origin)}. They may cause what "
            "other messages attribute to the boards, the cable or the arm.",
        )
    events = _begun(log, EVENT_SOURCE)
    if events:
        yield Statement("caution", f"Simulated events happened: {_timed(events, origin)}.")
    texts = {text for text, _ in begun + events}
    planned = [text for text in recording.metadata.get(ARM_EVENTS, {}) if text not in texts]
    if planned:
        yield Statement("caution", f"Events planned in the simulation: {_listed(planned)}.")


def _timed(begun: Sequence[tuple[str, float | None]], origin: str) -> str:
    """List faults or events with their times in words. The first time says what time 0 is."""
    texts = []
    for text, at_s in begun:
        if at_s is None:
            texts.append(text)
        elif not texts:
            texts.append(f"{text} at {_since(at_s, origin)}")
        else:
            texts.append(f"{text} at {at_s:.3f} s")
    return _listed(texts)


def _begun(log: Sequence[tuple[float, LogEntry]], source: str) -> list[tuple[str, float | None]]:
    """Return the text and the time of each fault or event of ``source`` that has begun."""
    return [
        (entry.text.removesuffix(BEGINS), at_s)
        for at_s, entry in log
        if entry.source == source and entry.text.endswith(BEGINS)
    ]


def _listed(texts: list[str]) -> str:
    more = len(texts) - MAX_LISTED
    return ", ".join(texts[:MAX_LISTED]) + (f" and {more} more" if more > 0 else "")


def _faults(summary: Summary, faults: list[tuple[float, LogEntry]], origin: str) -> Iterator[Statement]:
    """State the faults, unless the ending has stated the only one."""
    if not faults or (len(faults) == 1 and summary.complete and summary.ending == "fault"):
        return
    at_s, first = faults[0]
    count = "one fault" if len(faults) == 1 else f"{len(faults)} faults"
    came = "It came" if len(faults) == 1 else "The first one came"
    when = _since(at_s, origin)
    yield Statement("", f"The run had {count}. {came} {when}: {first.source}: {first.text}")


def _losses(summary: Summary) -> Iterator[Statement]:
    lost = losses(summary)
    if lost:
        yield Statement("", f"Lost or rejected: {', '.join(lost)}.")
    if summary.missed_periods:
        text = f"{summary.missed_periods} periods were skipped because the loop was late."
        yield Statement("caution", text)
    if summary.periods_without_sample:
        yield Statement(
            "caution",
            f"{summary.periods_without_sample} of the {summary.periods} recorded periods had no good sample.",
        )


def _kept(kept: list[Promise], summary: Summary, recording: Recording) -> Iterator[Statement]:
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
        reasons = [
            f"{axis}: a step does not show what they limit"
            if isinstance(summary.axes.get(axis), StepResponse)
            else f"{axis}: no step from rest"
            for axis in dict.fromkeys(p.axis for p in kept)
        ]
        yield Statement("caution", f"The run shows none of the specifications ({'; '.join(reasons)}).")
    elif not any(name.startswith("controllers/") for name in recording.attachments):
        yield Statement(
            "caution", "The recording has no controller files, so there is no verdict on specifications."
        )
    else:
        yield Statement(
            "caution", "The controller files name no specifications, so there is no verdict on them."
        )
