"""Every command that takes a recording refuses a bad one in one line, and leaves no half file."""

from __future__ import annotations

import random
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import can.io.mf4  # noqa: F401 - it loads asammdf, which would not be loaded completely on a full disk
import pyarrow.parquet  # noqa: F401
import pytest
import scipy.io  # noqa: F401
import zstandard
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC, Writer
from support.mcap_files import chunk_starts, record_bytes, records, without_end
from support.recorded_runs import record_run

from hil.cli import main
from hil.recording import open_recording
from hil.recording.handover import RECORD_HEADER

COMMANDS = {
    "replay": ["replay", "{}"],
    "replay onto a bus": ["replay", "{}", "--bus", "inproc:bad"],
    "replay another controller": ["replay", "{}", "--with-controller", "vertical=hls"],
    "export": ["export", "{}", "--to", "csv"],
    "export frames": ["export", "{}", "--to", "candump"],
    "report": ["report", "{}"],
    "compare": ["compare", "{}", "{}"],
}
OWN = {"format_version": "2", "epoch_offset_ns": "0", "bus": "can0"}
"""Metadata ``recording`` of a recording."""
OTHERS = {"recover": ["recover", "{}"], "import": ["import", "{}"]}


def of_another_tool(metadata: dict[str, str] | None = None) -> bytes:
    """Return an MCAP file without the channels of a recording; ``metadata`` are its ``recording``."""
    chunks: list[bytes] = []

    class Stream:
        def write(self, data: bytes) -> int:
            chunks.append(bytes(data))
            return len(data)

        def tell(self) -> int:
            return sum(map(len, chunks))

        def flush(self) -> None: ...

    writer = Writer(Stream())  # type: ignore[arg-type]
    writer.start("ros2")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
    channel = writer.register_channel("/chatter", "cdr", schema)
    writer.add_message(channel, 1, b"\0\1\0\0\2\0\0\0a\0", 1)
    if metadata is not None:
        writer.add_metadata("recording", metadata)
    writer.finish()
    return b"".join(chunks)


BAD: dict[str, Callable[[], bytes]] = {
    "empty": lambda: b"",
    "text": lambda: b"no recording\n" * 100,
    "magic alone": lambda: MCAP0_MAGIC,
    "random": lambda: random.Random(1).randbytes(50_000),
    "random after the magic": lambda: MCAP0_MAGIC + random.Random(2).randbytes(50_000),
    "zeros": lambda: bytes(100_000),
    "another tool's": of_another_tool,
    "future version": lambda: of_another_tool(
        {"format_version": "99", "epoch_offset_ns": "0", "bus": "can0"}
    ),
    "no channels": lambda: of_another_tool({"format_version": "2", "epoch_offset_ns": "0", "bus": "can0"}),
    "gigabytes in a frame": lambda: (
        MCAP0_MAGIC + record_bytes(Chunk("zstd", zstandard.compress(bytes(2**30)), 0, 0, 0, 2**30))
    ),
    "a false length": lambda: MCAP0_MAGIC + RECORD_HEADER.pack(6, 2**62) + bytes(100),
}


def status_of(arguments: list[str]) -> int:
    try:
        return main(arguments)
    except SystemExit as ended:
        return int(str(ended.code))


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_file_is_refused_in_one_line_and_nothing_is_written(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.mcap").write_bytes(BAD[kind]())
    for name, command in (COMMANDS | OTHERS).items():
        if name == "recover" and kind in ("another tool's", "future version", "no channels"):
            continue  # These files are whole.
        assert status_of([part.format("bad.mcap") for part in command]) == 2, name
        error = capsys.readouterr().err
        assert "bad.mcap" in error, name
        assert len(error.splitlines()) == 1, name
        assert [path.name for path in tmp_path.iterdir()] == ["bad.mcap"], name


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    record_run(path, 100)
    return path.read_bytes()


def test_a_file_cut_at_every_byte_of_its_last_chunk_gives_what_is_before_it(tmp_path: Path) -> None:
    """The file is small, so that thousands of cuts take seconds. Cuts within the summary lose nothing."""
    torn = tmp_path / "torn.mcap"
    record_run(torn, 50)
    content = torn.read_bytes()
    end = len(without_end(content))
    starts = chunk_starts(content)
    found = {}
    for size in (*range(starts[-1], end), *range(end, len(content), 61)):
        torn.write_bytes(content[:size])
        opened = open_recording(torn)
        assert not opened.complete
        found[size] = opened.counts.get("/gateway/cycle", 0)
    before, whole = found[starts[-1]], 56
    assert 0 < before < whole
    chunk_end = next(record_end for _, start, record_end in records(content) if start == starts[-1])
    assert found == {size: whole if size >= chunk_end else before for size in found}


@contextmanager
def room_for(size: int) -> Iterator[None]:
    """Let no file grow beyond ``size`` bytes, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize(
    "command",
    [
        *(["export", "run.mcap", "--to", kind, "-o", "out"] for kind in ("csv", "parquet", "mat", "candump")),
        *(["export", "run.mcap", "--to", kind, "-o", "out"] for kind in ("asc", "blf", "mf4", "mf4-bus")),
        ["report", "run.mcap", "-o", "out"],
        ["recover", "run.mcap", "-o", "out"],
    ],
    ids=lambda command: " ".join(command[0:4:3]),
)
def test_a_full_disk_leaves_no_half_file(
    content: bytes,
    command: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.mcap").write_bytes(content)
    with room_for(512):
        status = status_of(command)
    assert status == 2
    assert "out: " in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


@pytest.mark.parametrize(
    "command",
    [
        ["export", "run.mcap", "--to", "csv", "-o", "run.mcap"],
        ["report", "run.mcap", "-o", "run.mcap"],
        ["report", "run.mcap", "-o", "link.html"],
        ["import", "run.mcap", "-o", "run.mcap"],
    ],
)
def test_the_recording_is_never_overwritten(
    content: bytes,
    command: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.mcap").write_bytes(content)
    (tmp_path / "link.html").hardlink_to(tmp_path / "run.mcap")
    for force in ([], ["--force"]):
        assert status_of([*command, *force]) == 2
        assert capsys.readouterr().err
        assert (tmp_path / "run.mcap").read_bytes() == content
