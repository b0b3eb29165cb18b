"""``hil vcan``: run a command where the CAN interface ``vcan0`` exists."""

from __future__ import annotations

import argparse

from hil.host.command_parser import CommandParser
from hil.host.vcan import run_with_vcan


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil vcan``."""
    parser = CommandParser(
        prog="hil vcan",
        usage="hil vcan -- COMMAND [ARGUMENT…]",
        description="Run a command where the CAN interface vcan0 exists, and return its exit status. If this "
        "host has no vcan0, the command gets a network namespace that has one. If this kernel has no vcan, "
        "the command runs in user-mode Linux; there it is root and has no standard input. In a namespace and "
        "in user-mode Linux, the loopback interface is the only other network.",
    )
    parser.add_argument("command", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    return parser


def main(argv: list[str]) -> int:
    """Run the command that follows ``--`` and return its exit status. Raises EnvironmentLackError."""
    command = parser().parse_args(argv).command
    if command[:1] == ["--"]:
        del command[0]
    if not command:
        parser().error("no command is given; for example: hil vcan -- candump vcan0")
    return run_with_vcan(command)
