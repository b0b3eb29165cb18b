"""Which plant stands behind the simulated boards: the options that ``firmware-sim`` and ``hil run`` share."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from firmware_sim.arm.event_text import FORMS, event_text, parse_event
from firmware_sim.arm.parameters import read_arm, shipped_arm_text
from firmware_sim.arm.wiring import wiring
from firmware_sim.plants.plant import Plant
from firmware_sim.scenario import Scenario, find_scenario, read_scenario
from hil.core.errors import DocumentError
from hil.core.rig import Rig
from hil.host.text_file import read_text


def add_plant_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--arm``, ``--linear``, ``--scenario``, ``--event`` and ``--seed``."""
    plant = parser.add_mutually_exclusive_group()
    plant.add_argument("--arm", type=Path, metavar="FILE", help="the arm's parameters (the shipped arm.toml)")
    plant.add_argument(
        "--linear", action="store_true", help="eq. (15) on every axis in place of the pneumatic arm"
    )
    parser.add_argument(
        "--scenario", metavar="NAME", help="an experiment on the arm: fig13, fig14, fig15, or a TOML file"
    )
    parser.add_argument(
        "--event",
        action="append",
        default=[],
        metavar="EVENT",
        help=f"what happens to the arm, S seconds from the first sample on; may be given again: {FORMS}",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the potentiometers' noise (0)")


def check_plant_options(options: argparse.Namespace) -> None:
    """Refuse options that exclude each other, and events that cannot be. Raises DocumentError."""
    for name in ("scenario", "event"):
        if options.linear and getattr(options, name):
            raise DocumentError(f"--{name} is for the pneumatic arm; --linear has nothing that could change")
    for text in options.event:
        parse_event(text)


def plant_arguments(options: argparse.Namespace) -> list[str]:
    """The options as arguments again, for a process of the boards' own."""
    arguments = ["--seed", str(options.seed)]
    if options.linear:
        arguments.append("--linear")
    for name in ("arm", "scenario"):
        value = getattr(options, name)
        if value is not None:
            arguments += [f"--{name}", str(value)]
    for text in options.event:
        arguments += ["--event", text]
    return arguments


def plant_texts(rig: Rig, options: argparse.Namespace) -> dict[str, str]:
    """What is simulated, for a recording, by file name: with it a run can be repeated.

    ``plant.json`` has model, seed and events (of the command line, apart by spaces), all as strings;
    ``arm.toml`` is the arm, the shipped one too; ``scenario.toml`` is there where there is one.
    Raises DocumentError for what :func:`build_plant` would refuse.
    """
    if options.linear:
        return {"plant.json": _json(model="linear, eq. (15)", seed=str(options.seed))}
    arm_text = _arm_text(options)
    wiring(rig)
    read_arm(arm_text, str(options.arm or "arm.toml"))
    plant = _json(model="pneumatic arm", seed=str(options.seed), events=" ".join(options.event))
    texts = {"plant.json": plant, "arm.toml": arm_text}
    if options.scenario is not None:
        texts["scenario.toml"] = read_text(find_scenario(options.scenario))
    return texts


def planned_events(options: argparse.Namespace) -> dict[str, float]:
    """What will happen to the arm, by scenario and command line, and its seconds from the first sample on."""
    scenario = _scenario(options)
    changes = [*(scenario.events if scenario else ()), *map(parse_event, options.event)]
    return {event_text(change): change.at_s for change in sorted(changes, key=lambda change: change.at_s)}


def build_plant(rig: Rig, options: argparse.Namespace) -> tuple[Plant, str]:
    """The plant that ``options`` ask for, and what it is in words. Raises DocumentError."""
    check_plant_options(options)
    if options.linear:
        from firmware_sim.plants.linear_plant import LinearPlant

        return LinearPlant(rig), f"the linear model, eq. (15), for {', '.join(rig.axes)}"
    from firmware_sim.arm.arm import Arm

    scenario = _scenario(options)
    changes = [*(scenario.events if scenario else ()), *map(parse_event, options.event)]
    parameters = read_arm(_arm_text(options), str(options.arm or "arm.toml"))
    arm = Arm(parameters, seed=options.seed, changes=changes, wiring=wiring(rig))
    return arm, "; ".join(["the pneumatic arm", *([scenario.title] if scenario else []), *options.event])


def _scenario(options: argparse.Namespace) -> Scenario | None:
    if options.scenario is None:
        return None
    path = find_scenario(options.scenario)
    return read_scenario(read_text(path), str(path))


def _arm_text(options: argparse.Namespace) -> str:
    return shipped_arm_text() if options.arm is None else read_text(options.arm)


def _json(**facts: str) -> str:
    return json.dumps(facts, indent=2) + "\n"
