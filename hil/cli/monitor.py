"""``hil monitor``: watch the bus of the rig. It listens, and sends nothing unless ``--sync`` is given."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from hil.cli.confirmation import announce_bit_rate
from hil.core.board_watch import ADC_NODE, NMT_START
from hil.core.errors import DocumentError
from hil.core.frames import Frame
from hil.core.rig import Rig
from hil.core.wire import codec
from hil.host.command_parser import CommandParser
from hil.links import BUS_FORMS, Link, open_link
from hil.shells.run_setup import load_rig
from hil.views.bus_watch import SILENT_NS, BusWatch

if TYPE_CHECKING:
    from rich.console import RenderableType

BIT_RATE = 500_000
REFRESH_NS = 200_000_000
"""Time between two pictures."""
ONCE_S = 2.0
"""Seconds of listening for ``--once``."""
NMT_INTERVAL_NS = 1_000_000_000
"""Shortest time between two attempts to start the ADC board."""
DESCRIPTION = """\
Watch the bus of the rig: boards and their emergency messages, samples, raw voltages, positions, speeds, valve
commands, rates, bus load and error frames. The command listens and sends nothing. Without a gateway there is
no SYNC, and the ADC board sends no samples; --sync sends SYNC then, and starts the ADC board. No valve moves.

Exit status: 0, or 1 if --once has heard no frame."""
EPILOG = f"""\
Buses:
{BUS_FORMS}

The boards of `hil run` without --bus are on a bus of their own. To try this command without hardware, start
`firmware-sim --bus udp:43113` and then `hil monitor --bus udp:43113 --sync`."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil monitor``."""
    command = CommandParser(prog="hil monitor", description=DESCRIPTION, epilog=EPILOG)
    command.add_argument("--bus", metavar="BUS", help="bus to listen to (default: the rig file's)")
    command.add_argument("--rig", type=Path, metavar="FILE", help="rig file (default: the shipped example)")
    command.add_argument(
        "--bit-rate",
        type=_bit_rate,
        metavar="BIT/S",
        help="bit rate of the bus, from which its load is computed (default: the rig file's, or 500000); a "
        "serial adapter always has the rig file's",
    )
    command.add_argument(
        "--sync",
        action="store_true",
        help="while no gateway is heard, send SYNC with the rig's period and start the ADC board",
    )
    command.add_argument(
        "--json", action="store_true", help="print one JSON object a line instead of a picture, for programs"
    )
    command.add_argument(
        "--once", action="store_true", help=f"listen for {ONCE_S:g} s, print what was heard, and end"
    )
    return command


def main(argv: list[str]) -> int:
    """Watch until interrupted, or once. Raises DocumentError or LinkError."""
    options = parser().parse_args(argv)
    rig = load_rig(options.rig)
    bus = bus_to_hear(options, rig)
    if options.bit_rate is not None and bus.startswith("slcan:"):
        raise DocumentError(
            f"--bit-rate {options.bit_rate}: {bus} is set to the rate of the rig file; change "
            "bus.bit_rate there"
        )
    bit_rate = options.bit_rate or rig.bus.bit_rate or BIT_RATE
    announce_bit_rate(bus, rig.bus.bit_rate)
    with open_link(bus, rig.bus.bit_rate) as link:
        monitor = Monitor(link, rig, bit_rate, options.sync, time.monotonic_ns)
        if options.once:
            monitor.listen_until(time.monotonic_ns() + round(ONCE_S * 1e9))
            _print(monitor, options.json)
            return 0 if monitor.watch.status(time.monotonic_ns()).bus.frames else 1
        return _watch(monitor, options)


def bus_to_hear(options: argparse.Namespace, rig: Rig) -> str:
    """Return the bus of ``--bus``, or that of the rig file. Raises DocumentError."""
    bus: str = options.bus or rig.bus.channel
    if bus == "sim":
        raise DocumentError(
            f"{options.rig or 'rig.toml'}: bus.channel: 'sim' is a bus that each run makes for itself, and "
            "nothing else can listen to it; name a bus with --bus"
        )
    return bus


class Monitor:
    """Listens to a link. With ``sends_sync``, it sends SYNC while no gateway is heard."""

    def __init__(
        self,
        link: Link,
        rig: Rig,
        bit_rate: int,
        sends_sync: bool,
        clock_ns: Callable[[], int],
        on_sample: Callable[[tuple[float, ...]], None] = lambda _volts: None,
    ) -> None:
        self.link = link
        self.watch = BusWatch(rig, bit_rate, on_sample)
        self._sends_sync = sends_sync
        self._clock_ns = clock_ns
        self._period_ns = rig.loop.period_ns
        self.began_ns = clock_ns()
        self._next_sync_ns = self.began_ns + SILENT_NS
        """Time of the next SYNC. Nothing is sent before a gateway would have been heard."""
        self._next_start_ns = self._next_sync_ns

    def listen_until(self, end_ns: int) -> None:
        """Take frames, and send SYNC where it is wanted, until ``end_ns``. Raises LinkError."""
        while (now_ns := self._clock_ns()) < end_ns:
            if self._sends_sync and now_ns >= self._next_sync_ns:
                self._sync(now_ns)
            until_ns = min(end_ns, self._next_sync_ns) if self._sends_sync else end_ns
            received = self.link.receive(max(until_ns - self._clock_ns(), 0) * 1e-9)
            if received is not None:
                self.watch.receive(received.frame, self._clock_ns())

    def _sync(self, now_ns: int) -> None:
        self._next_sync_ns += self._period_ns
        if self._next_sync_ns <= now_ns:  # after a stall, no burst
            self._next_sync_ns = now_ns + self._period_ns
        if self.watch.hears_a_gateway(now_ns):
            self._next_sync_ns = now_ns + SILENT_NS
            return
        self._send(Frame(codec.SYNC), now_ns)
        if self.watch.adc_is_pre_operational(now_ns) and now_ns >= self._next_start_ns:
            self._next_start_ns = now_ns + NMT_INTERVAL_NS
            self._send(Frame(codec.NMT, codec.encode_nmt(NMT_START, ADC_NODE)), now_ns)

    def _send(self, frame: Frame, now_ns: int) -> None:
        if self.link.send(frame):
            self.watch.sent(frame, now_ns)


def _watch(monitor: Monitor, options: argparse.Namespace) -> int:
    """Show the bus again and again until the user interrupts. Raises LinkError."""
    try:
        if options.json:
            _repeat(monitor, lambda: _print(monitor, as_json=True))
        else:
            _show_live(monitor)
    except KeyboardInterrupt:
        pass
    return 0


def _repeat(monitor: Monitor, show: Callable[[], None]) -> None:
    next_ns = time.monotonic_ns()
    while True:
        next_ns = max(next_ns + REFRESH_NS, time.monotonic_ns())
        monitor.listen_until(next_ns)
        show()


def _show_live(monitor: Monitor) -> None:
    from rich.console import Console
    from rich.live import Live

    console = Console(highlight=False)
    if not console.is_terminal:
        _repeat(monitor, lambda: _print(monitor, as_json=False))
    with Live(console=console, auto_refresh=False) as live:
        _repeat(monitor, lambda: live.update(_picture(monitor), refresh=True))


def _picture(monitor: Monitor) -> RenderableType:
    from hil.views.bus_table import bus_table

    now_ns = time.monotonic_ns()
    link = monitor.link
    elapsed_s = (now_ns - monitor.began_ns) / 1e9
    return bus_table(link.spec, monitor.watch.status(now_ns), elapsed_s, link.unreadable, link.dropped())


def _print(monitor: Monitor, as_json: bool) -> None:
    """Print what is known now, as one line of JSON or as a picture."""
    link = monitor.link
    if as_json:
        status = msgspec.to_builtins(monitor.watch.status(time.monotonic_ns()))
        status["bus"] |= {"name": link.spec, "unreadable": link.unreadable, "dropped": link.dropped()}
        sys.stdout.write(msgspec.json.encode(status).decode() + "\n")
        sys.stdout.flush()
        return
    from rich.console import Console

    Console(highlight=False).print(_picture(monitor))


def _bit_rate(text: str) -> int:
    """Return a bit rate in bit/s from the text of an argument."""
    if text.isascii() and text.isdigit() and 10_000 <= int(text[:9]) <= 1_000_000:
        return int(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not a bit rate of classic CAN, 10000 to 1000000 bit/s")
