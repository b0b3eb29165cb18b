"""A whole rig in one process and in simulated time, for programs and tests of one's own.

:class:`LockstepRig` is stepped period by period. :func:`run_experiment` is ``hil run --lockstep`` as a
function. Nothing here reads a clock. The same calls give the same frames in every run.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from hil.core.errors import HilError
from hil.core.frames import Frame
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import AxisSignals, Cycle, LogEntry, Output
from hil.core.requests import Reply, Request
from hil.core.wire.codec import RPDO1_DAC
from hil.links.bus_model.rig_bus import RigBus
from hil.shells.journal import Journal
from hil.shells.lockstep import Lockstep
from hil.shells.lockstep_bus import BusLockstep
from hil.shells.run_setup import RunSetup, load_setup
from hil.shells.simulated_faults import StateReports, event_entry, fault_entry, faults_by_instant

if TYPE_CHECKING:
    from firmware_sim.arm.events import AnyEvent
    from firmware_sim.faults.kinds import AnyFault
    from firmware_sim.plants.plant import Plant
    from hil.recording.reader import Recording
    from hil.recording.tables import AxisTable

MAX_BRING_UP_PERIODS = 500
"""Periods in which the boards and their samples must become good."""


class LockstepRig:
    """The gateway and the simulated boards, advanced by :meth:`step`.

    Positions are in m or rad, voltages in V, times in nanoseconds since the boards were switched on.

    >>> rig = LockstepRig(setpoints={"vertical": "step:0.05@0.5"})
    >>> rig.bring_up()
    >>> rig.arm()
    >>> rig.start()
    >>> rig.step(periods=200)
    >>> rig.state.name
    'RUNNING'
    >>> round(rig.signals["vertical"].position, 2)
    0.05
    """

    def __init__(
        self,
        rig: str | os.PathLike[str] | RunSetup | None = None,
        *,
        controllers: Mapping[str, str] | None = None,
        setpoints: Mapping[str, str] | None = None,
        plant: Plant | None = None,
        faults: Iterable[AnyFault | str] = (),
        seed: int = 0,
        bit_rate: int | None = None,
    ) -> None:
        """Build the rig of a rig file, of the shipped one, or of a set-up that has been read already.

        ``controllers`` (shipped names or files) and ``setpoints`` (such as ``step:0.1@1``) are given by axis
        and replace those of the rig file; a set-up has its own. ``plant`` is what the boards are wired to. By
        default it is the pneumatic arm, with ``seed`` for the noise of its potentiometers. ``faults`` are
        texts such as ``lose:sample,5@2``, or documents of ``firmware_sim.faults.kinds``. Their times count
        from the first sample. ``bit_rate`` in bit/s, or else ``bus.bit_rate`` of the rig file, gives the rig
        a modelled bus, on which frames take time and wait. Raises DocumentError or SetpointError.
        """
        from firmware_sim.arm.arm import Arm
        from firmware_sim.arm.arm_file import shipped_arm
        from firmware_sim.arm.wiring import wiring
        from firmware_sim.faulty_rig import FaultyRig
        from firmware_sim.simulated_rig import SimulatedRig

        if isinstance(rig, RunSetup):
            if controllers or setpoints:
                raise TypeError("controllers and setpoints are those of the set-up that is given")
            setup = rig
        else:
            setup = load_setup(None if rig is None else Path(rig), controllers or {}, setpoints or {})
        self._setup = setup
        self.rig = setup.rig
        if plant is None:
            plant = Arm(shipped_arm(), seed=seed, wiring=wiring(setup.rig))
        self.boards = SimulatedRig(setup.rig, plant)
        """The simulated boards. Their ``adc.faults`` and ``dac.faults`` can be set at any time."""
        bit_rate = bit_rate or setup.rig.bus.bit_rate
        self.bus = None if bit_rate is None else RigBus(bit_rate)
        """The modelled bus, with the error counters of its nodes; None if frames arrive at once."""
        self._faulty = faulty = FaultyRig(
            setup.rig, self.boards, faults, seed=seed, bus=self.bus, is_told_states=True
        )
        if self.bus is None:
            self._lockstep = Lockstep(faulty, 0, faulty.host)
        else:
            self._lockstep = BusLockstep(faulty, 0, self.bus, faulty.host)
        self._side = _Side(setup.gateway(setup.rig.loop.period_ns), self._lockstep, faulty.gateway_entered)
        faulty.on_begin = self._note_fault
        self.boards.on_event = self._note_event
        self._lockstep.begin(self._side)

    @property
    def gateway(self) -> Gateway:
        """The gateway core."""
        return self._side.gateway

    @property
    def state(self) -> LifeCycleState:
        """Present state of the gateway's life cycle."""
        return self._side.gateway.state

    @property
    def now_ns(self) -> int:
        """Simulated time in nanoseconds."""
        return self._lockstep.clock_ns()

    @property
    def log(self) -> list[LogEntry]:
        """All log entries of the gateway so far, and those of simulated faults and events that have begun."""
        return self._side.log

    @property
    def cycles(self) -> list[Cycle]:
        """All periods so far, with the signals of every axis."""
        return self._side.cycles

    @property
    def sent(self) -> list[Frame]:
        """All frames that the gateway has sent so far, without those that the bus refused."""
        return self._side.sent

    @property
    def faults_begun(self) -> list[tuple[int, str]]:
        """Time in nanoseconds and text of each fault of the fault library that has begun."""
        return self._faulty.begun

    @property
    def signals(self) -> dict[str, AxisSignals]:
        """Signals of each axis in the last period, by axis name; empty before the first period."""
        return dict(zip(self.rig.axes, self.cycles[-1].axes, strict=True)) if self.cycles else {}

    def step(self, periods: int = 1) -> None:
        """Advance by a number of periods of the loop. Raises HilError for a negative one."""
        if periods < 0:
            raise HilError(f"periods is {periods}, but must be at least 0: simulated time never goes back")
        for _ in range(periods):
            while not self._lockstep.step(self._side):
                pass

    def run(self, duration_s: float) -> None:
        """Advance by a time in seconds, rounded to whole periods. Raises HilError if it is no such time."""
        if not 0.0 <= duration_s < math.inf:
            raise HilError(f"duration_s is {duration_s:g} s, but must be finite and at least 0 s")
        self.step(round(duration_s / self.rig.loop.period_s))

    def axis(self, name: str) -> AxisTable:
        """Return the signals of an axis so far, one row for each period, as ``Recording.axis`` does."""
        from hil.lockstep_tables import axis_table

        return axis_table(self.rig, self.cycles, name)

    def bring_up(self) -> None:
        """Advance until the boards and their samples are good. Raises HilError if they are not in time."""
        for _ in range(MAX_BRING_UP_PERIODS):
            if self.state is not LifeCycleState.OFFLINE:
                return
            self.step()
        raise HilError(
            f"the boards are not ready after {MAX_BRING_UP_PERIODS} periods: {self.gateway.readiness}"
        )

    def arm(self) -> None:
        """Allow motion. Raises HilError if the state does not allow it."""
        self._operate(Trigger.ARM)

    def start(self) -> None:
        """Let the controllers act. Raises HilError if the state does not allow it."""
        self._operate(Trigger.START)

    def stop(self) -> None:
        """Centre the valves and stay armed. Raises HilError if the state does not allow it."""
        self._operate(Trigger.STOP)

    def disarm(self) -> None:
        """Forbid motion. Raises HilError if the state does not allow it."""
        self._operate(Trigger.DISARM)

    def reset(self) -> None:
        """Leave the state fault. Raises HilError if the state does not allow it."""
        self._operate(Trigger.RESET)

    def inject(self, frame: Frame) -> None:
        """Put a frame of another node on the bus now. The gateway and the boards receive it.

        On a modelled bus it arrives later, as the rig is stepped.
        """
        self._lockstep.deliver(self._side, frame)

    def inject_fault(self, fault: AnyFault | str) -> None:
        """Let a fault begin, such as ``lose:sample,5@0`` or ``hang:adc@vertical>0.05``.

        Its time counts from now. Raises DocumentError.
        """
        self._lockstep.deliver_from_boards(self._side, self._faulty.inject(fault, self.now_ns))

    def save_recording(self, path: str | os.PathLike[str]) -> Recording:
        """Write everything so far as a recording, which ``hil replay`` verifies, and open it.

        Raises RecordingExistsError if ``path`` exists.
        """
        from hil.recording.reader import Recording
        from hil.recording.recorder import FAULTS_BEGUN

        gateway = self.gateway
        ending = {
            "reason": "fault" if gateway.state is LifeCycleState.FAULT else "completed",
            "fault": gateway.fault_reason or "",
            "rejected frames": str(gateway.rejected_frames),
            "lost samples": str(gateway.lost_samples),
            "error frames": str(gateway.error_frames),
        }
        if self.bus is not None:
            ending |= self.bus.figures(self.now_ns)
        begun = faults_by_instant(self._faulty.begun)
        metadata = {"ending": ending} | ({FAULTS_BEGUN: begun} if begun else {})
        self._side.journal.save(Path(path), self._setup, metadata)
        return Recording(path)

    def operate(self, request: Request) -> Reply:
        """Give the gateway an operator's request, such as a change of a setpoint, and return its reply."""
        output = self._side.operate(request, self.now_ns)
        assert output.reply is not None
        return output.reply

    def _note_fault(self, text: str) -> None:
        """Log that a simulated fault begins."""
        self._side.note(fault_entry(text), self.now_ns)

    def _note_event(self, event: AnyEvent, at_ns: int) -> None:
        """Log that a planned event of the simulated arm has begun at ``at_ns``."""
        from firmware_sim.arm.event_text import event_text

        self._side.note(event_entry(event_text(event)), at_ns)

    def _operate(self, trigger: Trigger) -> None:
        reply = self.operate(trigger)
        if not reply.accepted:
            raise HilError(reply.text)


class _Side:
    """The gateway's end of the bus: sends what the core returns, and keeps everything else."""

    def __init__(self, gateway: Gateway, lockstep: Lockstep, enter: Callable[[str, int], None]) -> None:
        """``enter`` is told each state of the gateway, and the time in nanoseconds."""
        self.gateway = gateway
        self._lockstep = lockstep
        self._states = StateReports(gateway, lambda state: enter(state.name.lower(), lockstep.clock_ns()))
        self.log: list[LogEntry] = []
        self.cycles: list[Cycle] = []
        self.sent: list[Frame] = []
        self.journal = Journal()

    def receive(self, frame: Frame, now_ns: int, stamp_ns: int) -> None:
        self.journal.frame_received(frame, now_ns, stamp_ns)
        self._take(self.gateway.receive(frame, now_ns), now_ns)

    def on_deadline(self, now_ns: int) -> None:
        self.journal.deadline_called(self.gateway.next_deadline_ns, now_ns)
        self._take(self.gateway.on_deadline(now_ns), now_ns)

    def operate(self, request: Request, now_ns: int) -> Output:
        self.journal.operated(request, now_ns)
        output = self.gateway.operate(request, now_ns)
        self._take(output, now_ns)
        return output

    def note(self, entry: LogEntry, now_ns: int) -> None:
        self.log.append(entry)
        self.journal.noted(entry, now_ns)

    def _take(self, output: Output, now_ns: int) -> None:
        refused: list[int] = []
        for place, frame in enumerate(output.frames):
            if self._lockstep.send(frame):
                self.sent.append(frame)
                continue
            refused.append(place)
            if frame.id == RPDO1_DAC:
                self.gateway.command_refused(frame)
        self.log.extend(output.log)
        self._states.update()
        if output.cycle is not None:
            self.cycles.append(output.cycle)
        self.journal.answered(output, now_ns, tuple(refused))


def run_experiment(
    record: str | os.PathLike[str],
    *,
    duration_s: float = 10.0,
    rig: str | os.PathLike[str] | None = None,
    controllers: Mapping[str, str] | None = None,
    setpoints: Mapping[str, str] | None = None,
    events: Iterable[str] = (),
    plants: Mapping[str, str] | None = None,
    seed: int = 0,
) -> Recording:
    """Run the controllers against the simulated arm in simulated time, and return the recording.

    ``record`` is the file to write; it must not exist. ``events`` are texts such as ``payload:3@4``, as
    ``hil run --event`` takes them. ``plants`` puts models from plant files in place of axes of the arm. The
    run ends after ``duration_s`` seconds of control, or with a fault: see ``metadata["ending"]``.

    Raises HilError for wrong files and texts, and RecordingExistsError.

    >>> run = run_experiment("experiment.mcap", duration_s=3.0, setpoints={"vertical": "step:0.1@1"})
    >>> run.metadata["ending"]["reason"]
    'completed'
    """
    from dataclasses import replace

    from firmware_sim.simulated_plant import plant_texts
    from hil.cli.launch import run_lockstep
    from hil.cli.run import MAX_DURATION_S, parser
    from hil.recording.reader import Recording
    from hil.shells.run_plan import RunPlan

    if not 0.0 < duration_s <= MAX_DURATION_S:
        raise HilError(f"duration_s is {duration_s:g} s, but must be over 0 and at most {MAX_DURATION_S:g} s")
    if seed < 0:
        raise HilError(f"seed is {seed}, but must be 0 or more")
    arguments = ["--lockstep", "--seed", str(seed)]
    for option, given in (("--plant", plants or {}),):
        arguments += [part for name, value in given.items() for part in (option, f"{name}={value}")]
    arguments += [part for text in events for part in ("--event", text)]
    options = parser().parse_args(arguments)
    setup = load_setup(None if rig is None else Path(rig), controllers or {}, setpoints or {})
    setup = replace(setup, texts={**setup.texts, **plant_texts(setup.rig, options)})
    plan = RunPlan(duration_s, setup.rig.loop.period_s)
    report = run_lockstep(setup, plan, Path(record), duration_s, options)
    return Recording(report.path)
