"""Which plant stands behind the simulated boards: the options that ``firmware-sim`` and ``hil run`` share."""

from __future__ import annotations

import argparse
from pathlib import Path

from firmware_sim.plant import Plant
from hil.errors import DocumentError
from hil.rig import Rig


def add_plant_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--arm``, ``--linear``, ``--scenario`` and ``--seed``."""
    plant = parser.add_mutually_exclusive_group()
    plant.add_argument("--arm", type=Path, metavar="FILE", help="the arm's parameters (the shipped arm.toml)")
    plant.add_argument(
        "--linear", action="store_true", help="eq. (15) on every axis in place of the pneumatic arm"
    )
    parser.add_argument(
        "--scenario", metavar="NAME", help="an experiment on the arm: fig13, fig14, fig15, or a TOML file"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the potentiometers' noise (0)")


def check_plant_options(options: argparse.Namespace) -> None:
    """Refuse options that exclude each other. Raises DocumentError."""
    if options.linear and options.scenario is not None:
        raise DocumentError("--scenario is an experiment on the pneumatic arm; --linear has none")


def plant_arguments(options: argparse.Namespace) -> list[str]:
    """The options as arguments again, for a process of the boards' own."""
    arguments = ["--seed", str(options.seed)]
    if options.linear:
        arguments.append("--linear")
    for name in ("arm", "scenario"):
        value = getattr(options, name)
        if value is not None:
            arguments += [f"--{name}", str(value)]
    return arguments


def build_plant(rig: Rig, options: argparse.Namespace) -> tuple[Plant, str]:
    """The plant that ``options`` ask for, and what it is in words. Raises DocumentError."""
    check_plant_options(options)
    if options.linear:
        from firmware_sim.linear_plant import LinearPlant

        return LinearPlant(rig), f"the linear model, eq. (15), for {', '.join(rig.axes)}"
    from firmware_sim.arm.arm import Arm
    from firmware_sim.arm.parameters import read_arm, shipped_arm

    parameters = shipped_arm() if options.arm is None else read_arm(_text(options.arm), str(options.arm))
    if options.scenario is None:
        return Arm(parameters, seed=options.seed), "the pneumatic arm"
    from firmware_sim.scenario import find_scenario, read_scenario

    path = find_scenario(options.scenario)
    scenario = read_scenario(_text(path), str(path))
    return Arm(parameters, seed=options.seed, changes=scenario.events), f"the pneumatic arm; {scenario.title}"


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise DocumentError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise DocumentError(f"{path}: is not text") from None
