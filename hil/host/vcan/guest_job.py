"""The folder through which a command and its result pass between this host and user-mode Linux."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Self


class GuestJob:
    """A temporary folder with all that the guest needs to run one command. Use it in a ``with`` statement.

    The guest's root directory is the host's, so both see the folder under the same path. Its path is below
    /tmp and contains no space: the kernel's command line and ``LD_PRELOAD`` cannot quote one.
    """

    def __init__(self, command: Sequence[str]) -> None:
        """Write the folder for ``command``, which runs in this directory with this environment."""
        self._folder = tempfile.TemporaryDirectory(prefix="hil-vcan-", dir="/tmp")
        self.path = Path(self._folder.name)
        shutil.copy(Path(__file__).with_name("init.sh"), self.init)
        (self.path / "settings").write_text(_settings())
        (self.path / "command").write_bytes(os.fsencode(_script(command)))

    @property
    def init(self) -> Path:
        """Script that the guest executes as its first process."""
        return self.path / "init"

    @property
    def console(self) -> Path:
        """File into which the guest's kernel prints."""
        return self.path / "console"

    def status(self) -> int | None:
        """Return the command's exit status; None if the guest stopped before the command ended."""
        try:
            return int((self.path / "status").read_text())
        except FileNotFoundError:
            return None

    def console_text(self) -> str:
        """Return everything that the guest's kernel printed."""
        return self.console.read_text(errors="replace")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._folder.cleanup()


def _settings() -> str:
    """Return the shell variables that ``init.sh`` reads: the host's name and the size of the terminal."""
    is_terminal = os.isatty(1)
    size = os.get_terminal_size(1) if is_terminal else os.terminal_size((80, 24))
    return (
        f"host={shlex.quote(platform.node())}\nis_terminal={'yes' if is_terminal else 'no'}\n"
        f"rows={size.lines}\ncolumns={size.columns}\n"
    )


def _script(command: Sequence[str]) -> str:
    """Return a shell script that runs ``command`` in this directory with exactly this environment."""
    environment = [f"{name}={value}" for name, value in os.environ.items()]
    return f"cd {shlex.quote(str(Path.cwd()))} && exec env -i {shlex.join([*environment, *command])}\n"
