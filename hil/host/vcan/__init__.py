"""``hil vcan``: run a command where the interface ``vcan0`` exists, whatever this kernel can do.

Lives here: the three ways to such a place, tried in this order: vcan0 of this host; a network namespace of
the command's own, where the kernel has vcan; user-mode Linux (the module beside).
"""

from __future__ import annotations

import argparse
import contextlib
import os
import socket
import subprocess
import sys
from enum import StrEnum
from typing import Final

from hil.host.vcan.user_mode_linux import require_user_mode_linux, run_in_user_mode_linux

INTERFACE: Final = "vcan0"
_MAKE_INTERFACE: Final = f"ip link add dev {INTERFACE} type vcan && ip link set {INTERFACE} up"


class Way(StrEnum):
    """How ``vcan0`` comes to be; the value says it to people."""

    NATIVE = "vcan0 of this host"
    NAMESPACE = "a network namespace of the command's own"
    USER_MODE_LINUX = "user-mode Linux"


def main(argv: list[str]) -> int:
    """Run the command that follows ``--`` and return its exit status. Raises EnvironmentLackError."""
    parser = argparse.ArgumentParser(
        prog="hil vcan",
        usage="hil vcan -- COMMAND [ARGUMENT…]",
        description="Run a command where the CAN interface vcan0 exists, and exit as it does. Where there is "
        "none yet, it gets a network namespace with one; where this kernel has no vcan, user-mode Linux, in "
        "which it is root and has no standard input. In both it has the loopback network alone.",
    )
    parser.add_argument("command", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    command = parser.parse_args(argv).command
    if command[:1] == ["--"]:
        del command[0]
    if not command:
        parser.error("which command? For example: hil vcan -- candump vcan0")
    way = choose_way()
    if way is Way.USER_MODE_LINUX:
        return run_in_user_mode_linux(command)
    if way is Way.NAMESPACE:
        inside = f'ip link set lo up && {_MAKE_INTERFACE} && exec "$@"'
        command = [*_namespace(), "sh", "-c", inside, "sh", *command]
    return _replace_this_process(command)


def choose_way() -> Way:
    """The first way that works here; nothing is changed. Raises EnvironmentLackError."""
    if _is_up():
        return Way.NATIVE
    if _namespace():
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


def _namespace() -> list[str]:
    """The command that opens a network namespace in which vcan0 can be made; empty where none does.

    Root keeps its rights in ``unshare -n``; with ``-r`` it would be refused real-time priority.
    """
    for command in (["unshare", "-n"], ["unshare", "-rn"]):
        with contextlib.suppress(OSError):
            done = subprocess.run(
                [*command, "sh", "-c", _MAKE_INTERFACE], stdin=subprocess.DEVNULL, capture_output=True
            )
            if done.returncode == 0:
                return command
    return []


def _replace_this_process(command: list[str]) -> int:
    sys.stdout.flush()
    try:
        os.execvp(command[0], command)
    except OSError as error:
        sys.stderr.write(f"hil vcan: {command[0]}: {error.strerror}\n")
        return 127 if isinstance(error, FileNotFoundError) else 126
