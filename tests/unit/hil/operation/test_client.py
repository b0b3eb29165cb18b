"""The Python client against ends that are no daemon, or another version of it."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.ending_daemon import ending

from hil.core.errors import OperationError
from hil.operation.client import await_end, connect

GREETING = b'{"protocol": "hil-operation", "version": 1, "hil": "9"}\n'


@contextmanager
def answering(path: Path, *parts: bytes) -> Iterator[Path]:
    """Serve one client: send each part, the first at once and the others after a request."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.listen()

    def serve() -> None:
        connection, _ = listener.accept()
        with connection:
            for number, part in enumerate(parts):
                if number > 0:
                    connection.recv(65536)
                connection.sendall(part)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield path
    thread.join()
    listener.close()


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ([b""], "closed the connection"),
        ([b"HTTP/1.1 400 Bad Request\n"], "not an answer of a hil daemon"),
        (
            [b'{"protocol": "hil-operation", "version": 2, "hil": "9"}\n'],
            "version 2 .hil 9.*use the",
        ),
        ([b'{"id": 0, "accepted": false, "text": "go away"}\n'], "does not serve this client: go away"),
        ([GREETING, b""], "without an answer"),
        ([GREETING, b"{}\n"], "not an answer of a hil daemon"),
        ([GREETING, b'{"id": 1, "accepted": true, "text": "ready"}\n'], "has no status"),
    ],
)
def test_another_end_is_explained(tmp_path: Path, parts: list[bytes], words: str) -> None:
    with (
        answering(tmp_path / "s", *parts) as path,
        pytest.raises(OperationError, match=words),
        connect(path) as client,
    ):
        client.status()


def test_no_daemon_says_what_to_start(tmp_path: Path) -> None:
    with pytest.raises(OperationError, match=r"no daemon runs at .*: start one with `hil daemon`"):
        connect(tmp_path / "none")


def test_the_end_of_a_daemon_is_awaited(tmp_path: Path) -> None:
    assert await_end(tmp_path / "none")
    with ending(tmp_path / "ends") as path:
        assert await_end(path)
    with answering(tmp_path / "runs", GREETING) as path:
        assert not await_end(path)


def test_a_file_that_is_no_socket_is_explained(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OperationError, match="daemon"):
        connect(tmp_path / "file")


def test_a_full_queue_of_connections_is_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as listener, contextlib.ExitStack() as stack:
        listener.bind(str(path))
        listener.listen(0)
        waiting = stack.enter_context(socket.socket(socket.AF_UNIX))
        waiting.connect(str(path))

        def serve() -> None:
            for _ in range(2):
                connection, _ = listener.accept()
                stack.enter_context(connection)
                connection.sendall(GREETING)

        probe = stack.enter_context(socket.socket(socket.AF_UNIX))
        probe.setblocking(False)
        with pytest.raises(BlockingIOError):
            probe.connect(str(path))
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        connect(path).close()
        thread.join()
