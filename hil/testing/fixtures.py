"""The fixtures. ``hil.testing`` lists them."""

from __future__ import annotations

import inspect
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pytest

from hil.core.suggestions import did_you_mean
from hil.testing.evidence import keep_lockstep_rig, keep_on_failure

VCAN_OPTIONS: Final = ("rig", "boards", "gateway")
"""Options of the mark ``vcan_rig``."""

if TYPE_CHECKING:
    import can

    from hil.links import Link
    from hil.lockstep_rig import LockstepRig
    from hil.recording.reader import Recording
    from hil.testing.boards_alone import BoardsAlone
    from hil.testing.gateway_alone import GatewayAlone
    from hil.testing.vcan_processes import VcanBoards, VcanGateway, VcanRig


def _options(request: pytest.FixtureRequest, mark: str, known: Iterable[str]) -> dict[str, Any]:
    """Return the options of the test's marks, the nearest last, and those of an indirect parameter.

    An option that is not in ``known`` fails the test.
    """
    options: dict[str, Any] = {}
    for found in reversed(list(request.node.iter_markers(mark))):
        options |= found.kwargs
    given = getattr(request, "param", {})
    if not isinstance(given, Mapping):
        text = f"the parameter of {request.fixturename} is {given!r}, but must be a dict of its options"
        pytest.fail(text, pytrace=False)
    options |= given
    for name in map(str, options):
        if name not in known:
            text = f"{request.fixturename} (mark {mark}) has the options {', '.join(known)}; {name!r} is none"
            pytest.fail(f"{text}{did_you_mean(name, known)}", pytrace=False)
    return options


def _keywords(function: Callable[..., object]) -> list[str]:
    """Return the names of the arguments of ``function``."""
    return [name for name in inspect.signature(function).parameters if name != "self"]


@pytest.fixture
def make_lockstep_rig(request: pytest.FixtureRequest) -> Callable[..., LockstepRig]:
    """Return a function that builds a rig in simulated time.

    ``make_lockstep_rig(state="running", **options)`` takes the options of :class:`hil.LockstepRig` and brings
    the rig to ``state``: ``offline``, ``ready``, ``armed`` or ``running``.
    """
    built = 0

    def make(state: str = "running", **options: Any) -> LockstepRig:
        nonlocal built
        from hil.testing.lockstep_states import build_rig

        built += 1
        rig = build_rig(state, options)
        name = "run" if built == 1 else f"run-{built}"
        keep_on_failure(request.node, keep_lockstep_rig(rig, name))
        return rig

    return make


@pytest.fixture
def lockstep_rig(
    request: pytest.FixtureRequest, make_lockstep_rig: Callable[..., LockstepRig]
) -> LockstepRig:
    """Return a rig in simulated time, in state running.

    ``@pytest.mark.lockstep_rig(setpoints={"vertical": "step:0.1@1"}, faults=["lose:sample,3@2"])``, or an
    indirect parameter with the same keys, configures it.
    """
    from hil.lockstep_rig import LockstepRig

    return make_lockstep_rig(**_options(request, "lockstep_rig", ["state", *_keywords(LockstepRig)]))


@pytest.fixture
def gateway_alone(request: pytest.FixtureRequest) -> GatewayAlone:
    """Return the gateway core in simulated time, without boards.

    ``@pytest.mark.lockstep_rig(rig=…, controllers=…, setpoints=…)`` configures it.
    """
    from hil.testing.gateway_alone import GatewayAlone

    return GatewayAlone(**_options(request, "lockstep_rig", _keywords(GatewayAlone)))


@pytest.fixture
def boards_alone(request: pytest.FixtureRequest) -> BoardsAlone:
    """Return the simulated boards and the arm in simulated time, without a gateway.

    ``@pytest.mark.lockstep_rig(rig=…, plant=…, faults=…, seed=…)`` configures them.
    """
    from hil.testing.boards_alone import BoardsAlone

    return BoardsAlone(**_options(request, "lockstep_rig", _keywords(BoardsAlone)))


@pytest.fixture
def inject_fault(request: pytest.FixtureRequest) -> Callable[[str], object]:
    """Return a function that lets a fault begin now, such as ``lose:sample,5@0``.

    It acts on the test's ``boards_alone`` if it uses that fixture, else on its ``lockstep_rig``.
    """
    name = "boards_alone" if "boards_alone" in request.fixturenames else "lockstep_rig"
    inject: Callable[[str], object] = request.getfixturevalue(name).inject_fault
    return inject


@pytest.fixture(scope="session")
def record_run(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Recording]:
    """Return a function that makes a recording in simulated time.

    ``record_run(duration_s=3.0, **options)`` takes the options of :class:`hil.LockstepRig`. The same options
    give the same recording, which is made once a session.
    """
    folder = tmp_path_factory.mktemp("recordings")
    made: dict[str, Recording] = {}

    def record(duration_s: float = 3.0, **options: Any) -> Recording:
        from hil.testing.lockstep_states import build_rig

        key = repr((duration_s, sorted(options.items())))
        if key not in made:
            rig = build_rig("running", options)
            rig.run(duration_s)
            made[key] = rig.save_recording(folder / f"{len(made) + 1}.mcap")
        return made[key]

    return record


@pytest.fixture
def vcan_interface() -> str:
    """Return the name of the virtual CAN interface."""
    from hil.host.vcan import INTERFACE

    return INTERFACE


@pytest.fixture
def vcan_bus(vcan_interface: str) -> Iterator[can.BusABC]:
    """Return a bus of python-can on ``vcan0``."""
    from can.interfaces.socketcan import SocketcanBus

    with SocketcanBus(vcan_interface) as bus:
        yield bus


@pytest.fixture
def vcan_link(vcan_interface: str) -> Iterator[Link]:
    """Return a ``hil.links.Link`` on ``vcan0``."""
    from hil.links import open_link

    with open_link(vcan_interface) as link:
        yield link


@pytest.fixture
def vcan_boards(request: pytest.FixtureRequest, vcan_interface: str, tmp_path: Path) -> Iterator[VcanBoards]:
    """Return the simulated boards as a process on ``vcan0``, for a master of one's own.

    ``@pytest.mark.vcan_rig(rig=…, boards=["--linear"])`` configures it: ``boards`` are arguments of
    ``firmware-sim``.
    """
    from hil.testing.vcan_processes import VcanBoards

    options = _options(request, "vcan_rig", VCAN_OPTIONS)
    with VcanBoards(vcan_interface, tmp_path, options.get("rig"), options.get("boards", ())) as boards:
        yield boards


@pytest.fixture
def vcan_gateway(
    request: pytest.FixtureRequest, vcan_interface: str, tmp_path: Path
) -> Iterator[VcanGateway]:
    """Return a gateway for ``vcan0``, for boards of one's own. ``start`` begins ``hil run`` as a process.

    ``@pytest.mark.vcan_rig(rig=…, gateway=["--setpoint", "vertical=step:0.1@1"])`` configures it: ``gateway``
    are arguments of ``hil run``.
    """
    from hil.testing.vcan_processes import VcanGateway

    options = _options(request, "vcan_rig", VCAN_OPTIONS)
    gateway = VcanGateway(vcan_interface, tmp_path, options.get("rig"), options.get("gateway", ()))
    with gateway:
        keep_on_failure(request.node, lambda folder: _keep_gateway(gateway, folder))
        yield gateway


@pytest.fixture
def vcan_rig(vcan_boards: VcanBoards, vcan_gateway: VcanGateway) -> VcanRig:
    """Return boards and gateway as two processes on ``vcan0``."""
    from hil.testing.vcan_processes import VcanRig

    return VcanRig(vcan_boards, vcan_gateway)


def _keep_gateway(gateway: VcanGateway, folder: Path) -> list[str]:
    """End the run, and keep its recording, plot and output."""
    from hil.recording import open_recording
    from hil.testing.evidence import keep_recording

    if not gateway.was_started:
        return ["the gateway was not started"]
    gateway.stop()
    (folder / "run.log").write_text(gateway.output(), encoding="utf-8")
    lines = [f"log        {folder / 'run.log'}"]
    if not gateway.recording_path.exists():
        return [*lines, "no recording: the run did not begin"]
    shutil.copy(gateway.recording_path, folder / "run.mcap")
    return [*keep_recording(open_recording(folder / "run.mcap"), folder, "run"), *lines]
