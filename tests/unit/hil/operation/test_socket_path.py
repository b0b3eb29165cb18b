"""The daemon's socket file: its default place, its mode, and one daemon at a time."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import stat
import threading
from pathlib import Path

import pytest

from hil.core.errors import OperationError
from hil.operation import socket_path
from hil.operation.client import connect
from hil.operation.socket_path import await_release, default_path, listening


def test_the_default_is_in_the_runtime_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/7")
    assert default_path() == Path("/run/user/7/hil/daemon.sock")


def test_root_without_a_runtime_folder_uses_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 0)
    assert default_path() == Path("/run/hil/daemon.sock")


def test_a_user_without_a_runtime_folder_names_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 4_000_000)
    with pytest.raises(OperationError, match="give --socket a path"):
        default_path()


def test_the_file_is_private_and_removed_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "new" / "d.sock"
    with listening(path):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(path))
        assert sorted(file.name for file in path.parent.iterdir()) == ["d.sock", "d.sock.lock"]
    assert not path.exists()


def test_two_daemons_do_not_share_a_socket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket_path, "GREETING_TIMEOUT_S", 0.0)  # nobody serves: the socket only listens
    path = tmp_path / "d.sock"
    with listening(path), pytest.raises(OperationError, match="another daemon serves"), listening(path):
        pass


@pytest.mark.parametrize("has_file", [True, False])
def test_a_daemon_that_is_ending_is_not_called_another_one(tmp_path: Path, has_file: bool) -> None:
    path = tmp_path / "d.sock"
    with listening(path) as listener:
        listener.close()
        if not has_file:
            path.unlink()
        with (
            pytest.raises(OperationError, match=r"a daemon at .*d\.sock is still ending; try again"),
            listening(path),
        ):
            pass


def test_a_daemon_that_ends_without_a_greeting_is_ending(tmp_path: Path) -> None:
    path = tmp_path / "d.sock"
    with listening(path) as listener:

        def end() -> None:
            select.select([listener], [], [])
            listener.close()

        thread = threading.Thread(target=end, daemon=True)
        thread.start()
        with pytest.raises(OperationError, match="is still ending"), listening(path):
            pass
        thread.join()


def test_the_release_of_a_socket_is_awaited(tmp_path: Path) -> None:
    path = tmp_path / "d.sock"
    assert await_release(path, 0.0), "no daemon was ever there"
    is_ending = threading.Event()

    def hold() -> None:
        with listening(path):
            is_held.set()
            is_ending.wait()

    is_held = threading.Event()
    thread = threading.Thread(target=hold, daemon=True)
    thread.start()
    is_held.wait()
    assert not await_release(path, 0.0)
    is_ending.set()
    assert await_release(path, 20.0)
    thread.join()
    with listening(path):
        pass


def test_a_lock_file_that_cannot_be_read_is_explained(tmp_path: Path) -> None:
    (tmp_path / "d.sock.lock").symlink_to(tmp_path)
    with pytest.raises(OperationError, match=r"d\.sock\.lock: cannot be read"):
        await_release(tmp_path / "d.sock", 0.0)


def test_the_socket_of_a_daemon_that_was_killed_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "d.sock"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    with pytest.raises(OperationError, match="no daemon answers at"):
        connect(path)
    with listening(path), socket.socket(socket.AF_UNIX) as client:
        client.connect(str(path))


def test_an_error_of_the_daemon_itself_is_not_changed(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), listening(tmp_path / "d.sock"):
        raise FileNotFoundError


@pytest.mark.parametrize(
    ("path", "words"),
    [(Path("/proc/nowhere/d.sock"), "cannot be used"), (Path("/tmp/" + "x" * 120), "106 bytes")],
)
def test_a_path_that_cannot_be_used_is_explained(path: Path, words: str) -> None:
    with pytest.raises(OperationError, match=words), listening(path):
        pass


def test_a_link_in_the_place_of_the_lock_file_is_not_followed(tmp_path: Path) -> None:
    thesis = tmp_path / "thesis"
    thesis.write_text("years of work")
    (tmp_path / "s.lock").symlink_to(thesis)
    with pytest.raises(OperationError, match="cannot be used"), listening(tmp_path / "s"):
        pass
    assert thesis.read_text() == "years of work"


def test_other_users_cannot_hold_the_lock(tmp_path: Path) -> None:
    with listening(tmp_path / "s"):
        assert stat.S_IMODE((tmp_path / "s.lock").stat().st_mode) == 0o600


@pytest.mark.parametrize(
    ("mode", "is_allowed"), [(0o777, False), (0o770, False), (0o755, True), (0o1777, True)]
)
def test_a_folder_in_which_others_could_replace_the_socket_is_refused(
    tmp_path: Path, mode: int, is_allowed: bool
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    folder.chmod(mode)
    with contextlib.ExitStack() as stack:
        if not is_allowed:
            stack.enter_context(pytest.raises(OperationError, match="could replace the socket"))
        stack.enter_context(listening(folder / "s"))
    assert not (folder / "s").exists()
