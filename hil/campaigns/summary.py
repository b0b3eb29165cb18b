"""What the results of a campaign say, fault by fault, and which cases are the worst."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from hil.campaigns.case import FAILED, CaseResult

SHOWN_FAILURES: Final = 10
"""Number of failed cases that the summary names."""


@dataclass
class FaultSummary:
    """The cases with one fault, whatever its moment."""

    cases: int = 0
    failed: int = 0
    ended_in_fault: int = 0
    """Number of cases at whose end the gateway is in state fault."""
    max_periods: int | None = None
    """Largest number of periods until the valves stayed centred; None if they never were."""
    never_centred: int = 0
    """Number of cases in which they did not stay centred."""
    max_error: float = 0.0
    """Largest control error as a fraction of the axis' range."""

    def add(self, result: CaseResult) -> None:
        """Count a case."""
        self.cases += 1
        self.failed += result.verdict == FAILED
        self.ended_in_fault += result.state == "FAULT"
        periods = result.centred_after_periods
        if periods is None:
            self.never_centred += 1
        else:
            self.max_periods = max(periods, self.max_periods or 0)
        self.max_error = max(self.max_error, result.max_error)


@dataclass
class CampaignSummary:
    """All cases of a campaign. Its size does not depend on their number."""

    by_fault: dict[str, FaultSummary] = field(default_factory=dict)
    """Summary of each fault, by its text without the time; ``none`` without a fault."""
    failures: list[CaseResult] = field(default_factory=list)
    """The first failed cases, at most ``SHOWN_FAILURES``."""
    cases: int = 0
    failed: int = 0
    limits_broken: int = 0
    """Number of cases in which a valve command exceeded a limit."""

    def add(self, result: CaseResult) -> None:
        """Count a case."""
        name = result.fault.partition("@")[0] or "none"
        self.by_fault.setdefault(name, FaultSummary()).add(result)
        self.cases += 1
        self.limits_broken += not result.limits_held
        if result.verdict == FAILED:
            self.failed += 1
            if len(self.failures) < SHOWN_FAILURES:
                self.failures.append(result)


def summarise_campaign(results: Iterable[CaseResult]) -> CampaignSummary:
    """Return the summary of all results."""
    summary = CampaignSummary()
    for result in results:
        summary.add(result)
    return summary
