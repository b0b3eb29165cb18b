"""Feeds of runs that never ran, for the tests of the live views."""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import hil
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState
from hil.core.output import AxisSignals, Cycle
from hil.live.feed import LiveFeed
from hil.live.feed_file import RunInformation

PERIOD_NS = 11_200_000
RIG_TEXT = (Path(hil.__file__).parent / "shipped" / "rig.toml").read_text()
STATES = [state.name.lower() for state in LifeCycleState]
RUN = RunInformation([("vertical", "m")], 0.0112, STATES, "rig.toml", "slcan:none", 0, 10**18, RIG_TEXT)
SIGNALS = AxisSignals(0.1, 0.09, 0.01, 1.0, 6.0, 7.0, 2)


def make_feed(run: RunInformation = RUN, link: Path | None = None) -> LiveFeed:
    return LiveFeed(run, {"vertical": "ppid"}, lambda: "run.mcap", link)


def cycle(number: int) -> Cycle:
    """Return a period that began 50 us late, with a sample after 200 us."""
    deadline_ns = number * PERIOD_NS
    wake_ns = deadline_ns + 50_000
    return Cycle(number, deadline_ns, wake_ns, wake_ns + 200_000, LifeCycleState.RUNNING, True, (SIGNALS,))


def write_periods(feed: LiveFeed, *numbers: int) -> None:
    """Write periods that were computed after 300 us and sent after 400 us."""
    for number in numbers:
        period = cycle(number)
        feed.period(period, period.wake_ns + 300_000, period.wake_ns + 400_000)


def gateway(**changed: object) -> mock.Mock:
    counts = dict.fromkeys(("missed_periods", "rejected_frames", "lost_samples", "error_frames"), 0)
    return mock.Mock(spec=Gateway, **{"fault_reason": None, "readiness": "both up", **counts, **changed})
