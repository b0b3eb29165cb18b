"""Feeds the live views of a run in real time, and starts them."""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from hil.core.life_cycle import LifeCycleState
from hil.host.child_process import await_end
from hil.live.address import open_address
from hil.live.feed import LiveFeed
from hil.live.feed_file import RunInformation
from hil.live.process import start_foxglove_server, start_page_server
from hil.shells.run_setup import RIG_NAME, RunSetup

CLOSE_TIMEOUT_S = 3.0
"""Time in which a process that shows the run must end after the run."""


def make_feed(
    setup: RunSetup,
    bus: str,
    epoch_offset_ns: int,
    options: argparse.Namespace,
    recording: Callable[[], str],
    link: Path | None = None,
) -> LiveFeed:
    """Create the feed of a run. Raises EnvironmentLackError without shared memory.

    ``recording`` returns the path of the present recording, or an empty text; ``link``: where a daemon puts
    the link to the feed.
    """
    information = RunInformation(
        axes=[(name, axis.unit) for name, axis in setup.rig.axes.items()],
        period_s=setup.rig.loop.period_s,
        states=[state.name.lower() for state in LifeCycleState],
        rig=str(options.rig or "as shipped"),
        bus=bus,
        start_ns=time.monotonic_ns(),
        epoch_offset_ns=epoch_offset_ns,
        rig_text=setup.texts[RIG_NAME],
    )
    controllers = {name: controller.name for name, controller in setup.controllers.items()}
    return LiveFeed(information, controllers, recording, link)


@contextlib.contextmanager
def live_views(
    feed: LiveFeed, options: argparse.Namespace, operator_socket: Path | None = None
) -> Iterator[LiveFeed]:
    """Start the views that the user asks for, and print their addresses. At the end, close the feed.

    With ``operator_socket``, the path of the daemon's socket, the page may operate it. Enter this before the
    loop takes real-time rights, because processes inherit them. Raises EnvironmentLackError.
    """
    processes: list[subprocess.Popen[bytes]] = []
    try:
        if options.live:
            with open_address(options.host, options.port) as address:
                processes.append(start_page_server(address, feed=feed.path, operator_socket=operator_socket))
                sys.stdout.write(f"page: {address.url}\n")
        if options.foxglove is not None:
            process, url = start_foxglove_server(feed.path, options.host, options.foxglove)
            processes.append(process)
            sys.stdout.write(f"Foxglove: {url}\n")
        sys.stdout.flush()
        yield feed
    finally:
        feed.close()
        for process in processes:
            await_end(process, CLOSE_TIMEOUT_S)
