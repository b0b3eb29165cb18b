"""``hil replay``: verify recordings, replay one onto a bus, or compare another controller's commands."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hil.core.errors import HilError, ReplayMismatchError
from hil.host.command_parser import CommandParser, number, seconds
from hil.links.opening import BUS_FORMS

DIFFERENT, REFUSED = 1, 2
MIN_SPEED, MAX_SPEED = 0.01, 100.0
"""Range of the factor between the recorded time and the time of a replay onto a bus."""

_DESCRIPTION = """\
Without an option: give the recorded frames and deadlines of a run to the gateway core again, and compare all
that it answers with the recording: frames byte by byte, log entries, and the signals of every period.

With --bus: send the recorded frames at their original instants onto a bus. --as boards sends what the boards
sent, to test a gateway. --as gateway sends what the gateway sent, to test boards, and centres the valves at
the end. On a bus that is not virtual the command asks first, because valves move.

With --with-controller: compute what another controller would have commanded on the recorded measurements, and
draw it beside what was commanded.

Exit status: 0 if all is identical or was sent, 1 if a recording differs or a frame could not be sent, 2 if a
recording cannot be replayed."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil replay``."""
    command = CommandParser(prog="hil replay", description=_DESCRIPTION, epilog=f"buses:\n{BUS_FORMS}")
    command.add_argument("recording", type=Path, nargs="+", metavar="FILE", help="recording of `hil run`")
    command.add_argument("--verify", action="store_true", help=argparse.SUPPRESS)  # was required before 0.2
    onto_bus = command.add_argument_group("replay onto a bus")
    onto_bus.add_argument("--bus", metavar="BUS", help="send the recorded frames onto this bus")
    onto_bus.add_argument(
        "--as",
        dest="side",
        choices=("boards", "gateway"),
        help="side whose frames are sent (default: boards)",
    )
    onto_bus.add_argument("--speed", type=_speed, metavar="X", help="X times the recorded speed (default: 1)")
    onto_bus.add_argument(
        "--from", dest="from_s", type=seconds, metavar="S", help="begin, in seconds from the first period"
    )
    onto_bus.add_argument("--to", dest="to_s", type=seconds, metavar="S", help="end, likewise")
    onto_bus.add_argument("--loop", action="store_true", help="begin again at the end, until Ctrl-C")
    onto_bus.add_argument(
        "--fresh", action="store_true", help="as boards: give the samples new counters and CRCs"
    )
    onto_bus.add_argument(
        "--answer-sync",
        action="store_true",
        help="as boards: send each sample in answer to a SYNC on the bus, as a board does, with new counters",
    )
    onto_bus.add_argument("--yes", action="store_true", help="do not ask before sending to a real bus")
    other = command.add_argument_group("another controller")
    other.add_argument(
        "--with-controller",
        action="append",
        default=[],
        metavar="AXIS=FILE",
        help="controller file, or name of a shipped controller, for this axis; may be repeated",
    )
    other.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="plot to write (default: beside the recording)"
    )
    other.add_argument("--force", action="store_true", help="overwrite the plot if it exists")
    return command


def main(argv: list[str]) -> int:
    """Run ``hil replay`` with ``argv``; return its exit status. Raises HilError outside of a verification."""
    command = parser()
    options = command.parse_args(argv)
    _check(command, options)
    if options.bus is not None:
        from hil.cli.replay_onto_bus import replay_onto_bus

        return replay_onto_bus(options.recording[0], options)
    if options.with_controller:
        from hil.cli.replay_controller import replay_with_controller

        return replay_with_controller(options.recording[0], options)
    return max(_verify(path) for path in options.recording)


def _check(command: CommandParser, options: argparse.Namespace) -> None:
    """End the program with an error for options that do not go together."""
    bus_only = {
        "--as": options.side,
        "--speed": options.speed,
        "--from": options.from_s is not None,
        "--to": options.to_s is not None,
        "--loop": options.loop,
        "--fresh": options.fresh,
        "--answer-sync": options.answer_sync,
        "--yes": options.yes,
    }
    if options.bus is None:
        for option, given in bus_only.items():
            if given:
                command.error(f"{option} is for a replay onto a bus; add --bus, such as --bus vcan0")
    elif options.with_controller:
        command.error("--bus and --with-controller exclude each other; give one of them")
    if not options.with_controller:
        for option, given in (("-o", options.output), ("--force", options.force)):
            if given:
                command.error(f"{option} is for the plot of --with-controller AXIS=FILE; leave it out")
    if (options.bus is not None or options.with_controller) and len(options.recording) > 1:
        command.error(f"{len(options.recording)} recordings are given; replay them one by one")
    if options.side == "gateway":
        if options.fresh:
            command.error("--fresh is for --as boards: a changed command would not be the recorded one")
        if options.answer_sync:
            command.error("--answer-sync is for --as boards: only a board answers SYNC")
    if options.from_s is not None and options.to_s is not None and not options.from_s < options.to_s:
        command.error(f"--from {options.from_s:g} s is not before --to {options.to_s:g} s")


def _speed(text: str) -> float:
    value = number(text)
    if not MIN_SPEED <= value <= MAX_SPEED:
        raise argparse.ArgumentTypeError(f"{value:g} is not from {MIN_SPEED:g} to {MAX_SPEED:g}")
    return value


def _verify(path: Path) -> int:
    from hil.recording.reader import Recording
    from hil.shells.replay import verify

    try:
        recording = Recording(path)
        if "imported" in recording.metadata:
            log = recording.metadata["imported"].get("file", "a bus log")
            sys.stderr.write(
                f"refused    {path}: was imported from {log}, which has no calls of the gateway, so it "
                "cannot be verified; --bus replays its frames onto a bus\n"
            )
            return REFUSED
        report = verify(recording)
    except ReplayMismatchError as error:
        sys.stderr.write(f"different  {error}\n")
        return DIFFERENT
    except HilError as error:
        sys.stderr.write(f"refused    {error}\n")
        return REFUSED
    cut_off = "" if report.complete else "; the recording was cut off, and was verified up to its end"
    sys.stdout.write(
        f"identical  {path}: {report.frames_compared} frames, {report.log_entries_compared} log entries and "
        f"{report.periods_compared} periods of signals from {report.calls} calls, "
        f"{report.duration_s:.3f} s{cut_off}\n"
    )
    return 0
