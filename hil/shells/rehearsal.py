"""Run one period on a second core shortly before each deadline, so that the real one finds warm caches.

Between two periods, other programs fill the processor's caches. The first run of a period's code then takes
several times as long as the second one. A rehearsal is this first run: it controls all axes of a rig at rest,
on a core of its own, whose frames are sent to nobody. It shares the code with the real core, and no state.
"""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import msgspec

from hil.core.board_watch import NmtState
from hil.core.envelope_settings import Check, EnvelopeSettings
from hil.core.frames import Frame
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import Cycle, LogEntry
from hil.core.requests import SetpointRequest
from hil.core.rig import CHANNELS, VOLTS_PER_COUNT, Rig
from hil.core.setpoints import HOLD, parse_setpoint
from hil.core.wire import codec
from hil.core.wire.frame_crc import frame_crc
from hil.host.realtime_rights import Rights
from hil.recording.no_recorder import NoRecorder
from hil.shells.realtime import Polling
from hil.shells.run_plan import OperatorPlan
from hil.shells.run_setup import RunSetup
from hil.shells.session import Session

BRING_UP_PERIODS = 10
"""Number of periods in which the second core must reach state running."""
MAX_REHEARSAL_NS = 1_000_000
"""Longest time that the loop gives to a rehearsal before a deadline."""
MAX_REHEARSAL_SHARE = 8
"""In a short period, it gives at most one such part of the period."""
ANSWER_NS = 100_000
"""Time from SYNC to the sample in the simulated time of the second core."""
_HEARTBEATS = (
    Frame(codec.HEARTBEAT_ADC, codec.encode_heartbeat_adc(NmtState.OPERATIONAL)),
    Frame(codec.HEARTBEAT_DAC, codec.encode_heartbeat_dac(NmtState.OPERATIONAL)),
)


class Rehearsal:
    """A second core for ``setup``, in state running. Each call runs one of its periods."""

    def __init__(self, setup: RunSetup) -> None:
        rig = _without_checks(setup.rig)
        hold = parse_setpoint(HOLD)
        still = replace(setup, rig=rig, setpoints=dict.fromkeys(rig.axes, hold), experiment=None)
        self._period_ns = rig.loop.period_ns
        self._now_ns = self._period_ns
        self._gateway = still.gateway(self._now_ns)
        self._session = Session(
            self._gateway, OperatorPlan(), _discard, lambda: self._now_ns, NoRecorder(), _NoObserver()
        )
        self._crc = frame_crc(codec.TPDO1_ADC, rig.bus.wire_version, protected=rig.adc.protected)
        timeout_s = min(rig.adc.heartbeat_timeout_s, rig.dac.heartbeat_timeout_s)
        self._heartbeat_periods = max(int(0.5 * timeout_s / rig.loop.period_s), 1)
        self._number = 0
        """Number of periods that have begun."""
        self._sample_v = _centre_v(rig)
        self.failure: Exception | None = None
        """Error that ended the rehearsals."""
        self._bring_up(rig)

    @property
    def is_running(self) -> bool:
        """True if the second core controls its axes, as the real one does."""
        return self.failure is None and self._gateway.state is LifeCycleState.RUNNING

    def __call__(self) -> None:
        """Run one period: SYNC, the sample that answers it, and the command that answers the sample.

        After an error, the call does nothing: a rehearsal must not end a run.
        """
        if self.failure is None:
            try:
                self._run_period()
            except Exception as error:
                self.failure = error

    def _run_period(self) -> None:
        session = self._session
        if self._number % self._heartbeat_periods == 0:
            self._hear_boards()
        session.on_deadline(self._now_ns)
        self._now_ns += ANSWER_NS
        session.receive(self._sample(), self._now_ns, self._now_ns)
        self._number += 1
        self._now_ns += self._period_ns - ANSWER_NS

    def _bring_up(self, rig: Rig) -> None:
        """Run until all axes are controlled, then let each hold its position as a setpoint of an operator."""
        for _ in range(BRING_UP_PERIODS):
            self()
            if self._gateway.state is LifeCycleState.READY:
                self._session.operate(Trigger.ARM)
                self._session.operate(Trigger.START)
        for name, axis in rig.axes.items():
            position = axis.potentiometer.position(self._sample_v[axis.potentiometer.channel - 1])
            self._session.operate(SetpointRequest(name, f"step:{position!r}@0"))

    def _hear_boards(self) -> None:
        for frame in _HEARTBEATS:
            self._session.receive(frame, self._now_ns, self._now_ns)

    def _sample(self) -> Frame:
        first_v, second_v, third_v = self._sample_v
        data = codec.encode_tpdo1_adc(first_v, second_v, third_v, self._number & 0xFF, 0)
        return Frame(codec.TPDO1_ADC, data[:6] if self._crc is None else self._crc.append(data[:7]))


def polling_of(rights: Rights, setup: RunSetup) -> Polling:
    """Return the polling that was granted, with a rehearsal if the loop polls before its deadlines."""
    rehearse = Rehearsal(setup) if rights.poll_ns > 0 else None
    longest_ns = min(MAX_REHEARSAL_NS, setup.rig.loop.period_ns // MAX_REHEARSAL_SHARE)
    return Polling(rights.poll_ns, rights.sample_poll_ns, rehearse, longest_ns)


class _NoObserver:
    def log(self, entry: LogEntry) -> None:
        """Do nothing."""

    def cycle(self, cycle: Cycle, gateway: Gateway) -> None:
        """Do nothing."""


def _discard(_frame: Frame) -> bool:
    return True


def _without_checks(rig: Rig) -> Rig:
    """Return the rig without protection by hardware, whose frames no rehearsal has, and without envelopes.

    The axes stand still, and nothing may end the rehearsal because of that.
    """
    axes = {}
    for name, axis in rig.axes.items():
        envelope = EnvelopeSettings(disabled=list(get_args(Check)))
        axes[name] = msgspec.structs.replace(axis, envelope=envelope)
    dac = msgspec.structs.replace(rig.dac, read_back=False)
    return msgspec.structs.replace(rig, emergency_stop=None, enable=None, dac=dac, axes=axes)


def _centre_v(rig: Rig) -> list[float]:
    """Return the potentiometer voltages (V, by channel) at the middle of each axis' range.

    They are rounded as a frame rounds them.
    """
    volts = [5.0] * CHANNELS
    for axis in rig.axes.values():
        middle_v = axis.potentiometer.volts(0.5 * (axis.min_y + axis.max_y))
        volts[axis.potentiometer.channel - 1] = round(middle_v / VOLTS_PER_COUNT) * VOLTS_PER_COUNT
    return volts
