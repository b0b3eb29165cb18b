"""Recordings that follow on one another: each is verified alone, and together they are the whole run."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from support.operated_runs import OperatedRun

from hil.core.errors import RecordingError
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.requests import ControllerRequest, JogRequest, Request, SetpointRequest
from hil.host.controller_files import SHIPPED_CONTROLLERS
from hil.recording.entries import Operated
from hil.recording.no_recorder import NoRecorder
from hil.recording.reader import Recording
from hil.shells.recordings import RotationLimits
from hil.shells.replay import setup_of, verify
from hil.shells.run_setup import SHIPPED
from hil.shells.session import Session

WHO = "uid 1000"
HORIZONTAL = (SHIPPED_CONTROLLERS / "horizontal.json").read_text()
SETPOINTS = {"vertical": "hold", "horizontal": "hold", "rotation": "ramp:0.2@0.1/1"}
SCRIPT: list[tuple[Request, int]] = [
    (Trigger.ARM, 2),
    (JogRequest("vertical", 0.4, 0.3), 40),
    (Trigger.START, 30),
    (SetpointRequest("vertical", "ladder:0.1,-0.05@0.1/0.3"), 30),
    (ControllerRequest("vertical", "new.json", HORIZONTAL), 40),
    (Trigger.STOP, 3),
    (Trigger.START, 30),
    (Trigger.STOP, 3),
]


def operate(run: OperatedRun) -> None:
    run.periods(20)
    for request, periods in SCRIPT:
        assert run.ask(request, WHO).accepted
        run.periods(periods)
    run.close()


PROTECTED_RIG = (
    re.sub(r"(?m)^# (?=read_back)", "", (SHIPPED / "rig.toml").read_text())
    + """
[emergency_stop]
frame = 0x290
byte = 0
bit = 0
timeout_s = 0.05

[enable]
frame = 0x290
byte = 0
bit = 1
timeout_s = 0.05
"""
)
"""The shipped rig file with every protection by hardware."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    operate(OperatedRun(path, SETPOINTS))
    return Recording(path)


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    """The same run in files of 0.15 s, some of which begin in the middle of a jog or of control."""
    folder = tmp_path_factory.mktemp("parts")
    operate(OperatedRun(folder / "run.mcap", SETPOINTS, RotationLimits(max_s=0.15)))
    files = ["run.mcap", *(f"run-{number}.mcap" for number in range(2, 100))]
    return [Recording(folder / name) for name in files if (folder / name).exists()]


def test_every_file_is_complete_and_verified_alone(parts: list[Recording]) -> None:
    assert len(parts) > 12
    for part in parts:
        report = verify(part)
        assert report.complete
        assert report.frames_compared > 3


def test_the_state_of_every_protection_is_carried_over(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(PROTECTED_RIG)
    (tmp_path / "runs").mkdir()
    operate(OperatedRun(tmp_path / "runs" / "run.mcap", SETPOINTS, RotationLimits(max_s=0.25), rig))
    files = list((tmp_path / "runs").iterdir())
    assert len(files) > 7
    for file in files:
        assert verify(Recording(file)).complete


def test_the_files_are_verified_as_one_run(parts: list[Recording], whole: Recording) -> None:
    paths = [part.path for part in parts]
    found, expected = verify(Recording(paths)), verify(whole)
    assert found.complete
    assert (found.calls, found.frames_compared) == (expected.calls, expected.frames_compared)
    assert found.periods_compared == expected.periods_compared
    assert verify(Recording(paths[5:])).complete, "the first files may have been removed"


def test_some_files_begin_while_an_axis_moves(parts: list[Recording]) -> None:
    first_states = [part.axis("vertical")["state"][0] for part in parts]
    assert first_states.count(LifeCycleState.RUNNING) > 6


def test_together_they_are_the_whole_run(whole: Recording, parts: list[Recording]) -> None:
    for which in ("sent", "received"):
        frames = whole.frames(which)  # type: ignore[arg-type]
        pieces = [part.frames(which) for part in parts]  # type: ignore[arg-type]
        for column in ("id", "data", "time_ns"):
            np.testing.assert_array_equal(frames[column], np.concatenate([piece[column] for piece in pieces]))


def test_a_file_says_where_it_goes_on(parts: list[Recording]) -> None:
    reasons = [part.metadata["ending"]["reason"] for part in parts]
    assert reasons[:-1] == [f"continued in run-{number}.mcap" for number in range(2, len(parts) + 1)]
    log = [entry.entry.text for entry in parts[1].log()]
    assert f"recording goes on in {parts[1].path}" in log


def test_changed_controllers_are_in_the_files_that_follow(parts: list[Recording]) -> None:
    name = "changed/controllers/vertical.json"
    assert name not in parts[0].attachments
    assert json.loads(parts[-1].attachments[name]) == json.loads(HORIZONTAL)
    assert setup_of(parts[-1]).setpoints["rotation"].text == "ramp:0.2@0.1/1"


def test_a_changed_state_is_found(parts: list[Recording]) -> None:
    part = Recording(parts[5].path)
    state = json.loads(part.attachments["core-state.json"])
    state["attributes"]["lost_samples"] += 1
    part.attachments["core-state.json"] = json.dumps(state).encode()
    with pytest.raises(RecordingError, match=r"the attachment core-state\.json was changed"):
        verify(part)


def test_a_state_of_another_program_is_refused(parts: list[Recording]) -> None:
    part = Recording(parts[5].path)
    part.attachments["core-state.json"] = b'{"class": "hil.core.gateway.Gateway", "id": 0, "attributes": {}}'
    part.metadata["documents"] = {}
    with pytest.raises(RecordingError, match=r"core-state\.json: the state of the core does not fit.*replay"):
        verify(part)


def test_only_so_many_files_are_kept(tmp_path: Path) -> None:
    limits = RotationLimits(max_s=0.2, max_files=3)
    run = OperatedRun(tmp_path / "run.mcap", SETPOINTS, limits)
    run.periods(200)
    run.close()
    kept = sorted(tmp_path.iterdir())
    assert [path.name for path in kept] == [f"run-{number}.mcap" for number in (10, 11, 9)]
    for path in kept:
        assert verify(Recording(path)).complete
    texts = [entry.text for entry in run.shown.entries if entry.source == "recorder"]
    assert texts[0] == f"recording goes on in {tmp_path / 'run-2.mcap'}"
    assert texts[2] == f"recording goes on in {tmp_path / 'run-4.mcap'}; removed: run.mcap"


class TestRequests:
    def test_a_new_recording_begins_on_request(self, tmp_path: Path) -> None:
        run = OperatedRun(tmp_path / "run.mcap", SETPOINTS)
        run.periods(20)
        reply = run.session.record_new(WHO)
        assert reply == (True, f"recording goes on in {tmp_path / 'run-2.mcap'}")
        run.periods(20)
        assert run.session.record_new(WHO, tmp_path / "other.mcap").accepted
        run.ask(Trigger.ARM, WHO)
        run.periods(5)
        run.close()
        for name in ("run.mcap", "run-2.mcap", "other.mcap"):
            assert verify(Recording(tmp_path / name)).complete
        texts = [entry.entry.text for entry in Recording(tmp_path / "run.mcap").log()]
        assert f"{WHO} asks: record new" in texts

    def test_no_file_is_overwritten(self, tmp_path: Path) -> None:
        run = OperatedRun(tmp_path / "run.mcap", SETPOINTS)
        (tmp_path / "run-2.mcap").write_text("mine")
        run.periods(5)
        assert run.session.record_new().text == f"recording goes on in {tmp_path / 'run-3.mcap'}"
        reply = run.session.record_new("", tmp_path / "run-2.mcap")
        assert not reply.accepted
        assert "run-2.mcap exists already; a recording overwrites no file" in reply.text
        run.periods(5)
        run.close()
        assert verify(Recording(tmp_path / "run-3.mcap")).complete

    def test_a_recording_ends_on_request_and_goes_on_later(self, tmp_path: Path) -> None:
        run = OperatedRun(tmp_path / "run.mcap", SETPOINTS, RotationLimits(max_s=0.1))
        run.periods(5)
        assert run.session.record_stop(WHO).text == f"recording ended: {tmp_path / 'run.mcap'}"
        assert run.session.record_stop(WHO) == (False, "nothing is recorded")
        run.periods(30)
        run.ask(Trigger.ARM, WHO)
        run.periods(30)
        assert not (tmp_path / "run-2.mcap").exists()
        assert run.session.record_new(WHO).accepted
        run.ask(Trigger.START, WHO)
        run.periods(5)
        run.close()
        assert verify(Recording(tmp_path / "run.mcap")).complete
        second = Recording(tmp_path / "run-2.mcap")
        assert verify(second).complete
        assert [e.request for e in second.entries() if isinstance(e, Operated)] == [Trigger.START]

    def test_without_recordings_the_requests_are_refused(self, tmp_path: Path) -> None:
        run = OperatedRun(tmp_path / "run.mcap", SETPOINTS)
        session = Session(run.gateway, run.plan, lambda _frame: True, lambda: 0, NoRecorder(), run.shown)
        for reply in (session.record_new(WHO), session.record_stop(WHO)):
            assert reply == (False, "this gateway was started without a recording (--no-record)")


def test_a_session_without_a_recorder_controls_all_the_same(tmp_path: Path) -> None:
    run = OperatedRun(tmp_path / "run.mcap", SETPOINTS)
    run.session._recorder = NoRecorder()
    run.periods(20)
    for request, periods in SCRIPT:
        assert run.ask(request, WHO).accepted
        run.periods(periods)
    assert run.gateway.state is LifeCycleState.ARMED


def test_a_file_that_cannot_be_written_any_more_is_not_shown_as_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = OperatedRun(tmp_path / "run.mcap")
    recordings = run.session._recordings
    assert recordings is not None
    assert recordings.written_path == tmp_path / "run.mcap"
    with monkeypatch.context() as context:
        context.setattr(run.recorder._pipe, "failure", "no space left on device", raising=False)
        assert recordings.written_path is None
        assert recordings.path == tmp_path / "run.mcap", "the next file is named after it"
    run.close()
