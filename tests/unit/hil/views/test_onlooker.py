"""What an onlooker is told arrives in order; a stalled or dead onlooker never holds the teller up."""

from __future__ import annotations

import io
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from hil.core.gateway import Gateway
from hil.core.output import AxisSignals, Cycle, LogEntry, Severity
from hil.shells.run_setup import load_setup
from hil.views.display import STATUS_PERIODS, Display
from hil.views.onlooker import Onlooker, messages
from hil.views.watch import status


def test_messages_come_in_order_until_the_teller_closes() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.send(b'{"a": 1}')
    ours.send(b'{"b": [2, 3]}')
    ours.close()
    assert list(messages(theirs.detach())) == [{"a": 1}, {"b": [2, 3]}]


@pytest.fixture
def stalled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Onlooker:
    """An onlooker that never reads."""
    (tmp_path / "stalled.py").write_text("import signal\nsignal.pause()\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return Onlooker("stalled")


def test_a_stalled_onlooker_loses_messages_and_holds_nobody_up(stalled: Onlooker) -> None:
    for number in range(5000):
        stalled.tell({"number": number})  # would block for ever if it waited
    os.kill(stalled._process.pid, signal.SIGKILL)
    stalled._process.wait()
    stalled.tell({"to": "nobody"})
    stalled.close()


def test_an_onlooker_that_never_ends_is_killed(stalled: Onlooker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.views.onlooker.CLOSE_TIMEOUT_S", 0.05)
    os.kill(stalled._process.pid, signal.SIGSTOP)
    stalled.close()
    assert stalled._process.returncode == -signal.SIGKILL


def test_ctrl_c_in_the_terminal_never_reaches_an_onlooker(stalled: Onlooker) -> None:
    """Not even before it has imported anything: the terminal signals the processes of its session."""
    assert os.getsid(stalled._process.pid) != os.getsid(0)
    stalled._process.kill()
    stalled.close()


@pytest.mark.parametrize("state", ["running", "fault"])
def test_the_live_status_fits_80_columns_with_three_axes(state: str) -> None:
    console = Console(width=80, file=io.StringIO(), force_terminal=True, color_system=None)
    message = {
        "state": state,
        "time_s": 12345.6,
        "lateness_ms": 12.34,
        "missed": 1234,
        "rejected": 567,
        "axes": [[-0.15, -0.1499, 5.0], [0.1, 0.09, 4.5], [-1.5, 1.5, 9.99]],
    }
    console.print(status(message, [["vertical", "m"], ["horizontal", "m"], ["rotation", "rad"]]))
    told = console.file.getvalue()  # type: ignore[attr-defined]
    assert "…" not in told
    first, *axes = told.splitlines()
    for word in (state, "12345.6 s", "late ≤ 12.34 ms", "missed 1234", "rejected 567"):
        assert word in first
    assert len(axes) == 3
    for word in ("rotation", "+1.5000 rad", "-1.5000 rad", "9.99 V"):
        assert word in axes[2]


def test_the_display_prints_events_and_no_status_where_there_is_no_terminal() -> None:
    program = """
from hil.core.output import LogEntry, Severity
from hil.views.display import Display
display = Display([("vertical", "m")])
display.log(LogEntry(Severity.FATAL, "adc", "no good sample for 5 periods"))
display.close()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stderr == "adc: no good sample for 5 periods\n"
    assert done.stdout == ""


class Told:
    """In place of an onlooker."""

    def __init__(self) -> None:
        self.messages: list[dict[str, object]] = []

    def tell(self, message: dict[str, object]) -> None:
        self.messages.append(message)


def test_a_status_tells_the_worst_lateness_since_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Told()
    monkeypatch.setattr("hil.views.display.Onlooker", lambda _module: told)
    display = Display([("vertical", "m")])
    gateway: Gateway = load_setup(None, {}, {}).gateway(0)
    signals = AxisSignals(0.1, 0.09, 0.01, 0.1, 5.1, 7.7)
    for number in range(1, 2 * STATUS_PERIODS + 1):
        late_ns = 3_000_000 if number == 5 else 100_000
        due_ns = 7_000_000_000 + number * 11_200_000
        display.cycle(Cycle(number, due_ns, due_ns + late_ns, 0, gateway.state, True, (signals,)), gateway)
    display.log(LogEntry(Severity.INFO, "adc", "operational"))
    axes, first, second, event = told.messages
    assert axes == {"axes": [("vertical", "m")]}
    assert (first["lateness_ms"], second["lateness_ms"]) == (3.0, 0.1)
    assert first["axes"] == [[0.1, 0.09, 5.1]]
    assert first["time_s"] == pytest.approx((STATUS_PERIODS - 1) * 0.0112)
    assert event == {"event": [20, "adc", "operational"]}
