"""A daemon in a thread of this process, on simulated boards."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path

import pytest
from support.patient_rig import write_patient_rig

from hil.cli import daemon_run, main
from hil.core.errors import OperationError, RequestRefusedError
from hil.host.realtime_rights import Rights
from hil.operation.client import Client, connect
from hil.operation.socket_path import listening
from hil.recording.reader import Recording
from hil.recording.recorder import FAULT_SOURCE
from hil.shells.replay import verify

TIMEOUT_S = 60.0


class DaemonThread:
    """``hil daemon`` in a thread without real-time rights."""

    def __init__(self, path: Path, *arguments: str) -> None:
        self.status: int | None = None
        self.path = path
        self._thread = threading.Thread(
            target=self._run, args=(["daemon", "--socket", str(path), *arguments],), daemon=True
        )
        self._thread.start()

    def _run(self, argv: list[str]) -> None:
        self.status = main(argv)

    def client(self) -> Client:
        """Connect as soon as the daemon is in state ready."""
        while True:
            with contextlib.suppress(OperationError):
                client = connect(self.path)
                if client.status().state == "ready":
                    return client
            assert self._thread.is_alive()

    def end(self) -> int | None:
        self._thread.join(TIMEOUT_S)
        assert not self._thread.is_alive()
        return self.status


@pytest.fixture(autouse=True)
def without_rights(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(daemon_run, "real_time_rights", lambda *_s: contextlib.nullcontext(Rights(())))
    monkeypatch.chdir(tmp_path)


def test_a_daemon_on_the_simulated_arm(tmp_path: Path) -> None:
    daemon = DaemonThread(
        tmp_path / "s", "--rig", write_patient_rig(tmp_path / "rig.toml"), "--record", "run.mcap"
    )
    with daemon.client() as client:
        assert client.status().is_simulated
        assert client.status().recording == "run.mcap"
        client.arm()
        client.start()
        assert client.event("payload:3") == "event payload:3 happens now"
        assert client.event("payload:2@fault") == "event payload:2@fault waits for fault"
        client.set_setpoint("vertical", 0.02)
        client.record_new()
        later = client.status().period + 3
        assert next(look for look in client.watch(0.05) if look.period >= later).recording == "run-2.mcap"
        client.record_stop()
        assert client.status().recording is None
        client.record_new()
        later = client.status().period + 3
        next(look for look in client.watch(0.05) if look.period >= later)
        client.stop()
        assert "closes the recording" in client.shutdown()
    assert daemon.end() == 0
    names = ("run.mcap", "run-2.mcap", "run-3.mcap")
    for name in names:
        assert verify(Recording(tmp_path / name)).complete
    log = [entry for name in names for _, entry in Recording(tmp_path / name).log()]
    assert [entry.text for entry in log if entry.source == FAULT_SOURCE] == ["payload:3@0 begins"]
    assert Recording(tmp_path / "run-3.mcap").metadata["ending"]["reason"] == "interrupted"


def test_a_daemon_that_records_nothing(tmp_path: Path) -> None:
    daemon = DaemonThread(tmp_path / "s", "--no-record", "--linear")
    with daemon.client() as client:
        with pytest.raises(RequestRefusedError, match="--no-record"):
            client.record_new()
        with pytest.raises(RequestRefusedError, match="a linear model is simulated"):
            client.event("payload:3")
        client.shutdown()
    assert daemon.end() == 0
    assert not list(tmp_path.rglob("*.mcap"))


def test_another_daemon_can_begin_when_hil_shutdown_returns(tmp_path: Path) -> None:
    daemon = DaemonThread(tmp_path / "s", "--no-record", "--linear")
    daemon.client().close()
    assert main(["shutdown", "--socket", str(daemon.path)]) == 0
    with listening(daemon.path):
        pass
    assert daemon.end() == 0
