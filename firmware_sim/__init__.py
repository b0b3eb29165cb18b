"""Simulated firmware: the valve and potentiometer boards of the rig, and the plants behind them.

A :class:`SimulatedRig` is both boards with a plant on their pins, as a state machine: it is given frames and
the time, and it returns frames. ``firmware-sim`` runs it on a bus in real time, ``hil run --lockstep`` in
simulated time. The names below are the public API. Each is imported when it is first used.

======================  =====================================================================================
``SimulatedRig``        both boards and the plant behind them
``AdcFaults``           faults of the potentiometer board, set on ``SimulatedRig.adc.faults``
``DacFaults``           faults of the valve board, set on ``SimulatedRig.dac.faults``
``Plant``               the interface of a plant behind the boards
``Arm``                 the pneumatic arm; ``shipped_arm`` and ``read_arm`` give its parameters
``wiring``              the arm's channels and scalings, from a rig file
``LinearPlant``         a linear model on each axis, eq. (15) by default
``LinearModel``         one linear model; ``read_plant_file`` reads it from a plant file
``parse_event``         an event on the arm, from a text such as ``payload:3@4``
``FaultyRig``           a ``SimulatedRig`` with faults of the fault library
``parse_fault``         a fault, from a text such as ``lose:sample,5@2``
``read_scenario``       an experiment in one file; ``find_scenario`` finds a shipped one
======================  =====================================================================================

>>> import hil
>>> from firmware_sim import Arm, SimulatedRig, shipped_arm, wiring
>>> rig = hil.load_rig()
>>> boards = SimulatedRig(rig, Arm(shipped_arm(), seed=1, wiring=wiring(rig)))
>>> [str(frame) for frame in boards.start(now_ns=0)]
['710#00', '720#00']
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from firmware_sim.arm.arm import Arm
    from firmware_sim.arm.arm_file import read_arm, shipped_arm
    from firmware_sim.arm.event_text import parse_event
    from firmware_sim.arm.wiring import wiring
    from firmware_sim.boards.faults import AdcFaults, DacFaults
    from firmware_sim.faults.fault_text import parse_fault
    from firmware_sim.faulty_rig import FaultyRig
    from firmware_sim.plants.linear_model import LinearModel
    from firmware_sim.plants.linear_plant import LinearPlant
    from firmware_sim.plants.plant import Plant
    from firmware_sim.plants.plant_file import read_plant_file
    from firmware_sim.scenario import find_scenario, read_scenario
    from firmware_sim.simulated_rig import SimulatedRig

_HOMES = {
    "AdcFaults": "firmware_sim.boards.faults",
    "Arm": "firmware_sim.arm.arm",
    "DacFaults": "firmware_sim.boards.faults",
    "FaultyRig": "firmware_sim.faulty_rig",
    "LinearModel": "firmware_sim.plants.linear_model",
    "LinearPlant": "firmware_sim.plants.linear_plant",
    "Plant": "firmware_sim.plants.plant",
    "SimulatedRig": "firmware_sim.simulated_rig",
    "find_scenario": "firmware_sim.scenario",
    "parse_event": "firmware_sim.arm.event_text",
    "parse_fault": "firmware_sim.faults.fault_text",
    "read_arm": "firmware_sim.arm.arm_file",
    "read_plant_file": "firmware_sim.plants.plant_file",
    "read_scenario": "firmware_sim.scenario",
    "shipped_arm": "firmware_sim.arm.arm_file",
    "wiring": "firmware_sim.arm.wiring",
}
"""Module of each public name."""

__all__ = [
    "AdcFaults",
    "Arm",
    "DacFaults",
    "FaultyRig",
    "LinearModel",
    "LinearPlant",
    "Plant",
    "SimulatedRig",
    "find_scenario",
    "parse_event",
    "parse_fault",
    "read_arm",
    "read_plant_file",
    "read_scenario",
    "shipped_arm",
    "wiring",
]


def __getattr__(name: str) -> object:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'firmware_sim' has no attribute {name!r}; it has {', '.join(__all__)}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
