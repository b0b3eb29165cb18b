"""The socket of a daemon that ends while a client waits to be accepted."""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def ending(path: Path) -> Iterator[Path]:
    """Listen at ``path`` until a client has connected, then remove the socket without accepting it."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.listen()

    def end() -> None:
        select.select([listener], [], [])
        path.unlink()
        listener.close()

    thread = threading.Thread(target=end, daemon=True)
    thread.start()
    yield path
    thread.join()
