"""The three ways to a virtual CAN interface, and the choice between them.

In the order in which they are tried: an interface of this host; a new network namespace, where the kernel has
the module ``vcan``; user-mode Linux.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
from collections.abc import Sequence
from enum import StrEnum
from typing import Final

from hil.host.vcan.user_mode_linux import require_user_mode_linux, run_in_user_mode_linux

INTERFACE: Final = "vcan0"
_MAKE_INTERFACE: Final = f"ip link add dev {INTERFACE} type vcan && ip link set {INTERFACE} up"


class Way(StrEnum):
    """A way to provide ``vcan0``. The value is its description for people."""

    NATIVE = "vcan0 of this host"
    NAMESPACE = "a network namespace of the command's own"
    USER_MODE_LINUX = "user-mode Linux"


def run_with_vcan(command: Sequence[str]) -> int:
    """Run ``command`` where ``vcan0`` exists and return its exit status.

    With ``NATIVE`` and ``NAMESPACE`` the command replaces this process, and the function does not return.
    Raises EnvironmentLackError if no way works on this machine.
    """
    way = choose_way()
    if way is Way.USER_MODE_LINUX:
        return run_in_user_mode_linux(command)
    if way is Way.NAMESPACE:
        inside = f'ip link set lo up && {_MAKE_INTERFACE} && exec "$@"'
        command = [*_namespace_command(), "sh", "-c", inside, "sh", *command]
    return _replace_this_process(command)


def choose_way() -> Way:
    """Return the first way that this machine offers. Changes nothing.

    The first two ways are tried. For user-mode Linux the function only checks that everything is installed;
    ``try_user_mode_linux`` starts it. Raises EnvironmentLackError if no way is left.
    """
    if _is_up():
        return Way.NATIVE
    if _namespace_command():
        return Way.NAMESPACE
    require_user_mode_linux()
    return Way.USER_MODE_LINUX


def _is_up() -> bool:
    try:
        with socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as probe:
            probe.bind((INTERFACE,))
            return probe.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) == 0
    except OSError:
        return False


def _namespace_command() -> list[str]:
    """Return the command that opens a network namespace in which ``vcan0`` can be made, or an empty list.

    For root, ``unshare -n`` comes first: with ``-r`` it would lose the right to real-time priority.
    """
    for command in (["unshare", "-n"], ["unshare", "-rn"]):
        with contextlib.suppress(OSError):
            done = subprocess.run(
                [*command, "sh", "-c", _MAKE_INTERFACE], stdin=subprocess.DEVNULL, capture_output=True
            )
            if done.returncode == 0:
                return command
    return []


def _replace_this_process(command: Sequence[str]) -> int:
    """Execute ``command`` in place of this program; return a shell's status if it cannot be executed."""
    sys.stdout.flush()
    try:
        os.execvp(command[0], list(command))
    except OSError as error:
        sys.stderr.write(f"hil vcan: {command[0]}: {error.strerror}\n")
        return 127 if isinstance(error, FileNotFoundError) else 126
