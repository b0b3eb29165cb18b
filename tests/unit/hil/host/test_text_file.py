"""Text files that a user names: only regular files of limited size are read."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from hil.core.errors import DocumentError
from hil.host.text_file import MAX_DOCUMENT_BYTES, MAX_TABLE_BYTES, read_text


def refusal(path: Path, max_bytes: int = MAX_DOCUMENT_BYTES) -> str:
    with pytest.raises(DocumentError) as caught:
        read_text(path, max_bytes)
    return str(caught.value)


def test_line_ends_and_a_byte_order_mark_are_normalised(tmp_path: Path) -> None:
    path = tmp_path / "t"
    path.write_bytes("\ufeffa\r\nb\rc\nµ".encode())
    assert read_text(path) == "a\nb\nc\nµ"


def test_a_named_pipe_is_refused_without_waiting_for_a_writer(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    assert refusal(path) == f"{path}: is a named pipe (FIFO), not a regular file"


def test_a_pipe_from_a_shell_is_refused() -> None:
    reader, writer = os.pipe()
    os.write(writer, b"[loop]")
    try:
        assert refusal(Path(f"/dev/fd/{reader}")).endswith(": is a named pipe (FIFO), not a regular file")
    finally:
        os.close(reader)
        os.close(writer)


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null"])
def test_a_device_is_refused(device: str) -> None:
    assert refusal(Path(device)) == f"{device}: is a device, not a regular file"


def test_a_socket_and_a_directory_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind("socket")
        assert refusal(Path("socket")) == "socket: is a socket, not a regular file"
    assert refusal(tmp_path) == f"{tmp_path}: is a directory, not a regular file"


@pytest.mark.parametrize("max_bytes", [MAX_DOCUMENT_BYTES, MAX_TABLE_BYTES, 65536, 10])
def test_the_limit_itself_is_allowed_and_one_byte_more_is_refused(tmp_path: Path, max_bytes: int) -> None:
    factor, unit = (1e6, "MB") if max_bytes >= 1_000_000 else (1e3, "kB")
    path = tmp_path / "t"
    path.touch()
    os.truncate(path, max_bytes)
    assert len(read_text(path, max_bytes)) == max_bytes
    os.truncate(path, max_bytes + 1)
    assert refusal(path, max_bytes) == (
        f"{path}: has {(max_bytes + 1) / factor:g} {unit}, more than the limit {max_bytes / factor:g} {unit} "
        "for such a file"
    )


def test_a_file_that_states_no_size_is_read_up_to_the_limit() -> None:
    """Files of /proc have the size 0 and content all the same."""
    path = Path("/proc/self/maps")
    assert path.stat().st_size == 0
    assert "stack" in read_text(path)
    assert "more than the limit 0.1 kB" in refusal(path, 100)


def test_a_recording_is_recognised(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    for size in (9, MAX_DOCUMENT_BYTES + 1):
        path.write_bytes(b"\x89MCAP0\r\n\xff".ljust(size, b"\x00"))
        assert refusal(path) == f"{path}: is a recording (MCAP), not a text; `hil replay` takes it"


def test_what_is_not_utf_8_is_refused_with_the_place(tmp_path: Path) -> None:
    path = tmp_path / "t"
    path.write_bytes("ab µ".encode("latin-1"))
    assert refusal(path) == f"{path}: is not text in UTF-8: byte 3 cannot be decoded"


def test_names_that_no_file_has(tmp_path: Path) -> None:
    assert refusal(tmp_path / "absent") == f"{tmp_path / 'absent'}: cannot be read: No such file or directory"
    assert refusal(Path("a\0b")) == "'a\\x00b': cannot be read: embedded null byte"
