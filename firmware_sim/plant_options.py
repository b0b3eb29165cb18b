"""Command-line options of ``firmware-sim`` and ``hil run`` that choose the simulated plant."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from firmware_sim.arm.event_text import FORMS, parse_event
from firmware_sim.faults.fault_text import FORMS as FAULT_FORMS
from firmware_sim.faults.fault_text import WHEN_FORMS, parse_fault
from hil.core.errors import DocumentError


def add_plant_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--arm``, ``--linear``, ``--plant``, ``--scenario``, ``--event``, ``--fault`` and ``--seed``."""
    base = parser.add_mutually_exclusive_group()
    base.add_argument(
        "--arm",
        type=Path,
        metavar="FILE",
        help="parameters of the pneumatic arm (default: the shipped arm.toml)",
    )
    base.add_argument(
        "--linear", action="store_true", help="simulate eq. (15) on every axis in place of the pneumatic arm"
    )
    parser.add_argument(
        "--plant",
        action="append",
        default=[],
        metavar="AXIS=FILE",
        help="simulate the linear model of a plant file (plant.json, or the name of a plant that hil design "
        "ships) on this axis; other axes stay as they are; may be repeated",
    )
    parser.add_argument(
        "--scenario", metavar="NAME", help="run an experiment: fig13, fig14, fig15, or a TOML file"
    )
    parser.add_argument(
        "--event",
        action="append",
        default=[],
        metavar="EVENT",
        help=f"let something happen to the arm S seconds after the first sample; may be repeated: {FORMS}",
    )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="FAULT",
        help="let something go wrong with frames, boards, sensors or valves, such as lose:sample,5@2; may be "
        f"repeated. The time is {WHEN_FORMS}. FRAME is sample, command, sync, …; AMOUNT is a number of "
        f"frames, or a share such as 10%%. {FAULT_FORMS}",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        metavar="N",
        help="seed of the potentiometers' noise and of random faults (default: 0)",
    )


def check_plant_options(options: argparse.Namespace) -> None:
    """Check what can be checked without a rig file. Raises DocumentError."""
    for name in ("scenario", "event"):
        if options.linear and getattr(options, name):
            raise DocumentError(
                f"--{name} is for the pneumatic arm; the linear model of --linear has nothing that it could "
                f"change. Omit --{name} or --linear"
            )
    for text in options.fault:
        parse_fault(text)
    named = named_plants(options.plant)
    for text in options.event:
        axis = getattr(parse_event(text), "axis", None)
        if axis in named:
            raise DocumentError(
                f"--event {text!r}: axis {axis} is a linear model (--plant), on which no event can act"
            )


def named_plants(given: Sequence[str]) -> dict[str, str]:
    """Split the values of ``--plant``, AXIS=FILE. Raises DocumentError."""
    named: dict[str, str] = {}
    for text in given:
        axis, _, file = text.partition("=")
        if not axis or not file:
            raise DocumentError(f"--plant {text!r}: not AXIS=FILE, such as vertical=plant.json")
        if axis in named:
            raise DocumentError(f"--plant {axis}: given twice, {named[axis]!r} and {file!r}")
        named[axis] = file
    return named


def given_plant_options(options: argparse.Namespace) -> list[str]:
    """Return the names of the given options that only a simulation has; ``--scenario`` is not one of them."""
    return [f"--{name}" for name in ("arm", "linear", "plant", "event", "fault") if getattr(options, name)]


def plant_arguments(options: argparse.Namespace) -> list[str]:
    """Return the options as arguments again, for a separate process of the boards."""
    arguments = ["--seed", str(options.seed)]
    if options.linear:
        arguments.append("--linear")
    for name in ("arm", "scenario"):
        value = getattr(options, name)
        if value is not None:
            arguments += [f"--{name}", str(value)]
    for name in ("plant", "event", "fault"):
        for text in getattr(options, name):
            arguments += [f"--{name}", text]
    return arguments
