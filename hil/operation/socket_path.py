"""The daemon's socket file: where it is, and how one daemon takes it.

A lock file beside the socket is held as long as the daemon runs. So the socket file of a daemon that was
killed can be removed without a doubt, and two daemons never share one socket.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

from hil.core.errors import OperationError

FOLDER = "hil"
NAME = "daemon.sock"
MAX_PATH_BYTES = 106
"""Longest path: a Unix-domain socket of Linux may have 107 (unix(7)), and one is for the hidden name."""
BACKLOG = 16
"""Number of connections that may wait until they are accepted."""
GREETING_TIMEOUT_S = 1.0
"""Longest wait for a word of the daemon that has the socket, before a second one is refused."""

_LOCK_FLAGS = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
"""A link in the place of the lock file is not followed, and no content of a file is changed."""


def default_path() -> Path:
    """Return the socket file in this user's runtime folder. Raises OperationError if there is none."""
    folder = os.environ.get("XDG_RUNTIME_DIR")
    if folder:
        return Path(folder) / FOLDER / NAME
    if os.getuid() == 0:
        return Path("/run") / FOLDER / NAME
    path = Path(f"/run/user/{os.getuid()}")
    if path.is_dir():
        return path / FOLDER / NAME
    raise OperationError(
        "this user has no runtime folder (XDG_RUNTIME_DIR is not set): give --socket a path in a folder that "
        "only you can write, to the daemon and to the commands"
    )


@contextlib.contextmanager
def listening(path: Path) -> Iterator[socket.socket]:
    """Listen at ``path`` with mode 0600, and remove the file at the end.

    Raises OperationError if another daemon has the path or if it cannot be used.
    """
    if len(os.fsencode(path)) > MAX_PATH_BYTES:
        raise OperationError(
            f"--socket {path}: a socket's path has at most {MAX_PATH_BYTES} bytes; choose a shorter one"
        )
    with contextlib.ExitStack() as stack:
        try:
            listener = _listen(path, stack)
        except OSError as error:
            raise OperationError(
                f"--socket {path}: cannot be used: {error.strerror}; choose another path"
            ) from None
        yield listener


def _listen(path: Path, stack: contextlib.ExitStack) -> socket.socket:
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    _refuse_open_folder(path)
    lock = os.open(_lock_path(path), _LOCK_FLAGS, 0o600)
    stack.callback(os.close, lock)
    _lock(lock, path)
    hidden = path.with_name(f"{path.name}~")
    hidden.unlink(missing_ok=True)
    listener = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
    mask = os.umask(0o177)  # the file never exists with wider rights
    try:
        listener.bind(os.fspath(hidden))
    finally:
        os.umask(mask)
    listener.listen(BACKLOG)
    stack.callback(path.unlink, missing_ok=True)
    hidden.replace(path)  # who waits for the file can connect as soon as it is there
    return listener


def _refuse_open_folder(path: Path) -> None:
    """Raise OperationError if other users could put a socket of their own in the place of this one."""
    mode = path.parent.stat().st_mode
    if mode & (stat.S_IWGRP | stat.S_IWOTH) and not mode & stat.S_ISVTX:
        raise OperationError(
            f"--socket {path}: other users can write to the folder {path.parent} (mode "
            f"{stat.S_IMODE(mode):04o}) and could replace the socket; choose another folder, or `chmod go-w` "
            "this one"
        )


def await_release(path: Path, timeout_s: float) -> bool:
    """Wait until no daemon has the socket ``path``. Return False if one still has it after ``timeout_s``.

    A daemon releases it last of all: its boards, its page and its bus are free before. Raises OperationError
    if the lock file cannot be read.
    """
    try:
        lock = os.open(_lock_path(path), os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return True  # systemd removes the folder of a service that has ended
    except OSError as error:
        raise OperationError(f"{_lock_path(path)}: cannot be read: {error.strerror}") from None

    def wait() -> None:
        try:
            fcntl.flock(lock, fcntl.LOCK_SH)
        finally:
            os.close(lock)

    waiting = threading.Thread(target=wait, daemon=True)  # flock takes no time limit
    waiting.start()
    waiting.join(timeout_s)
    return not waiting.is_alive()


def _lock_path(path: Path) -> Path:
    return path.with_name(f"{path.name}.lock")


def _lock(descriptor: int, path: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        if _is_served(path):
            raise OperationError(
                f"another daemon serves {path}: see `hil status`; end it with `hil shutdown`, or give "
                "--socket another path"
            ) from None
        raise OperationError(
            f"a daemon at {path} is still ending; try again. If it does not end, only its socket process has "
            "ended, which its log says: end the daemon with SIGTERM"
        ) from None


def _is_served(path: Path) -> bool:
    """Return whether somebody answers at ``path``, or may answer later."""
    with socket.socket(socket.AF_UNIX) as probe:
        probe.settimeout(GREETING_TIMEOUT_S)
        try:
            probe.connect(os.fspath(path))
            return probe.recv(1) != b""
        except (FileNotFoundError, ConnectionError):
            return False
        except OSError:  # too slow, or too many clients
            return True
