"""The gateway core without boards, in simulated time, for boards of one's own."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from firmware_sim.boards.codec import ADC_NODE, DAC_NODE, HEARTBEAT_ID, TPDO1_ID
from firmware_sim.faults.frame_faults import pdo
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import Cycle, LogEntry, Output
from hil.core.wire import codec
from hil.shells.run_setup import load_setup

_COUNTS_PER_V: Final = (1 << 15) / 10.0
_OPERATIONAL: Final = b"\x05"
_SAMPLE_DELAY_NS: Final = 1_000_000
"""Time from SYNC to the sample that :meth:`GatewayAlone.period` sends."""


class GatewayAlone:
    """The gateway core. The test is the boards: every frame that arrives is its own.

    >>> gateway = GatewayAlone()
    >>> gateway.bring_up()
    >>> gateway.state.name
    'READY'
    >>> gateway.period((5.0, 5.0, 5.0))[0].id == 0x080
    True
    """

    def __init__(
        self,
        rig: str | os.PathLike[str] | None = None,
        *,
        controllers: Mapping[str, str] | None = None,
        setpoints: Mapping[str, str] | None = None,
    ) -> None:
        """Build the gateway of a rig file, or of the shipped one. Raises DocumentError or SetpointError."""
        setup = load_setup(None if rig is None else Path(rig), controllers or {}, setpoints or {})
        self.rig = setup.rig
        self.core = setup.gateway(setup.rig.loop.period_ns)
        """The gateway core."""
        self.now_ns = 0
        """Simulated time in nanoseconds."""
        self.sent: list[Frame] = []
        """All frames that the gateway has sent."""
        self.log: list[LogEntry] = []
        """All log entries of the gateway."""
        self.cycles: list[Cycle] = []
        """All periods with the signals of every axis."""
        self._counter = 0

    @property
    def state(self) -> LifeCycleState:
        """Present state of the gateway's life cycle."""
        return self.core.state

    @property
    def valve_v(self) -> tuple[float, float, float]:
        """Voltages of the last valve command that was sent. Raises IndexError before the first one."""
        last = [frame for frame in self.sent if frame.id == codec.RPDO1_DAC][-1]
        first, second, third = codec.decode_rpdo1_dac(last.data)[:3]
        return first, second, third

    def begin_period(self, late_s: float = 0.0) -> list[Frame]:
        """Go to the next deadline, or ``late_s`` beyond it, and serve it. Returns what is sent."""
        self.now_ns = self.core.next_deadline_ns + round(late_s * 1e9)
        return self._take(self.core.on_deadline(self.now_ns))

    def receive(self, frame: Frame, after_s: float = 0.0) -> list[Frame]:
        """Let a frame arrive ``after_s`` from now. Returns the frames that the gateway sends in answer."""
        self.now_ns += round(after_s * 1e9)
        return self._take(self.core.receive(frame, self.now_ns))

    def sample_frame(self, volts: Sequence[float]) -> Frame:
        """Return a correct sample of these voltages (V, by channel) with the next counter."""
        first, second, third = (round(value * _COUNTS_PER_V) for value in volts)
        counter = self._counter if self.rig.adc.protected else None
        self._counter = (self._counter + 1) & 0xFF
        return pdo(TPDO1_ID + ADC_NODE, (first, second, third), counter, self.rig.bus.wire_version)

    def heartbeats(self) -> list[Frame]:
        """Let both boards' heartbeats arrive, in state operational."""
        frames = [Frame(HEARTBEAT_ID + node, _OPERATIONAL) for node in (ADC_NODE, DAC_NODE)]
        return [answer for frame in frames for answer in self.receive(frame)]

    def period(self, volts: Sequence[float]) -> list[Frame]:
        """Serve a deadline, and answer its SYNC with heartbeats and a good sample. Returns what is sent."""
        frames = self.begin_period()
        has_sync = any(frame.id == codec.SYNC for frame in frames)
        frames += self.heartbeats()
        if has_sync:
            frames += self.receive(self.sample_frame(volts), _SAMPLE_DELAY_NS * 1e-9)
        return frames

    def bring_up(self, volts: Sequence[float] = (5.0, 5.0, 5.0), periods: int = 20) -> None:
        """Run good periods until the state is no longer offline, at most ``periods`` of them."""
        for _ in range(periods):
            if self.state is not LifeCycleState.OFFLINE:
                return
            self.period(volts)

    def operate(self, trigger: Trigger | str) -> list[Frame]:
        """Give an operator's trigger: arm, start, stop, disarm or reset."""
        return self._take(self.core.operate(Trigger(trigger), self.now_ns))

    def _take(self, output: Output) -> list[Frame]:
        self.sent += output.frames
        self.log += output.log
        if output.cycle is not None:
            self.cycles.append(output.cycle)
        return list(output.frames)
