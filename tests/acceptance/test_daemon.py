"""``hil daemon`` as its users see it: operated from outside, attacked, and ended."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from support.constants import CENTRED
from support.daemon_bench import HIL, TIMEOUT_S, Daemon, daemon, until
from support.patient_rig import write_patient_rig

from hil.cli.run_parts import free_udp_port
from hil.core.errors import OperationError, RequestRefusedError
from hil.core.life_cycle import LifeCycleState
from hil.core.rig import read_rig
from hil.core.wire import codec
from hil.operation.client import Client
from hil.operation.protocol import MAX_CONNECTIONS
from hil.recording.entries import FrameSent
from hil.recording.reader import Recording
from hil.shells.replay import verify

pytestmark = pytest.mark.real_time


@pytest.fixture
def rig(tmp_path: Path) -> str:
    """A rig file with limits that tolerate a machine that stalls."""
    return write_patient_rig(tmp_path / "rig.toml")


@pytest.fixture
def bus(rig: str) -> Iterator[str]:
    """A UDP bus with simulated boards on it."""
    name = f"udp:{free_udp_port()}"
    command = [sys.executable, "-m", "firmware_sim", "--linear", "--bus", name, "--rig", rig]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as boards:
        assert boards.stdout is not None
        assert "boards" in boards.stdout.readline(), "firmware-sim reports when it is on the bus"
        yield name
        boards.kill()


@pytest.fixture
def running(tmp_path: Path, rig: str, bus: str) -> Iterator[Daemon]:
    with daemon(tmp_path, "--rig", rig, "--bus", bus, "--controller", "rotation=ppid_rad") as started:
        with started.client() as client:
            until(client, lambda look: look.state == "ready")
        yield started


def commands(recording: Recording) -> list[tuple[float, ...]]:
    """Return the valve voltages of each command that was sent."""
    frames = [entry.frame for entry in recording.entries() if isinstance(entry, FrameSent)]
    return [codec.decode_rpdo1_dac(frame.data)[:3] for frame in frames if frame.id == codec.RPDO1_DAC]


def test_the_watchdog_of_systemd_is_not_served_while_the_loop_stalls(running: Daemon) -> None:
    """The whole process is stopped, as it is when the kernel does not let it run."""
    running.await_notification("WATCHDOG=1")
    os.kill(running.process.pid, signal.SIGSTOP)
    try:
        running.forget_notifications()
        assert running.is_silent_for(1.0), "ten intervals of the notification"
    finally:
        os.kill(running.process.pid, signal.SIGCONT)
    running.await_notification("WATCHDOG=1")
    assert running.hil("shutdown").returncode == 0
    running.await_notification("STOPPING=1")


def test_a_daemon_is_operated_and_its_recording_verifies(running: Daemon) -> None:
    with running.client() as client:
        with pytest.raises(RequestRefusedError, match="start refused in state ready"):
            client.start()
        assert client.status().state == "ready", "a daemon never arms by itself"
        client.arm()
        assert client.status().state == "armed"
        client.start()
        client.set_setpoint("vertical", 0.05)
        look = until(client, lambda look: abs((look.axes[0].position or 0.0) - 0.05) < 0.003)
        assert look.state == "running"
        assert look.axes[0].setpoint == pytest.approx(0.05)
        with pytest.raises(RequestRefusedError, match=r"0\.2 m"):
            client.set_setpoint("vertical", 0.2)
        assert client.record_new() == f"recording goes on in {running.second_path}"
        client.stop()
        assert client.status().state == "armed"
        until(client, lambda look: look.axes[0].command_v == 5.0)
        client.disarm()
    running.await_notification("WATCHDOG=1")
    ended = running.hil("shutdown")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert running.end() == 0
    running.await_notification("STOPPING=1")
    assert not running.socket_path.exists()
    assert commands(Recording(running.second_path))[-1] == CENTRED
    recording = Recording(running.record_path)
    assert recording.complete
    verified = subprocess.run(
        [*HIL, "replay", str(running.record_path), str(running.second_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert verified.returncode == 0, verified.stdout + verified.stderr
    texts = [entry.text for _, entry in recording.log() if entry.source == "operator"]
    assert any("asks: setpoint of vertical: step:0.05@0" in text for text in texts)


def test_a_signal_centres_the_valves_and_closes_the_recording(running: Daemon) -> None:
    with running.client() as client:
        client.arm()
        client.set_setpoint("vertical", "sine:0.05@0/2")
        client.start()
        until(client, lambda look: abs(look.axes[0].position or 0.0) > 0.01)
    running.process.send_signal(signal.SIGTERM)
    assert running.end() == 0
    recording = Recording(running.record_path)
    assert recording.complete
    assert recording.axis("vertical")[-1]["state"] == LifeCycleState.ARMED
    assert commands(recording)[-1] == CENTRED
    assert verify(recording).complete
    assert list(recording.log())[-1][1].text == "SIGTERM ended the daemon"


def test_the_commands_say_what_happened(running: Daemon) -> None:
    for arguments, said in (
        (["arm"], "ready -> armed (arm)"),
        (["setpoint", "vertical=0.02", "rotation=hold"], "setpoint step:0.02@0"),
        (["controller", "vertical=ppid"], "controller ppid"),
        (["jog", "vertical=+0.3", "--for", "50ms"], "its valve is centred"),
    ):
        done = running.hil(*arguments)
        assert done.returncode == 0, done.stderr
        assert said in done.stdout
    with running.client() as client:
        until(client, lambda look: look.state == "armed")
    refused = running.hil("reset")
    assert refused.returncode == 1
    assert "reset refused in state armed" in refused.stderr
    status = running.hil("status")
    assert status.returncode == 0
    assert status.stdout.startswith("armed ")
    assert all(len(line) <= 80 for line in status.stdout.splitlines() if not line.startswith("record"))


def test_one_gateway_for_a_bus(running: Daemon, bus: str, rig: str, tmp_path: Path) -> None:
    """A second gateway of this machine sends nothing: the first one goes on without a fault."""
    second = subprocess.run(
        [*HIL, "run", "--bus", bus, "--rig", rig, "--record", str(tmp_path / "second.mcap")],
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert second.returncode == 2
    assert "of this machine is the gateway of this bus" in second.stderr
    assert not (tmp_path / "second.mcap").exists()
    other = [*HIL, "daemon", "--bus", bus, "--rig", rig, "--socket", str(tmp_path / "other.sock")]
    done = subprocess.run(other, capture_output=True, text=True, timeout=TIMEOUT_S, check=False, cwd=tmp_path)
    assert done.returncode == 2
    assert "of this machine is the gateway of this bus" in done.stderr
    with running.client() as client:
        assert client.status().state == "ready"
        client.arm()


def test_hostile_clients_move_no_valve_beyond_its_limits(running: Daemon, rig: str) -> None:
    """Garbage, a flood, an endless line, surplus connections and a client that never reads."""
    with running.client() as client:
        client.arm()
        client.set_setpoint("vertical", "sine:0.05@0/2")
        client.start()
        before = client.status()
    sockets = [_connect(running) for _ in range(MAX_CONNECTIONS)]
    for place, hostile in enumerate(sockets):
        data = (
            b"\xff" * 1000 + b"\n",
            b'{"request": "setpoint", "axis": "vertical", "setpoint": "step:0.05@0"}\n' * 3000,
            b"x" * 1_000_000,
            b'{"request": "watch", "interval_s": 0.05}\n' + b"y" * 1_000_000,
            b'{"request": "jog", "axis": "vertical", "offset_v": 9, "duration_s": 9}\n' * 1000,
        )[place % 5]
        _send_what_fits(hostile, data)
    for _ in range(300):
        _connect(running).close()
    for hostile in sockets[5:]:
        hostile.close()
    with _eventually_connected(running) as client:
        look = until(client, lambda look: look.period > before.period + 200)
        assert look.state == "running"
        client.stop()
        client.shutdown()
    for hostile in sockets[:5]:
        hostile.close()
    assert running.end() == 0
    recording = Recording(running.record_path)
    assert verify(recording).complete
    rate_v = {
        place: axis.valve.max_rate_v_s * recording_period(recording)
        for place, axis in enumerate(read_rig(Path(rig).read_text(), rig).axes.values())
    }
    for earlier, later in pairwise(commands(recording)):
        for place, limit_v in rate_v.items():
            is_centred = later[place] == 5.0
            assert is_centred or abs(later[place] - earlier[place]) <= 5 * limit_v
            assert 0.0 <= later[place] <= 9.9997
    late_ms = [entry.text for _, entry in recording.log() if entry.source == "operation"]
    assert late_ms == []


def recording_period(recording: Recording) -> float:
    rig = read_rig(recording.attachments["rig.toml"].decode(), "rig.toml")
    return rig.loop.period_s


def _connect(running: Daemon) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX)
    connection.connect(str(running.socket_path))
    connection.setblocking(False)
    return connection


def _send_what_fits(connection: socket.socket, data: bytes) -> None:
    try:
        connection.send(data)
    except OSError:
        return


def test_the_loop_goes_on_when_the_socket_process_is_killed(running: Daemon) -> None:
    """The server is started again. Without the process that starts it, the daemon goes on and says so."""
    with running.client() as client:
        client.arm()
        client.start()
    (keeper,) = _children(running.process.pid, "server_process")
    (server,) = _children(keeper, "server_process")
    os.kill(server, signal.SIGKILL)
    with _eventually_connected(running) as client:
        assert client.status().state == "running"
    assert "the server of the operator's socket ended (killed by signal 9)" in running.log()
    os.kill(keeper, signal.SIGKILL)
    while "the socket process has ended" not in running.log():
        os.sched_yield()
    with pytest.raises(OperationError, match="no daemon answers at"):
        while True:  # until the server has ended too
            running.client()
    running.process.terminate()
    assert running.end() == 0
    recording = Recording(running.record_path)
    assert recording.complete
    assert commands(recording)[-1] == CENTRED


def _children(pid: int, word: str) -> list[int]:
    """Return the child processes of ``pid`` whose command line has ``word``."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            stat = (folder / "stat").read_text()
            command = (folder / "cmdline").read_bytes()
        except OSError:
            continue
        if int(stat.rpartition(")")[2].split()[1]) == pid and word.encode() in command:
            found.append(int(folder.name))
    return found


def _eventually_connected(running: Daemon) -> Client:
    """Connect as soon as a server has been started again and has a status."""
    while True:
        try:
            client = running.client()
            client.status()
        except OperationError:
            continue
        return client
