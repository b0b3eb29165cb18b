"""The plant that the command-line options choose, and the documents with which a recording can repeat it.

The axes of ``--plant`` have the linear models of their plant files. The other axes have eq. (15) with
``--linear``, and the pneumatic arm's own dynamics without. The arm's axis that a linear model replaces stands
still at rest, so it draws no air and puts no load on the other axes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from firmware_sim.arm.arm_file import read_arm, shipped_arm_text
from firmware_sim.arm.event_text import event_text, parse_event
from firmware_sim.arm.events import AnyEvent
from firmware_sim.arm.wiring import Wires, wiring
from firmware_sim.faults.checks import acts_on_arm, check_is_seen, no_process
from firmware_sim.faults.fault_text import fault_text, parse_fault
from firmware_sim.faults.kinds import AnyFault, ArmFault, HostFault, ProcessFault
from firmware_sim.faulty_rig import FaultyRig
from firmware_sim.plant_files import AxisPlant, read_axis_plants
from firmware_sim.plant_options import check_plant_options, named_plants
from firmware_sim.plants.plant import Plant
from firmware_sim.scenario import Scenario, find_scenario, read_scenario
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import DocumentError
from hil.core.rig import Rig
from hil.host.text_file import read_text

if TYPE_CHECKING:
    from hil.links.bus_model.rig_bus import RigBus

SHIPPED_ARM = "arm.toml"


def build_plant(rig: Rig, options: argparse.Namespace) -> tuple[Plant, str]:
    """Build the plant that ``options`` choose. Returns it with a description. Raises DocumentError."""
    choice = _choose(rig, options)
    parts: list[Plant] = []
    texts: list[str] = []
    if choice.arm_wiring:
        from firmware_sim.arm.arm import Arm

        parameters = read_arm(_arm_text(options), str(options.arm or SHIPPED_ARM))
        parts.append(Arm(parameters, seed=options.seed, events=choice.events, wiring=choice.arm_wiring))
        texts += ["the pneumatic arm", *([choice.scenario.title] if choice.scenario else []), *options.event]
    if choice.plants or options.linear:
        from firmware_sim.plants.linear_model import EQUATION_15
        from firmware_sim.plants.linear_plant import LinearPlant

        others = [axis for axis in rig.axes if axis not in choice.plants] if options.linear else []
        models = {axis: plant.model for axis, plant in choice.plants.items()}
        parts.append(LinearPlant(rig, dict.fromkeys(others, EQUATION_15) | models))
        texts += [f"the linear model, eq. (15), for {', '.join(others)}"] if others else []
        texts += [f"the linear model {plant.name!r} for {axis}" for axis, plant in choice.plants.items()]
    if len(parts) == 1:
        return parts[0], "; ".join(texts)
    from firmware_sim.plants.combined_plant import CombinedPlant

    return CombinedPlant(parts), "; ".join(texts)


def plant_texts(rig: Rig, options: argparse.Namespace) -> dict[str, str]:
    """Return the documents that describe the plant, by file name, for a recording. A run can be repeated with
    them.

    - ``plant.json``: model, seed, events of the command line, faults and axes of ``--plant`` (each separated
      by spaces), all as strings.
    - ``arm.toml``: the arm, if it is simulated.
    - ``plants/<axis>.json``: the plant file of an axis.
    - ``scenario.toml``: the scenario, if one is given.

    Raises DocumentError for options that :func:`build_plant` does not accept.
    """
    choice = _choose(rig, options)
    facts = {"model": "linear, eq. (15)" if options.linear else "linear", "seed": str(options.seed)}
    texts = {}
    if choice.arm_wiring:
        arm_text = _arm_text(options)
        read_arm(arm_text, str(options.arm or SHIPPED_ARM))
        facts |= {"model": "pneumatic arm", "events": " ".join(options.event)}
        texts["arm.toml"] = arm_text
    faults = planned_faults(options)
    if faults:
        facts["faults"] = " ".join(map(fault_text, faults))
    if choice.plants:
        facts["plants"] = " ".join(choice.plants)
        texts |= {f"plants/{axis}.json": plant.text for axis, plant in choice.plants.items()}
    if options.scenario is not None:
        texts["scenario.toml"] = read_text(find_scenario(options.scenario))
    return {"plant.json": json.dumps(facts, indent=2) + "\n", **texts}


def planned_events(options: argparse.Namespace) -> dict[str, float]:
    """Return events and faults of scenario and command line: text to seconds after the first sample.

    Faults that wait for a condition are not among them.
    """
    planned = {event_text(event): event.at_s for event in arm_events(options)}
    planned |= {fault_text(fault): fault.at_s for fault in planned_faults(options) if not fault.when}
    return dict(sorted(planned.items(), key=lambda item: item[1]))


def build_boards(
    rig: Rig,
    plant: Plant,
    options: argparse.Namespace,
    *,
    may_break: bool = False,
    is_told_states: bool = False,
    bus: RigBus | None = None,
) -> SimulatedRig | FaultyRig:
    """Return the boards before ``plant``, with the faults that ``options`` choose. Raises DocumentError.

    ``may_break`` is True if faults can be added while the rig is simulated, ``is_told_states`` if the rig is
    told the gateway's states. ``bus`` is the modelled bus between gateway and boards, if there is one.
    """
    boards = SimulatedRig(rig, plant)
    faults = planned_faults(options)
    if not faults and not may_break:
        return boards
    return FaultyRig(rig, boards, faults, seed=options.seed, bus=bus, is_told_states=is_told_states)


def arm_events(options: argparse.Namespace) -> list[AnyEvent]:
    """Return the planned events of scenario and command line, in this order. Raises DocumentError."""
    return _events(_scenario(options), options)


def planned_faults(options: argparse.Namespace) -> list[AnyFault]:
    """Return the faults of scenario and command line, in this order. Raises DocumentError."""
    scenario = _scenario(options)
    return [*(scenario.faults if scenario else ()), *map(parse_fault, options.fault)]


def faults_not_begun(options: argparse.Namespace, begun: Iterable[str]) -> list[str]:
    """Return a sentence on each planned fault that is not in ``begun``, as texts."""
    reasons = []
    for fault in planned_faults(options):
        reason = _too_late(fault.at_s)
        if fault.when:
            late = f", or came less than {fault.at_s:g} s before the end of the run" if fault.at_s else ""
            reason = f"its condition never came{late}"
        reasons.append((fault_text(fault), reason))
    return _not_begun(reasons, begun)


def events_not_begun(options: argparse.Namespace, begun: Iterable[str]) -> list[str]:
    """Return a sentence on each planned event that is not in ``begun``, as texts."""
    return _not_begun([(event_text(event), _too_late(event.at_s)) for event in arm_events(options)], begun)


def _too_late(at_s: float) -> str:
    return f"the run ended before {at_s:g} s had passed since the first sample"


def _not_begun(reasons: Iterable[tuple[str, str]], begun: Iterable[str]) -> list[str]:
    """Return a sentence for each text that is not in ``begun``, with its reason. Repetitions count."""
    missing = list(begun)
    sentences = []
    for text, reason in reasons:
        if text in missing:
            missing.remove(text)
        else:
            sentences.append(f"{text} did not begin: {reason}")
    return sentences


def refuse_host_faults(options: argparse.Namespace) -> None:
    """Raise DocumentError for faults of the gateway's host, which the boards in real time do not have."""
    for fault in planned_faults(options):
        if isinstance(fault, ProcessFault):
            raise DocumentError(no_process(fault))
        if isinstance(fault, HostFault):
            raise DocumentError(
                f"fault {fault_text(fault)!r} acts on the gateway's host in simulated time only; use hil run "
                "--lockstep, or omit the fault"
            )


@dataclass(frozen=True)
class _Choice:
    """Checked options."""

    plants: dict[str, AxisPlant]
    """Plant file of each axis of ``--plant``."""
    arm_wiring: dict[str, Wires]
    """Axes that the pneumatic arm simulates; empty without the arm."""
    scenario: Scenario | None
    events: list[AnyEvent]


def _choose(rig: Rig, options: argparse.Namespace) -> _Choice:
    check_plant_options(options)
    plants = read_axis_plants(rig, named_plants(options.plant))
    arm_wiring = {} if options.linear else wiring(rig, without=plants)
    scenario = _scenario(options)
    events = _events(scenario, options)
    for event in events:
        if not arm_wiring or getattr(event, "axis", None) in plants:
            raise DocumentError(
                f"event {event_text(event)!r} (of --event or --scenario) acts on the pneumatic arm, but "
                f"--plant puts a linear model on {', '.join(plants)}. Omit the event or --plant"
            )
        check_is_seen(event, rig, f"event {event_text(event)!r}")
    for fault in planned_faults(options):
        if isinstance(fault, ArmFault):
            check_is_seen(fault.event, rig, f"fault {fault_text(fault)!r}")
            _check_arm_fault(fault, arm_wiring, plants)
    if options.arm and not arm_wiring:
        raise DocumentError(
            f"--arm {options.arm}: --plant puts a linear model on every axis. Omit --arm or --plant"
        )
    return _Choice(plants, arm_wiring, scenario, events)


def _check_arm_fault(
    fault: ArmFault, arm_wiring: Mapping[str, Wires], plants: Mapping[str, AxisPlant]
) -> None:
    """Raise DocumentError if a linear model replaces the part of the arm on which a fault acts."""
    axis = getattr(fault.event, "axis", None)
    if arm_wiring and axis not in plants:
        return
    replaced = f"{axis} has a linear model" if arm_wiring else "every axis has a linear model"
    raise DocumentError(
        f"fault {fault_text(fault)!r} (of --fault or --scenario) {acts_on_arm(replaced)}. Omit the fault, or "
        "--linear or --plant"
    )


def _events(scenario: Scenario | None, options: argparse.Namespace) -> list[AnyEvent]:
    return [*(scenario.events if scenario else ()), *map(parse_event, options.event)]


def _scenario(options: argparse.Namespace) -> Scenario | None:
    if options.scenario is None:
        return None
    path = find_scenario(options.scenario)
    return read_scenario(read_text(path), str(path))


def _arm_text(options: argparse.Namespace) -> str:
    return shipped_arm_text() if options.arm is None else read_text(options.arm)
