"""The commands that ask a running daemon for something: ``hil arm``, ``hil setpoint`` and others.

Each is an :class:`OperatorCommand` in this module. Exit status: 0 if the daemon did it, 1 if it refused or no
daemon runs, 2 for wrong arguments.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from hil.cli.axis_values import by_axis
from hil.core.errors import ConnectionLostError, DocumentError, OperationError, RequestRefusedError
from hil.core.setpoints import FORMS
from hil.host.command_parser import CommandParser, add_override_option, duration
from hil.operation.client import Client, await_end, connect
from hil.operation.protocol import AxisStatus, Status
from hil.operation.socket_path import await_release, default_path

JOG_SPAN_S = 0.3
"""A longer jog is sent in parts of this duration. If this command ends, the axis stops within it."""
JOG_REPEAT_S = 0.1
"""Time from one part of a long jog to the next."""
MIN_JOG_S = 0.01
"""Shortest last part of a long jog."""
WATCH_INTERVAL_S = 0.05
"""Time from one status to the next while this command waits for the end of a jog."""
END_TIMEOUT_S = 1.0
"""Longest wait for another state once a jog should be over. If none comes, somebody else moves the arm."""
MAX_JOG_S = 10.0
"""Longest jog of one command."""
SHUTDOWN_TIMEOUT_S = 20.0
"""Longest wait for the end of a daemon that has closed its recording."""


class OperatorCommand(NamedTuple):
    """One command for a running daemon."""

    name: str
    description: str
    add_arguments: Callable[[CommandParser], None]
    ask: Callable[[Client, argparse.Namespace], str]
    """Sends the requests, and returns what happened, for the user."""
    epilog: str = ""
    after_loss: Callable[[Path | None], str] = lambda _path: ""
    """Returns what is known if the daemon at a socket closed the connection; nothing if the error says it."""

    def parser(self) -> CommandParser:
        """Return the parser of the command's arguments."""
        parser = CommandParser(prog=f"hil {self.name}", description=self.description, epilog=self.epilog)
        self.add_arguments(parser)
        add_socket_option(parser)
        return parser

    def main(self, argv: list[str]) -> int:
        """Run the command with ``argv``; return its exit status."""
        options = self.parser().parse_args(argv)
        try:
            with connect(options.socket) as client:
                said = self.ask(client, options)
        except OperationError as error:
            known = self.after_loss(options.socket) if isinstance(error, ConnectionLostError) else ""
            sys.stderr.write(f"hil {self.name}: {known or error}\n")
            return 1
        sys.stdout.write(f"{said}\n")
        return 0


def add_socket_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--socket``."""
    parser.add_argument(
        "--socket",
        type=Path,
        metavar="PATH",
        help="the daemon's socket (default: $XDG_RUNTIME_DIR/hil/daemon.sock, or /run/hil/daemon.sock)",
    )


def _no_arguments(_parser: CommandParser) -> None:
    """Add no arguments."""


def _simple(name: str, description: str, ask: Callable[[Client], str]) -> OperatorCommand:
    return OperatorCommand(name, description, _no_arguments, lambda client, _: ask(client))


class _NoSuchOption(argparse.Action):
    """An option of `hil run` that a command for a daemon takes without its name."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        option_string: str | None = None,
    ) -> None:
        """End with a message that says how to write it."""
        parser.error(f"{option_string} is an option of `hil run`; write {parser.prog} {values or self.const}")


def _refuse_option(parser: CommandParser, option: str, example: str) -> None:
    parser.add_argument(
        option, nargs="?", const=example, action=_NoSuchOption, help=argparse.SUPPRESS, metavar=""
    )


def _pair(option: str, text: str, example: str) -> tuple[str, str]:
    ((axis, value),) = by_axis(option, [text], example).items()
    return axis, value


def _add_setpoint_arguments(parser: CommandParser) -> None:
    _refuse_option(parser, "--setpoint", "vertical=0.05")
    parser.add_argument(
        "setpoints", nargs="+", metavar="AXIS=SETPOINT", help="a position, or a setpoint as in a rig file"
    )


def _set_setpoints(client: Client, options: argparse.Namespace) -> str:
    given = by_axis("", options.setpoints, "vertical=0.05")
    return client.set_setpoints({axis: _number_or_text(text) for axis, text in given.items()})


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _add_controller_arguments(parser: CommandParser) -> None:
    _refuse_option(parser, "--controller", "vertical=hls")
    parser.add_argument(
        "controllers", nargs="+", metavar="AXIS=FILE", help="a controller file, or the name of a shipped one"
    )


def _set_controllers(client: Client, options: argparse.Namespace) -> str:
    files = by_axis("", options.controllers, "vertical=hls")
    if len(files) > 1:  # None is changed if one is refused.
        for axis, file in files.items():
            client.check_controller(axis, file)
    return "\n".join(f"{axis}: {client.set_controller(axis, file)}" for axis, file in files.items())


def _add_jog_arguments(parser: CommandParser) -> None:
    parser.add_argument("move", metavar="AXIS=VOLTS", help="valve voltage relative to its centre")
    parser.add_argument(
        "--for",
        dest="duration_s",
        type=jog_duration,
        default=0.2,
        metavar="TIME",
        help=f"duration, such as 0.2s or 200ms, at most {MAX_JOG_S:g}s (default 0.2s)",
    )


def _jog(client: Client, options: argparse.Namespace) -> str:
    """Jog in short parts, so that the axis stops when this command ends."""
    axis, text = _pair("", options.move, "vertical=+0.5")
    try:
        offset_v = float(text)
    except ValueError:
        raise DocumentError(f"{options.move}: {text!r} is not a number of volts") from None
    before = _axis_status(client, axis)
    sent_s = time.monotonic()
    end_s = sent_s + options.duration_s
    left_s = options.duration_s
    while left_s > JOG_SPAN_S:
        client.jog(axis, offset_v, JOG_SPAN_S)
        time.sleep(JOG_REPEAT_S)  # the pace at which a held jog is asked for again
        before_s, sent_s = sent_s, time.monotonic()
        _refuse_to_jog_on(sent_s - before_s)
        left_s = end_s - sent_s
    last_s = max(left_s, MIN_JOG_S)
    client.jog(axis, offset_v, last_s)
    return _describe_jog(axis, before, _status_after_jog(client, last_s))


def _status_after_jog(client: Client, left_s: float) -> Status | None:
    """Wait until the state is no longer running, and return the status then; None if there is no status.

    Waits at most ``left_s``, the rest of the jog, and ``END_TIMEOUT_S``. Raises OperationError if the daemon
    ends meanwhile. The daemon publishes the state running before it accepts a jog, so that a status from
    before the jog is not taken for its end.
    """
    end_s = time.monotonic() + left_s + END_TIMEOUT_S
    if _status(client) is None:
        return None
    for now in client.watch(WATCH_INTERVAL_S):
        if now.state != "running" or time.monotonic() >= end_s:
            return now
    return _status(client)


def _refuse_to_jog_on(pause_s: float) -> None:
    """Raise OperationError if the axis has stopped, because this command did not run for ``pause_s``.

    A further part of the jog would move the axis again, perhaps long after anybody looked at it.
    """
    if pause_s > JOG_SPAN_S:
        raise OperationError(
            f"this command was paused for {pause_s:.1f} s and the axis has stopped; jog again to go on"
        )


def _describe_jog(name: str, before: AxisStatus | None, now: Status | None) -> str:
    """Return how far an axis moved, and whether the valves are centred now."""
    if now is None:
        return "the jog is over; the daemon has no status"
    after = _axis_of(now, name)
    if before is None or after is None or before.position is None or after.position is None:
        moved = "the jog is over"
    else:
        moved = f"{name} moved from {before.position:+.4f} to {after.position:+.4f} {after.unit}"
    # Somebody else may have started the controllers, or jog on.
    is_running = now.state == "running"
    return f"{moved}; {'the daemon is still running' if is_running else 'its valve is centred'}"


def _status(client: Client) -> Status | None:
    """Return the daemon's status; None before its first period."""
    try:
        return client.status()
    except RequestRefusedError:
        return None


def _axis_status(client: Client, name: str) -> AxisStatus | None:
    status = _status(client)
    return None if status is None else _axis_of(status, name)


def _axis_of(status: Status, name: str) -> AxisStatus | None:
    return next((axis for axis in status.axes if axis.name == name), None)


def jog_duration(text: str) -> float:
    """Return the seconds of a jog, at most ``MAX_JOG_S``."""
    value = duration(text)
    if value > MAX_JOG_S:
        raise argparse.ArgumentTypeError(
            f"{text!r} is longer than {MAX_JOG_S:g} s; repeat the command instead"
        )
    return value


def _add_event_arguments(parser: CommandParser) -> None:
    _refuse_option(parser, "--event", "payload:3")
    parser.add_argument("event", metavar="EVENT", help="such as payload:3 or stuck-spool:vertical")


def _add_record_arguments(parser: CommandParser) -> None:
    parser.add_argument(
        "what",
        choices=("new", "stop"),
        metavar="new|stop",
        help="new: close the recording and begin another; stop: close it",
    )


def _record(client: Client, options: argparse.Namespace) -> str:
    return client.record_new() if options.what == "new" else client.record_stop()


def _shutdown(client: Client, _options: argparse.Namespace) -> str:
    said = client.shutdown()
    _await_release(client.path)
    return said


def _await_release(path: Path) -> None:
    """Wait until another daemon can have the socket. Raises OperationError if that takes too long."""
    if not await_release(path, SHUTDOWN_TIMEOUT_S):
        raise OperationError(
            f"the daemon has taken the request, but {path} is still in use after {SHUTDOWN_TIMEOUT_S:g} s, "
            "the limit: its simulated boards or its page do not end, or another daemon has begun; see its "
            "log and `hil status`"
        )


def _ended_already(path: Path | None) -> str:
    if not await_end(path):
        return ""
    _await_release(path or default_path())
    return (
        "the daemon has ended without an answer: another request or a signal ended it, or it was killed. Its "
        "log says whether it centred the valves; `hil replay` says whether its recording is complete"
    )


ARM = OperatorCommand(
    "arm",
    "Allow motion: the daemon goes from ready to armed. The valves stay centred until `hil start`. The "
    "daemon refuses if a check fails: a right that the rig requires of this machine, a position outside the "
    "envelope, or a controller whose loop is unstable. The refusal names each failed check.",
    add_override_option,
    lambda client, options: client.arm(options.override),
    "An override holds until the next disarm or fault. It is logged as a warning, shown by `hil status`, and "
    "recorded with who gave it.",
)
DISARM = _simple("disarm", "Forbid motion: the daemon goes from armed to ready.", Client.disarm)
START = _simple(
    "start",
    "Begin to control: the daemon goes from armed to running, and the controllers move the valves.",
    Client.start,
)
STOP = _simple(
    "stop",
    "Stop the controllers and centre the valves: the daemon goes from running to armed. `hil shutdown` ends "
    "the daemon itself.",
    Client.stop,
)
RESET = _simple(
    "reset",
    "Leave state fault, after its cause is removed. The boards are then brought up again.",
    lambda client: (
        f"{client.reset()}; the boards are brought up again, and `hil status` says what is missing until the "
        "state is ready"
    ),
)
SHUTDOWN = OperatorCommand(
    "shutdown",
    "End the daemon: it centres the valves and closes the recording. The command waits until it has ended.",
    _no_arguments,
    _shutdown,
    after_loss=_ended_already,
)
SETPOINT = OperatorCommand(
    "setpoint",
    "Change the setpoints of axes, or of none of them if one is refused. In state running, an axis "
    "approaches its new setpoint within the limits of the rig file.",
    _add_setpoint_arguments,
    _set_setpoints,
    "A number is a position in the axis' unit, m or rad. Other setpoints, whose time 0 is now:\n\n"
    + "".join(f"  {form}\n" for form in FORMS.values())
    + "\nThe file of csv:FILE has columns time_s,setpoint and at most 64 kB.",
)
CONTROLLER = OperatorCommand(
    "controller",
    "Change the controllers of axes, or of none of them if one is refused. In state running, the new "
    "controller takes over without a jump of the valve.",
    _add_controller_arguments,
    _set_controllers,
)
JOG = OperatorCommand(
    "jog",
    "Move one axis with a constant valve voltage for a short time, then centre its valve. If this command "
    f"ends early, the axis stops within {JOG_SPAN_S:g} s.",
    _add_jog_arguments,
    _jog,
)
EVENT = OperatorCommand(
    "event",
    "Let something happen to the simulated arm, or let a fault of the simulated rig begin. The forms are "
    "those of `hil run --event` and `--fault`. Without a time it happens now. A time counts "
    "from now: payload:3@2, hang:adc@vertical>0.05. A fault may have a duration: unplug/0.5.",
    _add_event_arguments,
    lambda client, options: client.event(options.event),
)
RECORD = OperatorCommand(
    "record", "Begin another recording, or go on without one.", _add_record_arguments, _record
)
