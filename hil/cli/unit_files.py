"""``hil daemon --install-unit``: install the systemd files that the package contains.

For root, the unit is a system service with real-time rights, and the network file of can0 is installed too.
For a user, the unit is a service of that user. No file is overwritten without ``--force``.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from hil.core.errors import DocumentError
from hil.shells.run_setup import SHIPPED

UNIT = "hil-daemon.service"
NETWORK = "can0.network"
REAL_TIME_RIGHTS = "LimitRTPRIO=49\nLimitMEMLOCK=infinity\n"
"""Rights that the loop asks for. A service of a user gets them only from the system's administrator."""


class Installed(NamedTuple):
    """A file to install."""

    path: Path
    text: str


def install(is_forced: bool) -> int:
    """Install the files for this user, and print the next commands. Returns the exit status.

    Raises DocumentError if a file exists and ``is_forced`` is False, or if one cannot be written.
    """
    is_system = os.getuid() == 0
    files = files_to_install(Path("/"), is_system, os.environ, [sys.executable, "-P", "-m", "hil.cli"])
    for path, _ in files:
        if os.path.lexists(path) and not is_forced:
            raise DocumentError(f"{path}: exists already; --force overwrites it")
    for path, text in files:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        except OSError as error:
            raise DocumentError(f"{path}: cannot be written: {error.strerror}") from None
        sys.stdout.write(f"installed {path}\n")
    sys.stdout.write("\n".join(["", "next:", *next_commands(is_system)]) + "\n")
    return 0


def files_to_install(
    root: Path, is_system: bool, environment: Mapping[str, str], command: list[str]
) -> list[Installed]:
    """Return the files for the system or for one user. ``command`` is what runs ``hil``."""
    template = (SHIPPED / "systemd" / UNIT).read_text(encoding="utf-8")
    if is_system:
        folder, target, rights = (
            "/var/lib/hil",
            "multi-user.target",
            "StateDirectory=hil\n" + REAL_TIME_RIGHTS,
        )
        unit = root / "etc/systemd/system" / UNIT
    else:
        folder, target, rights = "%h", "default.target", ""
        home = Path(environment.get("XDG_CONFIG_HOME") or Path(environment["HOME"]) / ".config")
        unit = home / "systemd/user" / UNIT
    values = {"COMMAND": shlex.join(command), "FOLDER": folder, "TARGET": target, "RIGHTS": rights}
    for name, value in values.items():
        template = template.replace(f"@{name}@", value)
    files = [Installed(unit, template)]
    if is_system:
        network = (SHIPPED / "systemd" / NETWORK).read_text(encoding="utf-8")
        files.append(Installed(root / "etc/systemd/network" / f"80-{NETWORK}", network))
    return files


def next_commands(is_system: bool) -> list[str]:
    """Return what to do after the installation, line by line."""
    systemctl = "systemctl" if is_system else "systemctl --user"
    lines = [
        f'  {systemctl} edit {UNIT}   # [Service] Environment="HIL_DAEMON_OPTIONS=--rig FILE --bus can0"',
        f"  {systemctl} enable --now {UNIT}",
        f"  journalctl {'' if is_system else '--user '}-u {UNIT} -f",
        "  hil status",
    ]
    if is_system:
        lines.insert(0, "  systemctl restart systemd-networkd   # brings can0 up with 500 kbit/s")
    return lines
