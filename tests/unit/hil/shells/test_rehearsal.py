"""The second core that keeps the loop's code in the processor's caches."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.gateway_bench import rig_text
from support.protected_rigs import EMERGENCY_STOP, ENABLE

from hil.host.realtime_rights import Rights
from hil.shells.rehearsal import Rehearsal, polling_of
from hil.shells.run_setup import RunSetup, load_setup
from hil.shells.session import Session

PERIODS = 500


def setup_with(folder: Path, rig: str) -> RunSetup:
    path = folder / "rig.toml"
    path.write_text(rig)
    return load_setup(path, {}, {})


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"adc.protected": "false"},
        {"bus.wire_version": "1"},
        {"adc.heartbeat_timeout_s": "0.12", "dac.heartbeat_timeout_s": "0.12"},
    ],
    ids=["shipped", "without a counter", "wire version 1", "short heartbeat timeout"],
)
def test_a_rehearsal_controls_all_axes_for_as_long_as_it_is_called(
    changes: dict[str, str], tmp_path: Path
) -> None:
    rehearsal = Rehearsal(setup_with(tmp_path, rig_text(changes)))
    for _ in range(PERIODS):
        rehearsal()
        assert rehearsal.is_running


def test_it_needs_no_frames_of_an_emergency_stop_or_an_enable_switch(tmp_path: Path) -> None:
    rehearsal = Rehearsal(setup_with(tmp_path, rig_text() + EMERGENCY_STOP + ENABLE))
    rehearsal()
    assert rehearsal.is_running


def test_an_error_ends_the_rehearsals_and_not_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    rehearsal = Rehearsal(load_setup(None, {}, {}))
    error, calls = RuntimeError("defect"), []

    def fail(*_arguments: object) -> None:
        calls.append(1)
        raise error

    monkeypatch.setattr(Session, "on_deadline", fail)
    for _ in range(3):
        rehearsal()
    assert rehearsal.failure is error
    assert not rehearsal.is_running
    assert len(calls) == 1


def test_there_is_a_rehearsal_only_if_the_loop_polls_before_its_deadlines() -> None:
    setup = load_setup(None, {}, {})
    rights = Rights()
    rights.sample_poll_ns = 1_000_000
    assert polling_of(rights, setup).rehearse is None
    rights.poll_ns = 200_000
    polling = polling_of(rights, setup)
    assert polling.rehearse is not None
    assert (polling.before_deadline_ns, polling.for_sample_ns) == (200_000, 1_000_000)
