"""Periods of the loop in a bus log: SYNC begins one, the sample and the command that follow belong to it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from hil.conversion.dbc import DbcMessage, DbcSignal
from hil.core.errors import DocumentError
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState
from hil.core.output import AxisSignals, Cycle
from hil.core.rig import VOLTS_PER_COUNT, Rig

SYNC, SAMPLE, COMMAND = "SYNC", "TPDO1_ADC", "RPDO1_DAC"
"""Names of the messages that make a period, as in ``arm.dbc``."""


class LogDecoder:
    """Decodes samples and commands of a bus log through a DBC file and a rig file."""

    def __init__(self, rig: Rig, messages: Mapping[str, DbcMessage], source: str) -> None:
        """``source`` is the DBC file's name for errors. Raises DocumentError when a message is missing."""
        for name in (SAMPLE, COMMAND):
            if name not in messages:
                raise DocumentError(
                    f"{source}: has no message {name}, which carries the signals of the axes; name it so in "
                    "the DBC file"
                )
        self._rig = rig
        self._sync = messages.get(SYNC)
        self._sample, self._command = messages[SAMPLE], messages[COMMAND]
        gateway = self._command.sender
        self._sent = {
            (message.identifier, message.is_extended)
            for message in messages.values()
            if message.sender == gateway
        }
        axes = rig.axes.values()
        self._positions = [
            _signal(self._sample, f"Potentiometer{axis.potentiometer.channel}", source) for axis in axes
        ]
        self._valves = [_signal(self._command, f"Valve{axis.valve.channel}", source) for axis in axes]
        self._centres_v = [axis.valve.centre_v for axis in axes]

    def is_sent(self, frame: Frame) -> bool:
        """Return True for a frame that the gateway sends, the node that sends RPDO1_DAC in the DBC file."""
        return not frame.is_error and (frame.id, frame.is_extended) in self._sent

    def is_sync(self, frame: Frame) -> bool:
        """Return True for SYNC."""
        return self._sync is not None and _is(frame, self._sync)

    def is_sample(self, frame: Frame) -> bool:
        """Return True for a sample of the potentiometers."""
        return _is(frame, self._sample)

    def sample(self, frame: Frame) -> list[float] | None:
        """Return the potentiometer voltages of the axes, or None if the frame is no whole sample."""
        return _decoded(self._positions, frame.data) if _is(frame, self._sample) else None

    def command(self, frame: Frame) -> list[float] | None:
        """Return the commanded valve voltages of the axes, or None if the frame is no whole command."""
        return _decoded(self._valves, frame.data) if _is(frame, self._command) else None

    def is_centred(self, command_v: Sequence[float]) -> bool:
        """Return True if every valve is commanded to its centre, within one count of the converter."""
        return all(
            abs(volts - centre) <= VOLTS_PER_COUNT
            for volts, centre in zip(command_v, self._centres_v, strict=True)
        )

    def signals(self, volts: Sequence[float] | None, command_v: Sequence[float]) -> tuple[AxisSignals, ...]:
        """Return the signals of every axis. A bus log has no setpoint, so setpoint and error are NaN."""
        measured_v = [math.nan] * len(self._rig.axes) if volts is None else volts
        return tuple(
            AxisSignals(
                math.nan,
                axis.potentiometer.position(pot_v),
                math.nan,
                valve_v - axis.valve.centre_v,
                valve_v,
                pot_v,
            )
            for axis, pot_v, valve_v in zip(self._rig.axes.values(), measured_v, command_v, strict=True)
        )

    @property
    def centres_v(self) -> list[float]:
        """Centre voltages of the axes' valves."""
        return list(self._centres_v)


class Period:
    """A period that is being read; ``cycle`` gives it as the recorder takes it."""

    def __init__(self, number: int, begin_ns: int) -> None:
        self.number = number
        self.begin_ns = begin_ns
        self.receive_ns = 0
        """Instant of the sample; 0 before it has come."""
        self.end_ns = begin_ns
        """Instant of the last frame of the period."""

    def cycle(self, state: LifeCycleState, signals: tuple[AxisSignals, ...]) -> Cycle:
        """Return the period. Its deadline is the instant of SYNC, since a log has no other."""
        return Cycle(
            self.number, self.begin_ns, self.begin_ns, self.receive_ns, state, self.receive_ns > 0, signals
        )


def _is(frame: Frame, message: DbcMessage) -> bool:
    return (
        frame.id == message.identifier
        and frame.is_extended == message.is_extended
        and not (frame.is_remote or frame.is_error)
    )


def _signal(message: DbcMessage, name: str, source: str) -> DbcSignal:
    if name not in message.signals:
        raise DocumentError(
            f"{source}: message {message.name} has no signal {name}; name it so in the DBC file"
        )
    return message.signals[name]


def _decoded(signals: Sequence[DbcSignal], data: bytes) -> list[float] | None:
    """Return the values of all signals, or None if the data are too short for one of them."""
    values = [signal.decode(data) for signal in signals]
    known = [value for value in values if value is not None]
    return known if len(known) == len(values) else None
