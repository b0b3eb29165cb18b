"""The process that reads MF4, called in this process."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import ClassVar

import can
import pytest

from hil.conversion import mf4_process
from hil.conversion.export import Format, export
from hil.conversion.frames import bus_frames
from hil.conversion.signals import Selection
from hil.recording.reader import Recording


def test_each_frame_is_one_record(run: Recording, tmp_path: Path) -> None:
    path = tmp_path / "run.mf4"
    export(run, path, Format.MF4_BUS, Selection())
    output = io.BytesIO()
    mf4_process.write_frames(path, output)
    records = list(mf4_process.RECORD.iter_unpack(output.getvalue()))
    frames = list(bus_frames(run, Selection()))
    assert len(records) == len(frames)
    for (time_ns, bus, flags, identifier, length, data), (epoch_ns, frame, _) in zip(
        records, frames, strict=True
    ):
        assert abs(time_ns - epoch_ns) < 1000
        assert (bus, flags, identifier, data[:length]) == (1, 0, frame.id, frame.data)


class Reader:
    """Stand-in for python-can's reader of MF4 files."""

    messages: ClassVar[list[can.Message]] = []

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise ValueError("not MF4\nsecond line")

    def __enter__(self) -> list[can.Message]:
        return self.messages

    def __exit__(self, *_error: object) -> None: ...


def test_frames_of_all_kinds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = [
        {"is_extended_id": True}, {"is_extended_id": False, "is_remote_frame": True},
        {"is_error_frame": True},
        {"is_fd": True, "data": bytes(64), "dlc": 64},
    ]  # fmt: skip
    messages = [can.Message(timestamp=1.0, channel=3, arbitration_id=5, **kind) for kind in kinds]
    monkeypatch.setattr(Reader, "messages", messages)
    monkeypatch.setattr(can, "MF4Reader", Reader)
    output = io.BytesIO()
    mf4_process.write_frames(tmp_path, output)
    flags = [record[2] for record in mf4_process.RECORD.iter_unpack(output.getvalue())]
    extended, remote, error, unreadable = flags
    assert extended == mf4_process.EXTENDED
    assert remote == mf4_process.REMOTE
    assert error & mf4_process.ERROR
    assert unreadable == mf4_process.UNREADABLE


@pytest.mark.parametrize("timestamp_s", [-1.0, 1e10, float("nan")])
def test_impossible_times_are_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, timestamp_s: float
) -> None:
    monkeypatch.setattr(Reader, "messages", [can.Message(timestamp=timestamp_s)])
    monkeypatch.setattr(can, "MF4Reader", Reader)
    with pytest.raises(ValueError, match="time stamp"):
        mf4_process.write_frames(tmp_path, io.BytesIO())


def test_a_failure_ends_the_process_with_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can, "MF4Reader", Reader)
    monkeypatch.setattr(sys, "argv", ["mf4_process", "none.mf4"])
    with pytest.raises(SystemExit) as ended:
        mf4_process.main()
    assert ended.value.code == "ValueError: not MF4"
