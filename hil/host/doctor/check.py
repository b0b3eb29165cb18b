"""One finding of the doctor."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class CheckVerdict(StrEnum):
    """How well a finding serves the control loop."""

    GOOD = "good"
    FAIR = "could be better"
    MISSING = "missing"
    """The simulated rig cannot run without it."""


class Check(NamedTuple):
    """One finding about this machine."""

    name: str
    """What was examined, such as ``clock source``."""
    verdict: CheckVerdict
    """How well the finding serves the control loop."""
    found: str
    """What was found."""
    advice: str
    """What to do, such as a command to copy. Empty exactly when the verdict is good."""


def check(name: str, found: str, advice: str = "", is_essential: bool = False) -> Check:
    """Return a finding, which is good if there is no advice.

    With ``is_essential``, a finding with advice is missing, otherwise it could be better.
    """
    verdict = CheckVerdict.GOOD
    if advice:
        verdict = CheckVerdict.MISSING if is_essential else CheckVerdict.FAIR
    return Check(name, verdict, found, advice)
