"""Tests of one's own: a pytest plugin with rigs, buses, faults and assertions.

The plugin is installed with the package (``pip install pneumatic-hil[test]``). It imports nothing slow before
a test needs it.

======================  =====================================================================================
fixture                 what the test gets
======================  =====================================================================================
``lockstep_rig``        gateway, boards and arm in simulated time, in state running
``make_lockstep_rig``   a function that builds such rigs
``gateway_alone``       the gateway core without boards: the test plays the boards
``boards_alone``        the simulated boards and the arm without a gateway: the test plays the master
``inject_fault``        a function that lets a fault begin, on ``lockstep_rig`` or ``boards_alone``
``record_run``          a function that makes a recording in simulated time, once a session for each setting
``vcan_interface``      the name of the virtual CAN interface, ``vcan0``
``vcan_bus``            a ``can.Bus`` of python-can on it
``vcan_link``           a ``hil.links.Link`` on it
``vcan_boards``         the simulated boards as a process on it (``firmware-sim``)
``vcan_gateway``        a gateway as a process on it (``hil run``), for boards of one's own
``vcan_rig``            both processes
======================  =====================================================================================

``@pytest.mark.lockstep_rig(…)`` and ``@pytest.mark.vcan_rig(…)`` configure the rig. A test that uses
``vcan0`` without these fixtures has the mark ``vcan``. Where this kernel has no ``vcan0``, all tests that
need it run through ``hil vcan``, in one process for the whole session. If that is impossible, they fail and
say why.

The fixtures return a ``hil.LockstepRig``, or a :class:`GatewayAlone`, :class:`BoardsAlone`,
:class:`VcanBoards`, :class:`VcanGateway` or :class:`VcanRig`. A fault such as ``lose:sample,5@2`` is
injected by their method ``inject_fault``, by their option ``faults``, or by ``boards=["--fault", …]`` on
``vcan0``. Faults of the gateway's processes, ``kill:gateway@0``, ``pause:gateway@2/0.5``,
``kill:recorder@0`` and ``fill-disk@0``, are injected by :meth:`VcanGateway.inject_fault`.

With ``@pytest.mark.lockstep_rig(bit_rate=500_000)`` or ``bus.bit_rate`` in the rig file, the rig in simulated
time has a modelled bus: frames take their bit times, wait by identifier, and are refused by a full queue.
``lockstep_rig.bus`` has the error counters and queues of its nodes.

A test that fails keeps its recording, plot and log in the folder ``hil-failures``; the report says where.

========================  ===================================================================================
``assert_step_response``  overshoot, settling time and steady-state error of the last step of an axis
``assert_within_limits``  position, error, valve voltage and its rate, by default against the rig file
========================  ===================================================================================
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hil.testing.boards_alone import BoardsAlone
    from hil.testing.gateway_alone import GatewayAlone
    from hil.testing.limit_assertion import assert_within_limits
    from hil.testing.step_assertion import assert_step_response
    from hil.testing.vcan_processes import VcanBoards, VcanGateway, VcanRig

_HOMES = {
    "BoardsAlone": "hil.testing.boards_alone",
    "GatewayAlone": "hil.testing.gateway_alone",
    "VcanBoards": "hil.testing.vcan_processes",
    "VcanGateway": "hil.testing.vcan_processes",
    "VcanRig": "hil.testing.vcan_processes",
    "assert_step_response": "hil.testing.step_assertion",
    "assert_within_limits": "hil.testing.limit_assertion",
}
"""Module of each public name."""

__all__ = [
    "BoardsAlone",
    "GatewayAlone",
    "VcanBoards",
    "VcanGateway",
    "VcanRig",
    "assert_step_response",
    "assert_within_limits",
]


def __getattr__(name: str) -> object:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'hil.testing' has no attribute {name!r}; it has {', '.join(__all__)}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
