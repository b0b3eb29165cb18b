"""What is wrong with a record or a model, as typed findings with figure, limit and remedy."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from design.errors import DesignError


class Severity(StrEnum):
    """What a finding means for the model."""

    REFUSE = "refuse"
    """No model is given."""
    WARN = "warn"
    """The model is given, and is doubtful for this reason."""
    NOTE = "note"
    """The model is good. The finding says how it could be better."""


class Kind(StrEnum):
    """What a finding is about."""

    TOO_FEW_SAMPLES = "too few samples"
    GAPS = "gaps"
    CONSTANT_INPUT = "constant input"
    CONSTANT_OUTPUT = "constant output"
    EXCITATION = "too little excitation"
    SATURATION = "saturation"
    END_STOPS = "end stops"
    RESOLUTION = "resolution"
    DRIFT = "drift"
    FRICTION = "friction"
    FEEDBACK = "closed loop"
    SWAPPED = "channels swapped"
    UNITS = "units"
    SAMPLE_TIME = "sample time"
    IRREGULAR_TIMES = "irregular times"
    DEAD_TIME = "dead time"
    TIME_SHIFT = "time shift"
    UNSTABLE = "unstable"
    POOR_FIT = "poor fit"
    NOT_EXPLAINED = "dynamics not explained"
    UNCERTAIN = "uncertain parameters"
    SEARCH_BOUND = "search bound"
    NOT_CONVERGED = "not converged"
    NO_CONTINUOUS_MODEL = "no continuous model"


@dataclass(frozen=True)
class Finding:
    """One statement about a record or a model."""

    kind: Kind
    severity: Severity
    record: str
    """Name of the record."""
    signal: str
    """Name of the signal or of the quantity of the model."""
    figure: float
    """What was found."""
    limit: float
    """What the figure is compared with."""
    unit: str
    """Unit of figure and limit. Empty for a plain number."""
    text: str
    """What was found, in words with figure and limit."""
    remedy: str
    """What to do about it."""

    def __str__(self) -> str:
        return f"{self.record}: {self.signal}: {self.text}; {self.remedy}"


class RecordRefusedError(DesignError):
    """A record from which no model is given. ``findings`` holds every reason, and warnings beside them."""

    def __init__(self, findings: Iterable[Finding]) -> None:
        self.findings = tuple(findings)
        reasons = [str(finding) for finding in self.findings if finding.severity is Severity.REFUSE]
        super().__init__("\n".join(reasons))


def most_severe_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return each kind of finding once for each severity and signal, those that refuse first."""
    first: dict[tuple[Kind, Severity, str], Finding] = {}
    for finding in findings:
        first.setdefault((finding.kind, finding.severity, finding.signal), finding)
    order = list(Severity)
    return tuple(sorted(first.values(), key=lambda finding: order.index(finding.severity)))


def refuse_if_needed(findings: Iterable[Finding]) -> None:
    """Raise RecordRefusedError if one of the findings refuses the record."""
    listed = most_severe_first(findings)
    if any(finding.severity is Severity.REFUSE for finding in listed):
        raise RecordRefusedError(listed)
