"""A run that an operator controls: recorded with who asked, and replayed to the byte."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.operated_runs import OperatedRun

from hil.core.controller_change import prepare_controller
from hil.core.errors import ReplayMismatchError
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import LogEntry, Severity
from hil.core.requests import (
    ArmRequest,
    CheckFailure,
    ControllerRequest,
    JogRequest,
    Request,
    SetpointRequest,
)
from hil.host.controller_files import SHIPPED_CONTROLLERS
from hil.recording.entries import Operated
from hil.recording.reader import Recording
from hil.shells.replay import verify

WHO = "uid 1000, pid 4711"
NO_FIFO = CheckFailure("SCHED_FIFO", "this machine refuses it")
PPID = (SHIPPED_CONTROLLERS / "ppid.json").read_text()
HORIZONTAL = (SHIPPED_CONTROLLERS / "horizontal.json").read_text()
REQUESTS: list[tuple[Request, int, bool]] = [
    (JogRequest("vertical", 0.4, 0.2), 2, False),
    (ArmRequest((NO_FIFO,)), 2, False),
    (ArmRequest((NO_FIFO,), ("SCHED_FIFO",)), 2, True),
    (Trigger.DISARM, 2, True),
    (Trigger.ARM, 2, True),
    (JogRequest("vertical", 0.4, 0.2), 10, True),
    (JogRequest("vertical", -0.4, 0.2), 25, True),
    (JogRequest("vertical", 4.0, 0.2), 1, False),
    (SetpointRequest("vertical", "0.05"), 1, True),
    (Trigger.START, 40, True),
    (Trigger.START, 1, False),
    (SetpointRequest("vertical", "ladder:0.1,-0.05@0.1/0.3"), 60, True),
    (SetpointRequest("vertical", "0.2"), 1, False),
    (SetpointRequest("vertical", "csv:t.csv", "0,0\n0.5,0.05\n"), 60, True),
    (SetpointRequest("vertical", "csv:t.csv"), 1, False),
    (ControllerRequest("vertical", "new.json", HORIZONTAL), 40, True),
    (ControllerRequest("vertical", "broken.json", "{}"), 1, False),
    (ControllerRequest("rotation", "ppid", PPID), 1, False),
    (SetpointRequest("rotation", "hold"), 5, True),
    (SetpointRequest("elbow", "0.1"), 1, False),
    (ControllerRequest("vertical", "ppid", PPID), 40, True),
    (Trigger.STOP, 5, True),
    (Trigger.START, 40, True),
    (Trigger.STOP, 2, True),
    (Trigger.DISARM, 2, True),
]
"""Requests, the periods after each, and whether it is accepted."""


@pytest.fixture(scope="module")
def operated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("operated") / "run.mcap"
    run = OperatedRun(path, {"vertical": "step:0.1@0.1", "horizontal": "hold", "rotation": "hold"})
    run.periods(20)
    for request, periods, is_accepted in REQUESTS:
        reply = run.ask(request, WHO)
        assert reply.accepted is is_accepted, reply.text
        if not reply.text.startswith("jog goes on"):
            assert reply.text in "; ".join(entry.text for entry in run.shown.entries)
        run.periods(periods)
    run.close()
    return path


def test_the_replay_is_the_run_to_the_byte(operated: Path) -> None:
    report = verify(Recording(operated))
    assert report.complete
    assert report.frames_compared > 600
    assert report.log_entries_compared >= len(REQUESTS)


def test_every_request_is_recorded_with_who_asked(operated: Path) -> None:
    entries = [entry for entry in Recording(operated).entries() if isinstance(entry, Operated)]
    assert [(entry.request, entry.asked_by) for entry in entries] == [(r, WHO) for r, _, _ in REQUESTS]


def test_the_log_has_the_request_and_the_reply(operated: Path) -> None:
    log = [entry.entry for entry in Recording(operated).log()]
    place = log.index(LogEntry(Severity.INFO, "operator", f"{WHO} asks: setpoint of vertical: 0.2"))
    assert log[place + 1].source == "vertical"
    assert "beyond 0.15 m (rig: axes.vertical.max_y)" in log[place + 1].text
    assert LogEntry(Severity.INFO, "operator", f"{WHO} asks: jog vertical by +0.4 V for 0.2 s") in log
    assert not any("-0.4 V" in entry.text for entry in log)  # a part of the jog that goes on
    assert LogEntry(Severity.INFO, "operator", f"{WHO} asks: controller of rotation: ppid") in log
    assert LogEntry(Severity.INFO, "operator", f"{WHO} asks: arm") in log


def test_a_changed_request_is_found(operated: Path, tmp_path: Path) -> None:
    recording = Recording(operated)
    entries = list(recording.entries())
    place = next(
        number
        for number, entry in enumerate(entries)
        if isinstance(entry, Operated) and entry.request == SetpointRequest("vertical", "0.05")
    )
    changed = entries[place]
    assert isinstance(changed, Operated)
    entries[place] = changed._replace(request=SetpointRequest("vertical", "0.06"))
    recording.entries = lambda: iter(entries)  # type: ignore[method-assign]
    with pytest.raises(ReplayMismatchError, match=r"recorded info vertical: setpoint 0\.05, .* 0\.06"):
        verify(recording)


def test_the_same_requests_give_the_same_file(operated: Path, tmp_path: Path) -> None:
    path = tmp_path / "again.mcap"
    run = OperatedRun(path, {"vertical": "step:0.1@0.1", "horizontal": "hold", "rotation": "hold"})
    run.periods(20)
    for request, periods, _ in REQUESTS:
        run.ask(request, WHO)
        run.periods(periods)
    run.close()
    assert path.read_bytes() == operated.read_bytes()


def test_every_command_outside_running_is_a_centring_command(operated: Path) -> None:
    recording = Recording(operated)
    for name in recording.axes:
        rows = recording.axis(name)
        assert set(rows["command_v"][rows["state"] != LifeCycleState.RUNNING]) == {5.0}


def test_a_trigger_of_the_plan_has_no_asker(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    run = OperatedRun(path)
    run.periods(20)
    run.session.operate(Trigger.ARM)
    run.close()
    (entry,) = [entry for entry in Recording(path).entries() if isinstance(entry, Operated)]
    assert (entry.request, entry.asked_by) == (Trigger.ARM, "")
    assert not any(entry.entry.source == "operator" for entry in Recording(path).log())


def test_a_prepared_controller_is_replayed_from_its_text(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    run = OperatedRun(path, {"vertical": "step:0.05@0"})
    run.periods(20)
    run.ask(Trigger.ARM)
    run.ask(Trigger.START)
    run.periods(20)
    request = ControllerRequest("vertical", "new.json", HORIZONTAL)
    reply = run.session.operate(request, WHO, prepare_controller(request, run.setup.rig))
    assert reply.text == "controller new.json takes over at the last command, without a bump"
    run.periods(50)
    run.close()
    assert verify(Recording(path)).frames_compared > 100


def test_the_controller_file_is_in_the_recording(operated: Path) -> None:
    for entry in Recording(operated).entries():
        if isinstance(entry, Operated) and isinstance(entry.request, ControllerRequest):
            assert json.loads(entry.request.document) == json.loads(HORIZONTAL)
            return
    raise AssertionError("no controller request")
