"""Hardware-in-the-loop gateway over CAN and serial for a three-axis pneumatic robot arm.

The names below are the public API. Each is imported when it is first used, so that ``import hil`` is fast.

=====================  ======================================================================================
``open_recording``     open the recording of a run; :class:`Recording` has signals, frames, log and documents
``connect``            operate a running daemon; :class:`Client`
``run_experiment``     run the controllers against the simulated arm in simulated time, and record the run
``LockstepRig``        the gateway and the simulated boards in one process, stepped period by period
``load_rig``           read a rig file; :class:`Rig`
``load_controller``    read a controller file; :class:`ControllerFile`
``ControlLaw``         a controller file's law as the gateway runs it
``Gateway``            the gateway core: a state machine without I/O
``Frame``              a classic CAN frame
``open_link``          a CAN bus or serial adapter, by its name on the command line
``HilError``           base of all errors that a user can correct
=====================  ======================================================================================

``ARCHITECTURE.md`` in this folder is one page on how the code is built.

>>> import hil
>>> rig = hil.load_rig()
>>> rig.loop.period_s
0.0112
>>> hil.load_controller("ppid").law.kp
11.013
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hil.core.control_law import ControlLaw
    from hil.core.controller_file import ControllerFile
    from hil.core.errors import HilError
    from hil.core.frames import Frame
    from hil.core.gateway import Gateway
    from hil.core.rig import Rig
    from hil.links import open_link
    from hil.lockstep_rig import LockstepRig, run_experiment
    from hil.operation.client import Client, connect
    from hil.recording import open_recording
    from hil.recording.reader import Recording
    from hil.shells.run_setup import load_controller, load_rig

__version__ = "0.7.0"

_HOMES = {
    "Client": "hil.operation.client",
    "ControlLaw": "hil.core.control_law",
    "ControllerFile": "hil.core.controller_file",
    "Frame": "hil.core.frames",
    "Gateway": "hil.core.gateway",
    "HilError": "hil.core.errors",
    "LockstepRig": "hil.lockstep_rig",
    "Recording": "hil.recording.reader",
    "Rig": "hil.core.rig",
    "connect": "hil.operation.client",
    "load_controller": "hil.shells.run_setup",
    "load_rig": "hil.shells.run_setup",
    "open_link": "hil.links",
    "open_recording": "hil.recording",
    "run_experiment": "hil.lockstep_rig",
}
"""Module of each public name."""

__all__ = [
    "Client",
    "ControlLaw",
    "ControllerFile",
    "Frame",
    "Gateway",
    "HilError",
    "LockstepRig",
    "Recording",
    "Rig",
    "connect",
    "load_controller",
    "load_rig",
    "open_link",
    "open_recording",
    "run_experiment",
]


def __getattr__(name: str) -> object:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'hil' has no attribute {name!r}; it has {', '.join(__all__)}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
