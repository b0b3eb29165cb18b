"""The live display: what an observed run sends to the terminal, and what the terminal shows."""

from __future__ import annotations

import io
import math
import subprocess
import sys

import pytest
from rich.console import Console

from hil.core.gateway import Gateway
from hil.core.output import AxisSignals, Cycle, LogEntry, Severity
from hil.shells.run_setup import load_setup
from hil.views.live_display import STATUS_PERIODS, LiveDisplay
from hil.views.terminal import status


@pytest.mark.parametrize("state", ["running", "fault"])
def test_the_live_status_fits_80_columns_with_three_axes(state: str) -> None:
    console = Console(width=80, file=io.StringIO(), force_terminal=True, color_system=None)
    message = {
        "state": state,
        "time_s": 12345.6,
        "max_lateness_ms": 12.34,
        "missed": 1234,
        "rejected": 567,
        "axes": [[-0.15, -0.1499, 5.0], [0.1, 0.09, 4.5], [-1.5, 1.5, 9.99]],
    }
    console.print(status(message, [["vertical", "m"], ["horizontal", "m"], ["rotation", "rad"]]))
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    assert "…" not in shown
    first, *axes = shown.splitlines()
    for word in (state, "12345.6 s", "late ≤ 12.34 ms", "missed 1234", "rejected 567"):
        assert word in first
    assert len(axes) == 3
    for word in ("rotation", "+1.5000 rad", "-1.5000 rad", "9.99 V"):
        assert word in axes[2]


def test_the_live_status_shows_a_dash_before_the_first_sample() -> None:
    console = Console(width=80, file=io.StringIO(), color_system=None)
    message = {"state": "offline", "time_s": 0.0, "max_lateness_ms": 0.1, "missed": 0, "rejected": 0}
    console.print(status({**message, "axes": [[math.nan, math.nan, 5.0]]}, [["vertical", "m"]]))
    line = console.file.getvalue().splitlines()[1]  # type: ignore[attr-defined]
    assert line.split() == ["vertical", "–", "m", "setpoint", "–", "m", "valve", "5.00", "V"]


def test_without_a_terminal_only_log_entries_are_printed() -> None:
    program = """
from hil.core.output import LogEntry, Severity
from hil.views.live_display import LiveDisplay
display = LiveDisplay([("vertical", "m")])
display.log(LogEntry(Severity.FATAL, "adc", "no good sample for 5 periods [a"))
display.close()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stderr == "     0.00 s  adc: no good sample for 5 periods [a\n"
    assert done.stdout == ""


class SentMessages:
    """Stand-in for a display process."""

    def __init__(self) -> None:
        self.messages: list[dict[str, object]] = []

    def send(self, message: dict[str, object]) -> None:
        self.messages.append(message)


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> SentMessages:
    sent = SentMessages()
    monkeypatch.setattr("hil.views.live_display.DisplayProcess", lambda _module: sent)
    return sent


START_NS = 7_000_000_000
SIGNALS = AxisSignals(0.1, 0.09, 0.01, 0.1, 5.1, 7.7)


def gateway() -> Gateway:
    return load_setup(None, {}, {}).gateway(0)


def test_a_status_has_the_largest_lateness_since_the_last_one(sent: SentMessages) -> None:
    display, core = LiveDisplay([("vertical", "m")]), gateway()
    for number in range(1, 2 * STATUS_PERIODS + 1):
        late_ns = 3_000_000 if number == 5 else 100_000
        due_ns = START_NS + number * 11_200_000
        display.cycle(Cycle(number, due_ns, due_ns + late_ns, 0, core.state, True, (SIGNALS,)), core)
    axes, first, second = sent.messages
    assert axes == {"axes": [("vertical", "m")]}
    assert (first["max_lateness_ms"], second["max_lateness_ms"]) == (3.0, 0.1)
    assert first["axes"] == [[0.1, 0.09, 5.1]]
    assert first["time_s"] == pytest.approx((STATUS_PERIODS - 1) * 0.0112)


def test_a_log_entry_has_its_time_since_the_first_period(
    sent: SentMessages, monkeypatch: pytest.MonkeyPatch
) -> None:
    display, core = LiveDisplay([("vertical", "m")]), gateway()
    monkeypatch.setattr("hil.views.live_display.monotonic_ns", lambda: START_NS + 2_500_000_000)
    entry = LogEntry(Severity.INFO, "adc", "operational")
    display.log(entry)
    display.cycle(Cycle(1, START_NS, START_NS, 0, core.state, True, (SIGNALS,)), core)
    display.log(entry)
    assert sent.messages[1:] == [
        {"log": [0.0, 20, "adc", "operational"]},
        {"log": [2.5, 20, "adc", "operational"]},
    ]
