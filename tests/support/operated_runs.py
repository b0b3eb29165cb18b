"""Lockstep runs with an operator, recorded with their documents so that they can be replayed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from firmware_sim.plants.linear_plant import LinearPlant
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.gateway import Gateway
from hil.core.output import Cycle, LogEntry
from hil.core.requests import Reply, Request
from hil.recording.handover import RunHeader
from hil.recording.recorder import Recorder
from hil.shells.lockstep import Lockstep
from hil.shells.recordings import Recordings, RotationLimits
from hil.shells.run_plan import OperatorPlan
from hil.shells.run_setup import RunSetup, load_setup
from hil.shells.session import Session
from support.recorded_runs import in_memory


class Shown:
    """An observer that keeps what it is shown."""

    def __init__(self) -> None:
        self.entries: list[LogEntry] = []
        self.cycles: list[Cycle] = []

    def log(self, entry: LogEntry) -> None:
        self.entries.append(entry)

    def cycle(self, cycle: Cycle, gateway: Gateway) -> None:
        self.cycles.append(cycle)


class OperatedRun:
    """A recorded lockstep run that a test operates period by period. The boards are simulated and linear."""

    def __init__(
        self,
        path: Path,
        setpoints: Mapping[str, str] | None = None,
        limits: RotationLimits | None = None,
        rig_path: Path | None = None,
    ) -> None:
        self.setup = load_setup(rig_path, {}, setpoints or {})
        self.shown = Shown()
        self.plan = OperatorPlan()
        rig = self.setup.rig
        self._lockstep = Lockstep(SimulatedRig(rig, LinearPlant(rig)), 0)
        with in_memory(path):
            self.recorder = Recorder(path, run_header(self.setup), lossless=True)
        gateway = self.setup.gateway(rig.loop.period_ns)
        self.session = Session(
            gateway,
            self.plan,
            self._lockstep.send,
            self._lockstep.clock_ns,
            self.recorder,
            self.shown,
            recordings=Recordings(self.recorder, limits or RotationLimits()),
        )
        self._lockstep.begin(self.session)

    @property
    def gateway(self) -> Gateway:
        return self.session.gateway

    def periods(self, number: int) -> None:
        for _ in range(number):
            while not self._lockstep.step(self.session):
                pass

    def ask(self, request: Request, asked_by: str = "uid 1000, pid 4711") -> Reply:
        return self.session.operate(request, asked_by)

    def close(self) -> None:
        self.recorder.close({"ending": {"reason": str(self.plan.ending)}})


def run_header(setup: RunSetup) -> RunHeader:
    """The header of a run's recording, with everything that a replay needs."""
    return RunHeader(
        epoch_offset_ns=10**18,
        bus="lockstep",
        stamp_origin="simulated",
        axes=tuple((name, axis.unit) for name, axis in setup.rig.axes.items()),
        attachments={name: ("text/plain", text.encode()) for name, text in setup.texts.items()},
        metadata={
            "documents": setup.digests(),
            "run": {"configuration sha256": setup.fingerprint()},
            "setpoints": {name: setpoint.text for name, setpoint in setup.setpoints.items()},
        },
    )
