"""Bus logs become recordings with the same frames, and with the signals that the frames carry."""

from __future__ import annotations

import hashlib
import struct
import sys
import zlib
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import can
import numpy as np
import pytest
from support.recorded_runs import in_memory

from hil.conversion.export import Format, export
from hil.conversion.log_import import Document, Imported, import_log
from hil.conversion.signals import Selection
from hil.core.errors import DocumentError, EnvironmentLackError, RecordingError, RecordingExistsError
from hil.core.wire import codec
from hil.recording import open_recording
from hil.recording.reader import Recording

RIG = Document((files("hil.shipped") / "rig.toml").read_text(), "rig.toml")
DBC = Document((files("hil.core.wire") / "arm.dbc").read_text(), "arm.dbc")
COUNT_V = 10.0 / 32768


@pytest.fixture(autouse=True)
def without_a_process(tmp_path: Path) -> object:
    """Write the recordings in this process: the same bytes, without the start of another one."""
    with in_memory(tmp_path):
        yield


def imported(log: Path, *, channel: str | None = None, dbc: Document = DBC) -> tuple[Imported, Recording]:
    path = log.with_name(f"{log.stem}-imported.mcap")
    result = import_log(log, path, RIG, dbc, channel=channel, force=True)
    return result, open_recording(path)


@pytest.mark.parametrize("kind", [Format.CANDUMP, Format.ASC, Format.BLF, Format.MF4_BUS])
def test_an_exported_log_comes_back_with_equal_frames(run: Recording, tmp_path: Path, kind: Format) -> None:
    log = tmp_path / f"run{kind.suffix}"
    export(run, log, kind, Selection())
    result, back = imported(log)
    for which in ("received", "sent"):
        before, after = run.frames(which), back.frames(which)
        for column in ("id", "data", "length", "is_extended", "is_remote", "is_error"):
            assert np.array_equal(before[column], after[column]), (which, column)
        shift_ns = run.epoch_offset_ns - back.epoch_offset_ns
        assert np.abs(before.time_ns + shift_ns - after.time_ns).max() <= 1000
    assert (result.received, result.sent) == (len(run.frames("received")), len(run.frames("sent")))
    assert (result.unreadable, result.reordered) == (0, 0)


def test_signals_are_those_of_the_recorded_run(run: Recording, tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    export(run, log, Format.CANDUMP, Selection())
    result, back = imported(log)
    assert result.periods == len(run.axis("vertical"))
    assert back.axes == run.axes
    for name in run.axes:
        before, after = run.axis(name), back.axis(name)
        assert np.array_equal(before.fresh, after.fresh)
        good = before.fresh
        assert np.allclose(before.position[good], after.position[good], atol=1e-12)
        assert np.array_equal(before.potentiometer_v[good], after.potentiometer_v[good])
        assert np.abs(before.command_v - after.command_v)[good].max() <= COUNT_V / 2 + 1e-12
        assert np.all(np.isnan(after.setpoint)), "a log has no setpoints"
        assert np.allclose(np.diff(before.time_s), np.diff(after.time_s), atol=2e-6)
    states = [back.state_names[state] for state in np.unique(back.axis("vertical").state)]
    assert states == ["ready", "running"]
    running = back.axis("vertical").running
    assert abs(int(running.sum()) - int(run.axis("vertical").running.sum())) <= 2
    timing = back.timing()
    assert np.all(timing.receive_ns[timing.fresh] > 0)


def test_the_recording_says_where_it_comes_from(run: Recording, tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    export(run, log, Format.CANDUMP, Selection())
    _, back = imported(log)
    own = back.metadata["imported"]
    assert own["file"] == "run.log"
    assert own["format"] == "candump"
    assert own["sha256"] == hashlib.sha256(log.read_bytes()).hexdigest()
    assert own["period begins with"] == "SYNC"
    assert back.documents["rig.toml"] == RIG.text
    assert back.bus == "lockstep"
    assert back.complete


def test_a_log_without_sync_has_a_period_for_each_sample(tmp_path: Path) -> None:
    log = tmp_path / "samples.log"
    lines = [f"({1000 + 0.01 * k:.6f}) can0 190#004000400040{k:02X}00\n" for k in range(20)]
    log.write_text("".join(lines))
    result, back = imported(log)
    assert (result.periods, result.received, result.sent) == (20, 20, 0)
    assert back.axis("vertical").fresh.all()
    assert np.allclose(back.axis("vertical").potentiometer_v, 5.0)
    assert np.allclose(np.diff(back.axis("vertical").time_s), 0.01)
    assert set(back.axis("vertical").state.tolist()) == {1}


def test_another_dbc_moves_the_signals_and_the_identifiers(tmp_path: Path) -> None:
    text = DBC.text.replace("BO_ 400 TPDO1_ADC", "BO_ 401 TPDO1_ADC").replace(
        "Potentiometer1 : 0|16@1- (0.00030517578125,0)", "Potentiometer1 : 0|16@1- (0.0001,1)"
    )
    log = tmp_path / "other.log"
    log.write_text("(1.000000) can0 191#E8030040004000FF\n(1.010000) can0 190#0000000000000000\n")
    result, back = imported(log, dbc=Document(text, "my.dbc"))
    assert result.periods == 1
    assert back.axis("vertical").potentiometer_v.tolist() == pytest.approx([1.1])


def test_disorder_of_frames_is_repaired_and_counted(tmp_path: Path) -> None:
    log = tmp_path / "disorder.log"
    log.write_text("(1.000000) can0 080#\n(0.999000) can0 080#\n(1.010000) can0 080#\n")
    result, back = imported(log)
    assert result.reordered == 1
    assert np.diff(back.frames("sent").time_ns).tolist() == [0, 10_000_000]


def test_one_of_several_buses_is_chosen(tmp_path: Path) -> None:
    log = tmp_path / "two.log"
    log.write_text("(1.000000) can0 080#\n(1.001000) can1 190#00\n(1.002000) can1 190#01\n")
    with pytest.raises(RecordingError, match=r"2 buses \(can0, can1\); choose one with --channel"):
        imported(log)
    result, back = imported(log, channel="can1")
    assert (result.received, result.sent, back.bus) == (2, 0, "can1")
    with pytest.raises(RecordingError, match=r"no frame of bus 'can7' \(--channel\)"):
        imported(log, channel="can7")


def test_error_remote_extended_and_fd_frames(tmp_path: Path) -> None:
    log = tmp_path / "kinds.log"
    log.write_text(
        "(1.000000) can0 20000044#0102030405060708\n(1.000100) can0 710#R\n(1.000200) can0 710#R8\n"
        "(1.000300) can0 12345678#01\n(1.000400) can0 123##100112233445566778899\n\n"
        "(1.000500000) can0 FFF#\n(1.000600) can0 123#112\n(1.000700) can0 123#001122334455667788\n"
        "(1.000800) can0 123#R9\n"
    )
    result, back = imported(log)
    frames = back.frames("received")
    assert frames.id.tolist() == [0x44, 0x710, 0x710, 0x12345678]
    assert frames.is_error.tolist() == [True, False, False, False]
    assert frames.is_remote.tolist() == [False, True, True, False]
    assert frames.is_extended.tolist() == [False, False, False, True]
    assert frames.length.tolist() == [8, 0, 8, 1], "a remote frame keeps the length that it asks for"
    assert frames.data[0].tolist() == [1, 2, 3, 4, 5, 6, 7, 8]
    assert result.unreadable == 5


def test_a_relative_log_begins_at_zero(tmp_path: Path) -> None:
    log = tmp_path / "relative.log"
    log.write_text("(0.000000) can0 080#\n(0.011200) can0 080#\n")
    _, back = imported(log)
    assert back.epoch_offset_ns == 0
    assert back.frames("sent").time_ns.tolist() == [0, 11_200_000]


def damaged_blf(folder: Path) -> bytes:
    path = folder / "whole.blf"
    with can.BLFWriter(path) as writer:
        for number in range(1000):
            writer.on_message_received(can.Message(timestamp=1e9 + number, arbitration_id=0x190))
    content = bytearray(path.read_bytes())
    content[200:260] = bytes(60)
    return bytes(content)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"\x89MCAP0\r\n", "is a recording"),
        (b"time_s,u,y\n", "is no bus log"),
        (b"(1.0) can0 080#\nhello\n", "line 2 is not of the format of `candump -L`: 'hello'"),
        (b"(1.0) can0 080#" + b"0" * 10_000, "line 1 is not of the format"),
        (b"(9999999999.0) can0 080#\n", "line 1 is not of the format"),
        (b"\xff(1.0) can0 080#\n", "is no bus log"),
        (b"date Sat Nov 28 2026\nbase hex  timestamps absolute\n", "no frame of classic CAN|damaged"),
        (b"MDF     4.10    " + bytes(100), "damaged, or not MF4"),
        (b"LOGG" + bytes(20), "damaged, or not BLF"),
        (damaged_blf, "damaged, or not BLF"),
        (b"(100.0) can0 080#\n(98.5) can0 080#\n", r"time goes back by 1\.500 s at frame 2, limit 1 s"),
        (b"(1.0) can0 123##1\n", "has no frame of classic CAN; 1 others"),
    ],
)
def test_what_cannot_be_imported_is_refused_and_leaves_no_file(
    tmp_path: Path, content: bytes | Callable[[Path], bytes], message: str
) -> None:
    log = tmp_path / "log"
    log.write_bytes(content if isinstance(content, bytes) else content(tmp_path))
    before = sorted(tmp_path.iterdir())
    with pytest.raises(RecordingError, match=message):
        imported(log)
    assert sorted(tmp_path.iterdir()) == before


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    for path, message in ((tmp_path / "none.log", "No such file"), (tmp_path, "not a regular file")):
        with pytest.raises(RecordingError, match=message):
            import_log(path, tmp_path / "out.mcap", RIG, DBC)


def test_a_dbc_without_the_signals_is_refused(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    log.write_text("(1.0) can0 080#\n")
    for old, message in (
        ("RPDO1_DAC", "has no message RPDO1_DAC"),
        ("Potentiometer2", "message TPDO1_ADC has no signal Potentiometer2"),
    ):
        with pytest.raises(DocumentError, match=f"my.dbc: {message}"):
            imported(log, dbc=Document(DBC.text.replace(old, "Renamed"), "my.dbc"))


def test_an_existing_recording_is_kept(tmp_path: Path) -> None:
    log, path = tmp_path / "run.log", tmp_path / "run.mcap"
    log.write_text("(1.0) can0 080#\n")
    path.write_text("mine")
    with pytest.raises(RecordingExistsError):
        import_log(log, path, RIG, DBC)
    assert path.read_text() == "mine"


def test_imported_valve_commands_count_as_sent(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    log.write_text("(1.0) can0 080#\n(1.001) can0 190#0040004000400000\n(1.002) can0 220#0060004000400000\n")
    _, back = imported(log)
    assert back.frames("sent").id.tolist() == [codec.SYNC, codec.RPDO1_DAC]
    assert back.axis("vertical").command_v.tolist() == [7.5]
    assert back.axis("vertical").output_v.tolist() == [2.5]
    assert back.axis("vertical").running.tolist() == [True]


def test_a_crash_of_the_library_is_a_damaged_file(
    run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "run.mf4"
    export(run, log, Format.MF4_BUS, Selection())
    interpreter, crash = sys.executable, tmp_path / "crash.py"
    crash.write_text("import os\nos.write(1, bytes(30))\nos.abort()\n")
    monkeypatch.setattr("sys.executable", str(tmp_path / "python"))
    (tmp_path / "python").write_text(f"#!/bin/sh\nexec {interpreter} {crash}\n")
    (tmp_path / "python").chmod(0o755)
    with pytest.raises(RecordingError, match="damaged, or not MF4: the library that reads it crashed"):
        imported(log)


def test_mf4_without_asammdf_names_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "run.mf4"
    log.write_bytes(b"MDF     4.10    " + bytes(100))
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(EnvironmentLackError, match=r"pip install 'pneumatic-hil\[mf4\]'"):
        imported(log)


def test_a_container_that_inflates_to_gigabytes_is_refused(tmp_path: Path) -> None:
    """100 kB would become 100 MB here; nothing stops a log from stating more."""
    bomb = zlib.compress(bytes(100_000_000), 9)
    container = struct.pack("<H6xL4x", 2, 1000) + bomb
    log = tmp_path / "bomb.blf"
    with can.BLFWriter(log) as writer:
        writer.on_message_received(can.Message(timestamp=1e9, arbitration_id=0x190))
    place = log.stat().st_size
    place += place % 4
    with log.open("ab") as file:
        file.write(bytes(place - file.tell()))
        file.write(struct.pack("<4sHHLL", b"LOBJ", 16, 1, 16 + len(container), 10) + container)
    with pytest.raises(RecordingError, match=r"container at byte \d+ inflates to more than the limit 32 MiB"):
        imported(log)


def test_an_import_that_fails_half_way_leaves_no_file(
    run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "run.log"
    export(run, log, Format.CANDUMP, Selection())

    def interrupt(share: float) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    monkeypatch.setattr("hil.conversion.log_import.WATCH_FRAMES", 50)
    with pytest.raises(KeyboardInterrupt):
        import_log(log, tmp_path / "back.mcap", RIG, DBC, watch=interrupt)
    assert [path.name for path in tmp_path.iterdir()] == ["run.log"]


def test_a_full_disk_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "run.log"
    log.write_text("(1.0) can0 080#\n")
    monkeypatch.setattr("support.recorded_runs.DirectWriter.failure", "No space left on device")
    with pytest.raises(RecordingError, match=r"back\.mcap: cannot be written: No space left on device"):
        import_log(log, tmp_path / "back.mcap", RIG, DBC)
    assert [path.name for path in tmp_path.iterdir()] == ["run.log"]
