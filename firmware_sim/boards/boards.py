"""The two boards as state machines: frames and the time in, frames and pin voltages out.

The potentiometer board samples all channels at SYNC and answers with TPDO1. The valve board takes RPDO1 and
centres its valves whenever it is not operational, when good commands stop and when the gateway's heartbeat
stops. Whatever is not provably a good command changes no valve.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, TypeAlias

from firmware_sim.boards.canopen_slave import NEVER, CanopenSlave, ErrorCode, Frames, State
from firmware_sim.boards.codec import (
    ADC_NODE,
    DAC_NODE,
    GATEWAY_NODE,
    HEARTBEAT_ID,
    RPDO1_ID,
    TPDO1_ID,
    Converter,
    RejectedPdoError,
    decode_values,
    encode_values,
)
from firmware_sim.boards.faults import AdcFaults, DacFaults
from hil.core.frames import Frame
from hil.core.rig import Rig

Volts: TypeAlias = tuple[float, float, float]

_REJECTED_CRC: Final = 1
_REJECTED_COUNTER: Final = 2
_REJECTED_RANGE: Final = 3
"""Vendor codes of EMCY 0x8200: why a command was rejected."""
_FARTHEST_STEP: Final = 127
"""Of the counter of commands: beyond it, it went back, and the command is an old one."""


class AdcBoard(CanopenSlave[AdcFaults]):
    """Potentiometer board, node 0x10. ``sample`` gives the pins' voltages now."""

    __slots__ = ("_converter", "_counter", "_protected", "_sample")

    def __init__(
        self,
        rig: Rig,
        sample: Callable[[], Sequence[float]],
        *,
        resolution_bits: int,
        heartbeat_ns: int,
    ) -> None:
        super().__init__(ADC_NODE, heartbeat_ns)
        self._protected = rig.adc.protected
        self._sample = sample
        self._converter = Converter(resolution_bits)
        self._counter = 0

    def _on_reset(self, now_ns: int) -> None:
        self._counter = 0

    def _on_sync(self, now_ns: int) -> Frames:
        volts = self._sample()
        if self.faults is not None:
            return self._on_faulty_sync(volts, self.faults)
        return (self._sample_frame(volts),)

    def _sample_frame(self, volts: Sequence[float]) -> Frame:
        first, second, third = volts
        counts = self._converter.counts
        counter = self._counter
        self._counter = (counter + 1) & 0xFF
        values = (counts(first), counts(second), counts(third))
        return Frame(TPDO1_ID + ADC_NODE, encode_values(values, counter if self._protected else None))

    def _on_faulty_sync(self, volts: Sequence[float], faults: AdcFaults) -> Frames:
        if faults.counters_to_repeat > 0:
            faults.counters_to_repeat -= 1
            self._counter = (self._counter - 1) & 0xFF
        frame = self._sample_frame([faults.frozen_v.get(channel, v) for channel, v in enumerate(volts, 1)])
        if faults.samples_to_lose > 0:
            faults.samples_to_lose -= 1
            return ()
        if faults.crcs_to_corrupt > 0 and self._protected:
            faults.crcs_to_corrupt -= 1
            frame = Frame(frame.id, frame.data[:7] + bytes((frame.data[7] ^ 0x01,)))
        return (frame,)


class DacBoard(CanopenSlave[DacFaults]):
    """Valve board, node 0x20. ``drive`` is told the pins' voltages at every change."""

    __slots__ = (
        "_applies_at_once",
        "_centre_v",
        "_command_due_ns",
        "_converter",
        "_counter",
        "_drive",
        "_gateway_due_ns",
        "_gateway_timeout_ns",
        "_pending_v",
        "_protected",
        "_set_v",
        "_watchdog_ns",
        "valve_v",
    )

    def __init__(
        self, rig: Rig, drive: Callable[[Volts, int], None], *, resolution_bits: int, heartbeat_ns: int
    ) -> None:
        super().__init__(DAC_NODE, heartbeat_ns)
        period_ns = rig.loop.period_ns
        self._protected = rig.dac.protected
        self._applies_at_once = rig.dac.apply == "at once"
        self._watchdog_ns = rig.dac.watchdog_periods * period_ns
        self._gateway_timeout_ns = rig.dac.heartbeat_timeout_periods * period_ns
        self._drive = drive
        self._converter = Converter(resolution_bits)
        centre_v = [5.0, 5.0, 5.0]
        for axis in rig.axes.values():
            centre_v[axis.valve.channel - 1] = axis.valve.centre_v
        self._centre_v: Volts = (centre_v[0], centre_v[1], centre_v[2])
        self._set_v = self._centre_v
        self.valve_v = self._centre_v
        self._pending_v: Volts | None = None
        self._counter: int | None = None
        self._command_due_ns = NEVER
        self._gateway_due_ns = NEVER

    def _on_reset(self, now_ns: int) -> None:
        self._gateway_due_ns = NEVER
        self._centre(now_ns)

    def _on_state(self, now_ns: int) -> None:
        if self.state is not State.OPERATIONAL:
            self._centre(now_ns)

    def _on_frame(self, frame: Frame, now_ns: int) -> Frames:
        if frame.id == RPDO1_ID + DAC_NODE:
            return self._on_command(frame.data, now_ns) if self.state is State.OPERATIONAL else ()
        if frame.id == HEARTBEAT_ID + GATEWAY_NODE and len(frame.data) == 1:
            self._gateway_due_ns = now_ns + self._gateway_timeout_ns
            self._schedule()
            return self._recover(ErrorCode.HEARTBEAT) if self._errors else ()
        return ()

    def _on_command(self, data: bytes, now_ns: int) -> Frames:
        try:
            (first, second, third), counter = decode_values(data, self._protected)
        except RejectedPdoError as error:
            if error.reason == RejectedPdoError.LENGTH:
                return self._report(ErrorCode.PDO_LENGTH, vendor_value=len(data))
            return self._report(ErrorCode.PROTOCOL, _REJECTED_CRC, data[7])
        if counter is not None and self._counter is not None:
            step = (counter - self._counter) & 0xFF
            if step == 0 or step > _FARTHEST_STEP:
                return self._report(ErrorCode.PROTOCOL, _REJECTED_COUNTER, counter)
        if first < 0 or second < 0 or third < 0:
            return self._report(ErrorCode.PROTOCOL, _REJECTED_RANGE)
        self._counter = counter
        frames: Frames = ()
        if self._errors:
            frames = self._recover(ErrorCode.PROTOCOL, ErrorCode.PDO_LENGTH, ErrorCode.RPDO_TIMEOUT)
        if self._pending_v is None:
            # A command that replaces one never applied does not feed the watchdog: SYNC has stopped.
            self._command_due_ns = now_ns + self._watchdog_ns
            self._schedule()
        if ErrorCode.HEARTBEAT in self._errors:
            return frames
        convert = self._converter.volts
        volts = (convert(first), convert(second), convert(third))
        if self._applies_at_once:
            self._set(volts, now_ns)
        else:
            self._pending_v = volts
        return frames

    def _on_sync(self, now_ns: int) -> Frames:
        pending_v, self._pending_v = self._pending_v, None
        self._set(self._set_v if pending_v is None else pending_v, now_ns)
        return ()

    def _on_time(self, now_ns: int) -> Frames:
        frames: Frames = ()
        if now_ns >= self._command_due_ns:
            self._centre(now_ns)
            frames += self._report(ErrorCode.RPDO_TIMEOUT)
        if now_ns >= self._gateway_due_ns:
            self._gateway_due_ns = NEVER
            self._centre(now_ns)
            frames += self._report(ErrorCode.HEARTBEAT, vendor_value=GATEWAY_NODE)
        return frames

    def _schedule(self) -> None:
        self.next_deadline_ns = min(self._heartbeat_due_ns, self._command_due_ns, self._gateway_due_ns)

    def _centre(self, now_ns: int) -> None:
        """Centre the valves and wait for the first command, whatever its counter."""
        self._pending_v = None
        self._counter = None
        self._command_due_ns = NEVER
        self._set(self._centre_v, now_ns)

    def _set(self, volts: Volts, now_ns: int) -> None:
        self._set_v = volts
        if self.faults is not None and (frozen_v := self.faults.frozen_v):
            first, second, third = volts
            volts = (frozen_v.get(1, first), frozen_v.get(2, second), frozen_v.get(3, third))
        if volts != self.valve_v:
            self.valve_v = volts
            self._drive(volts, now_ns)
