"""Starts the page in the browser for a run in real time."""

from __future__ import annotations

import argparse
import sys
import time

from hil.core.life_cycle import LifeCycleState
from hil.live.address import open_address
from hil.live.feed import LiveFeed, RunInformation
from hil.shells.run_setup import RIG_NAME, RunSetup


def start_page(
    setup: RunSetup,
    recording: str,
    bus: str,
    epoch_offset_ns: int,
    options: argparse.Namespace,
    operator_socket: str | None = None,
) -> LiveFeed:
    """Start the process that serves the page of a run in real time, and print the page's address.

    With ``operator_socket``, the path of the daemon's socket, the page may operate it. Call this before the
    loop takes real-time rights. Raises EnvironmentLackError if the page cannot be served.
    """
    information = RunInformation(
        axes=[(name, axis.unit) for name, axis in setup.rig.axes.items()],
        period_s=setup.rig.loop.period_s,
        states=[state.name.lower() for state in LifeCycleState],
        rig=str(options.rig or "as shipped"),
        bus=bus,
        controllers={name: controller.name for name, controller in setup.controllers.items()},
        recording=recording,
        start_ns=time.monotonic_ns(),
        epoch_offset_ns=epoch_offset_ns,
        rig_text=setup.texts[RIG_NAME],
    )
    with open_address(options.host, options.port) as address:
        feed = LiveFeed(information, address, operator_socket)
        sys.stdout.write(f"page: {address.url}\n")
        sys.stdout.flush()
    return feed
