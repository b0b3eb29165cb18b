r"""The file of a campaign: faults, moments, set-ups and distributions, whose combinations are the cases.

The smallest file has a title and one fault. ``shipped/faults.toml``, ``bus.toml`` and ``robustness.toml``
are examples of whole ones.

>>> text = 'title = "lost samples"\n[[faults]]\nfault = "lose:sample"\nexpect = "fault"'
>>> case_at(read_campaign(text, "lost.toml"), 0).fault_text
'lose:sample@running+0.5'
"""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import Annotated, Literal, NamedTuple

import msgspec

from firmware_sim.faults.fault_text import parse_fault
from hil.core.documents import Document, from_toml
from hil.core.errors import DocumentError
from hil.core.rig import BitRate
from hil.core.suggestions import did_you_mean

SHIPPED = Path(__file__).parent / "shipped"
NO_FAULT = "none"


class Setup(Document, frozen=True):
    """One set-up of the rig. What it does not give is that of the rig file."""

    setpoints: dict[str, str] = msgspec.field(default_factory=dict)
    """Setpoint of an axis, as ``hil run --setpoint`` takes it."""
    controllers: dict[str, str] = msgspec.field(default_factory=dict)
    """Controller of an axis, as ``hil run --controller`` takes it."""
    conditions: list[str] = msgspec.field(default_factory=list)
    """Faults and events that belong to the set-up, such as the load ``payload:3@0``."""
    bit_rate: BitRate | None = None
    """Bit rate in bit/s of a modelled bus, on which frames take time and wait."""


class FaultCase(Document, frozen=True):
    """A fault without its time, and the reaction that is expected."""

    fault: str
    """Fault such as ``lose:sample,5``, or ``none``."""
    expect: Literal["fault", "running", "any"] = "any"
    """State at the end of the case. With ``any``, only the limits of the valve commands are judged."""
    max_periods: Annotated[int, msgspec.Meta(ge=0, le=10**9)] | None = None
    """Largest number of periods from the fault until the valves stay centred. None: not judged."""


class Criteria(Document, frozen=True):
    """Limits of the step response of an axis, for cases that are expected to keep running."""

    axis: str
    overshoot: Annotated[float, msgspec.Meta(ge=0.0)] | None = None
    """Largest overshoot as a fraction of the step."""
    settling_s: Annotated[float, msgspec.Meta(gt=0.0)] | None = None
    """Largest time in seconds until the position stays within 2 % of the step."""
    steady_state_error: Annotated[float, msgspec.Meta(ge=0.0)] | None = None
    """Largest magnitude of the mean error at the end, in the axis' unit."""


class Uniform(Document, frozen=True, rename={"low": "from", "high": "to"}):
    """A uniform distribution between ``from`` and ``to``."""

    low: float
    high: float

    def draw(self, random: Random) -> float:
        """Return a value."""
        return random.uniform(self.low, self.high)


class Campaign(Document, frozen=True):
    """Content of a campaign file."""

    title: str
    faults: Annotated[list[FaultCase], msgspec.Meta(min_length=1)]
    seed: Annotated[int, msgspec.Meta(ge=0)] = 0
    """Seed from which, together with the number of a case, all its randomness follows."""
    duration_s: Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)] = 3.0
    """Time of control of each case, in seconds."""
    draws: Annotated[int, msgspec.Meta(ge=1, le=10**7)] = 1
    """Number of repetitions of all combinations. More draws add cases and change no earlier one."""
    rig: str | None = None
    """Rig file, relative to the working directory; None for the shipped one."""
    moments: Annotated[list[str], msgspec.Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: ["running+0.5"]
    )
    """Times at which each fault begins, as ``hil run --fault`` takes them after ``@``."""
    setups: Annotated[list[Setup], msgspec.Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: [Setup()]
    )
    criteria: list[Criteria] = msgspec.field(default_factory=list)
    arm: dict[str, Uniform] = msgspec.field(default_factory=dict)
    """Distribution of a parameter of the arm file, by its dotted key."""


class Case(NamedTuple):
    """One combination."""

    number: int
    """Number of the case, from 0."""
    draw: int
    setup: int
    """Number of the set-up in the file, from 0."""
    moment: str
    fault: FaultCase

    @property
    def fault_text(self) -> str:
        """Fault with its time; empty without a fault."""
        return "" if self.fault.fault == NO_FAULT else f"{self.fault.fault}@{self.moment}"


def case_count(campaign: Campaign) -> int:
    """Return the number of cases."""
    return campaign.draws * len(campaign.setups) * len(campaign.moments) * len(campaign.faults)


def case_at(campaign: Campaign, number: int) -> Case:
    """Return a case by its number, from 0. The draw changes most slowly, the fault fastest."""
    rest, fault = divmod(number, len(campaign.faults))
    rest, moment = divmod(rest, len(campaign.moments))
    draw, setup = divmod(rest, len(campaign.setups))
    return Case(number, draw, setup, campaign.moments[moment], campaign.faults[fault])


def find_campaign(name: str) -> Path:
    """Return the file of a campaign: a shipped one by its name, or a path. Raises DocumentError."""
    shipped = sorted(path.stem for path in SHIPPED.glob("*.toml"))
    path = SHIPPED / f"{name}.toml" if name in shipped else Path(name)
    if not path.is_file():
        raise DocumentError(
            f"campaign {name}: there is no such file, and it is none of the shipped {', '.join(shipped)}"
            f"{did_you_mean(name, shipped)}"
        )
    return path


def read_campaign(text: str, source: str) -> Campaign:
    """Read and check the TOML text of a campaign. ``source`` is its name for errors. Raises DocumentError."""
    campaign = from_toml(text, Campaign, source)
    for fault in campaign.faults:
        for moment in campaign.moments:
            if fault.fault != NO_FAULT:
                parse_fault(f"{fault.fault}@{moment}")
        if fault.max_periods is not None and fault.expect != "fault":
            raise DocumentError(
                f"{source}: faults: {fault.fault}: max_periods is given, but expect is {fault.expect!r}; "
                'the valves stay centred only after a fault: write expect = "fault"'
            )
    for setup in campaign.setups:
        for text_of_condition in setup.conditions:
            parse_fault(text_of_condition)
    for key, distribution in campaign.arm.items():
        if distribution.low > distribution.high:
            raise DocumentError(
                f"{source}: arm.{key}: from {distribution.low:g} is more than to {distribution.high:g}"
            )
    return campaign
