"""Exported frames, read back by python-can and asammdf, and decoded by cantools."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import asammdf
import can
import cantools
import msgspec
import numpy as np
import pytest
from support.recorded_runs import RUN_HEADER, START_NS, in_memory

from hil.conversion.export import Format, export
from hil.conversion.frame_files import candump_text
from hil.conversion.frames import bus_frames
from hil.conversion.signals import Selection
from hil.core.frames import Frame
from hil.core.wire import codec
from hil.recording import open_recording
from hil.recording.reader import Recording
from hil.recording.recorder import Recorder

FORMATS = [Format.CANDUMP, Format.ASC, Format.BLF, Format.MF4_BUS]
READERS = {
    Format.CANDUMP: can.CanutilsLogReader,
    Format.ASC: lambda path: can.ASCReader(path, relative_timestamp=False),
    Format.BLF: can.BLFReader,
    Format.MF4_BUS: can.MF4Reader,
}


def exported(run: Recording, folder: Path, kind: Format) -> Path:
    path = folder / f"out{kind.suffix}"
    export(run, path, kind, Selection())
    return path


@pytest.mark.parametrize("kind", FORMATS)
def test_python_can_reads_every_frame_with_time_and_direction(
    run: Recording, tmp_path: Path, kind: Format
) -> None:
    messages = list(READERS[kind](exported(run, tmp_path, kind)))
    recorded = list(bus_frames(run, Selection()))
    assert len(messages) == len(recorded) > 100
    for message, (epoch_ns, frame, is_received) in zip(messages, recorded, strict=True):
        assert (message.arbitration_id, bytes(message.data)) == (frame.id, frame.data)
        assert (message.is_rx, message.is_extended_id) == (is_received, frame.is_extended)
        assert message.timestamp == pytest.approx(epoch_ns / 1e9, abs=2e-6)


def test_cantools_decodes_the_exported_samples_as_the_recorded_signals(
    run: Recording, tmp_path: Path
) -> None:
    database = cantools.database.load_file(str(files("hil.core.wire") / "arm.dbc"))
    samples = [
        database.decode_message(message.arbitration_id, message.data)
        for message in can.BLFReader(exported(run, tmp_path, Format.BLF))
        if message.arbitration_id == codec.TPDO1_ADC
    ]
    vertical = run.axis("vertical")
    decoded = [sample["Potentiometer1"] for sample in samples]
    assert np.allclose(decoded, vertical.potentiometer_v[vertical.fresh])


def test_asammdf_finds_a_bus_log_that_can_be_decoded(run: Recording, tmp_path: Path) -> None:
    path = exported(run, tmp_path, Format.MF4_BUS)
    dbc = str(files("hil.core.wire") / "arm.dbc")
    with asammdf.MDF(path) as file:
        decoded = file.extract_bus_logging({"CAN": [(dbc, 0)]})
        signal = decoded.get("Potentiometer1")
    vertical = run.axis("vertical")
    assert np.allclose(signal.samples, vertical.potentiometer_v[vertical.fresh])


def test_frames_of_one_instant_are_in_the_order_of_the_bus(run: Recording) -> None:
    """In simulated time, SYNC, sample and command have the same time stamp."""
    frames = [frame for _, frame, _ in bus_frames(run, Selection(from_s=1.0, to_s=1.5))]
    periods = [frame.id for frame in frames if frame.id in (codec.SYNC, codec.TPDO1_ADC, codec.RPDO1_DAC)]
    assert periods[:3] == [codec.SYNC, codec.TPDO1_ADC, codec.RPDO1_DAC]
    assert periods == periods[:3] * (len(periods) // 3)
    sent = [frame for _, frame, is_received in bus_frames(run, Selection()) if not is_received]
    table = run.frames("sent")
    assert [frame.id for frame in sent] == table.id.tolist(), "the order within a direction is kept"


def test_the_text_of_candump() -> None:
    assert candump_text(Frame(0x190, bytes.fromhex("00400040"))) == "190#00400040"
    assert candump_text(Frame(0x190, b"", True)) == "00000190#"
    assert candump_text(Frame(0x701, b"", False, True)) == "701#R"
    assert candump_text(Frame(0x44, bytes(8), False, False, True)) == "20000044#0000000000000000"


@pytest.fixture
def odd_frames(tmp_path: Path) -> Recording:
    """A recording of an extended, a remote and an error frame, on a bus with a space in its name."""
    path = tmp_path / "odd.mcap"
    with in_memory(path):
        recorder = Recorder(path, msgspec.structs.replace(RUN_HEADER, bus="my bus"), lossless=True)
    recorder.frame_received(Frame(0x12345678, b"\x01\x02", True), START_NS, START_NS)
    recorder.frame_received(Frame(0x701, b"", False, True), START_NS + 1_000_000, START_NS)
    recorder.frame_received(Frame(0x44, bytes(range(8)), False, False, True), START_NS + 2_000_000, START_NS)
    recorder.frame_sent(Frame(0x80), START_NS + 3_000_000)
    recorder.close({})
    return open_recording(path)


@pytest.mark.parametrize("kind", [Format.ASC, Format.BLF, Format.MF4_BUS])
def test_extended_remote_and_error_frames(odd_frames: Recording, tmp_path: Path, kind: Format) -> None:
    extended, remote, error, sync = READERS[kind](exported(odd_frames, tmp_path, kind))
    assert (extended.arbitration_id, extended.is_extended_id) == (0x12345678, True)
    assert (remote.arbitration_id, remote.is_remote_frame) == (0x701, True)
    assert error.is_error_frame
    assert (sync.arbitration_id, sync.is_rx) == (0x80, False)


def test_a_candump_log_names_the_bus_in_one_word(odd_frames: Recording, tmp_path: Path) -> None:
    lines = exported(odd_frames, tmp_path, Format.CANDUMP).read_text().splitlines()
    assert lines[0] == "(1700000005.000000) my_bus 12345678#0102 R"
    assert lines[2] == "(1700000005.002000) my_bus 20000044#0001020304050607 R"


def test_the_header_of_an_asc_file_has_the_time_of_the_first_frame(
    odd_frames: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Milliseconds have three digits: other tools would read .5 for 5 ms as half a second."""
    monkeypatch.setenv("TZ", "UTC")
    lines = exported(odd_frames, tmp_path, Format.ASC).read_text().splitlines()
    assert lines[0].startswith("date Tue Nov 14 ")
    assert lines[0].endswith(":25.000 2023")
    assert lines[3] == lines[0].replace("date", "Begin Triggerblock")
    assert lines[4].split() == ["0.000000", "1", "12345678x", "Rx", "d", "2", "01", "02"]
