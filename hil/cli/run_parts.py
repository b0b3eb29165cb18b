"""Parts of every run in real time: the boards' process, signals, and the header of the recording."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from firmware_sim.plant_options import plant_arguments
from hil import __version__
from hil.core.errors import LinkError
from hil.host.child_process import await_end
from hil.recording.recorder import ARM_EVENTS, RunHeader
from hil.shells.run_plan import StopRequest
from hil.shells.run_setup import RunSetup

if TYPE_CHECKING:
    from hil.links import Link

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SIMULATED = "sim"
"""Name of the bus to simulated boards that are started with the run."""
BOARDS_END_TIMEOUT_S = 2.0
"""Time in which the process of the simulated boards must end."""
MEDIA_TYPES = {".toml": "application/toml", ".json": "application/json", ".csv": "text/csv"}


def run_header(
    setup: RunSetup,
    epoch_offset_ns: int,
    bus: str,
    stamp_origin: str,
    versions: dict[str, str],
    planned: dict[str, float],
) -> RunHeader:
    """Return the header of a recording, with every document of ``setup``."""
    return RunHeader(
        epoch_offset_ns=epoch_offset_ns,
        bus=bus,
        stamp_origin=stamp_origin,
        began_ns=epoch_offset_ns if stamp_origin == "simulated" else time.time_ns(),
        axes=tuple((name, axis.unit) for name, axis in setup.rig.axes.items()),
        attachments={
            name: (MEDIA_TYPES.get(Path(name).suffix, "text/plain"), text.encode())
            for name, text in setup.texts.items()
        },
        metadata={
            "documents": setup.digests(),
            "run": {"configuration sha256": setup.fingerprint(), "hil": __version__, **versions},
            "setpoints": {name: setpoint.text for name, setpoint in setup.setpoints.items()},
            **({ARM_EVENTS: {text: repr(at_s) for text, at_s in planned.items()}} if planned else {}),
            **({"plant": json.loads(setup.texts["plant.json"])} if "plant.json" in setup.texts else {}),
        },
    )


def host_versions() -> dict[str, str]:
    """Return the versions that a recording in real time states."""
    return {
        "python": platform.python_version(),
        "python-can": version("python-can"),
        "kernel": platform.release(),
        "host": platform.node(),
    }


@contextlib.contextmanager
def connected_boards(spec: str, options: argparse.Namespace) -> Iterator[socket.socket]:
    """Run the simulated boards in another process. Return a socket to them, which does not block.

    They read events, faults and the gateway's state from it, and write the faults that begin into it.
    """
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    with ours, contextlib.ExitStack() as stack:
        with theirs:
            stack.enter_context(boards_process(spec, options, theirs))
        yield ours


@contextlib.contextmanager
def boards_process(
    spec: str, options: argparse.Namespace, events: socket.socket | None = None
) -> Iterator[None]:
    """Run the simulated boards in another process, which the kernel kills if this one is killed.

    ``events`` is their end of the socket of :func:`connected_boards`.
    """
    # -P: modules in the working directory are not imported.
    command = [sys.executable, "-P", "-m", "firmware_sim", "--bus", spec, "--parent-pid", str(os.getpid())]
    if options.rig is not None:
        command += ["--rig", str(options.rig)]
    if events is not None:
        command += ["--event-descriptor", str(events.fileno())]
    process = subprocess.Popen(
        [*command, *plant_arguments(options)],
        pass_fds=() if events is None else (events.fileno(),),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C must not end the boards before the gateway has centred the valves
    )
    try:
        yield
    finally:
        process.terminate()
        await_end(process, BOARDS_END_TIMEOUT_S)


@contextlib.contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Let signals end the run in good order until the recording is closed; then they end the program."""
    stop = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield stop  # only the main thread may have signal handlers
        return
    before = {number: signal.signal(number, stop.set) for number in STOP_SIGNALS}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def free_udp_port() -> int:
    """Return a UDP port that no program uses at the moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))  # on all addresses, so that no other rig uses the port
        return int(probe.getsockname()[1])


def dropped_by_kernel(link: Link) -> str:
    """Return the number of frames that the kernel dropped, in words if it is not known."""
    with contextlib.suppress(LinkError, OSError):
        return str(link.dropped())
    return "unknown"
