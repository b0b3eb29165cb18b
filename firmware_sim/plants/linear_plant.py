"""The paper's identified model, eq. (15), for each axis, exact while the valves hold their voltages.

G0(s) = 0.47947 (s + 90.76) / ((s + 0.4231) (s^2 + 16.97 s + 167.9)), in m (rad for a rotation) per volt of
offset from the valve's centre. It is kept as the sum of its modes, r/(s - p), each of which has a closed
form under a zero-order hold of any length: x(t) = e^(pt) x(0) + (e^(pt) - 1)/p u. No stops: the position
may leave the potentiometer's range, the voltage may not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from hil.core.rig import Rig

GAIN: Final = 0.47947
ZERO: Final = 90.76
SLOW_POLE: Final = 0.4231
DAMPING_TERM: Final = 16.97
STIFFNESS_TERM: Final = 167.9

_SLOW = -SLOW_POLE
_FAST = complex(-DAMPING_TERM / 2, math.sqrt(STIFFNESS_TERM - DAMPING_TERM**2 / 4))
_SLOW_RESIDUE = GAIN * (_SLOW + ZERO) / abs(_SLOW - _FAST) ** 2
_FAST_RESIDUE = GAIN * (_FAST + ZERO) / ((_FAST - _SLOW) * complex(0.0, 2 * _FAST.imag))
_FAST_REAL, _FAST_IMAGINARY = 2 * _FAST_RESIDUE.real, 2 * _FAST_RESIDUE.imag


class _Hold(NamedTuple):
    """What a hold of one length does to the modes: x = decay x + drive u."""

    slow_decay: float
    slow_drive: float
    fast_decay: complex
    fast_drive: complex


def _hold(duration_s: float) -> _Hold:
    slow = math.expm1(_SLOW * duration_s)
    fast = _expm1(_FAST * duration_s)
    return _Hold(1.0 + slow, slow / _SLOW, 1.0 + fast, fast / _FAST)


def _expm1(z: complex) -> complex:
    """e^z - 1 without cancellation at a small z."""
    growth = math.expm1(z.real)
    half_turn = math.sin(z.imag / 2)
    return complex(growth * math.cos(z.imag) - 2 * half_turn * half_turn, (1.0 + growth) * math.sin(z.imag))


class _Modes:
    """One axis from rest at ``position`` 0: volts of offset in, position in the axis' unit out."""

    __slots__ = ("_fast", "_slow", "position")

    def __init__(self) -> None:
        self._slow = 0.0
        self._fast = 0j
        self.position = 0.0

    def advance(self, hold: _Hold, offset_v: float) -> None:
        """Hold ``offset_v`` volts from the valve's centre for the hold's length."""
        slow_decay, slow_drive, fast_decay, fast_drive = hold
        self._slow = slow = slow_decay * self._slow + slow_drive * offset_v
        self._fast = fast = fast_decay * self._fast + fast_drive * offset_v
        self.position = _SLOW_RESIDUE * slow + _FAST_REAL * fast.real - _FAST_IMAGINARY * fast.imag


class LinearPlant:
    """Eq. (15) for every axis of ``rig``, uncoupled, from rest at position 0."""

    def __init__(self, rig: Rig) -> None:
        self._axes = {name: _Modes() for name in rig.axes}
        self._valves = [
            (plant, axis.valve.channel - 1, axis.valve.centre_v)
            for plant, axis in zip(self._axes.values(), rig.axes.values(), strict=True)
        ]
        self._potentiometers = [
            (plant, axis.potentiometer.channel - 1, axis.potentiometer.volts)
            for plant, axis in zip(self._axes.values(), rig.axes.values(), strict=True)
        ]
        self._period_ns = rig.loop.period_ns
        self._period_hold = _hold(self._period_ns * 1e-9)

    def position(self, axis: str) -> float:
        """Where the axis is, in its unit; not clipped to the potentiometer's range."""
        return self._axes[axis].position

    def advance(self, duration_ns: int, valve_v: Sequence[float]) -> None:
        """Hold the valve voltages (V, by channel) for ``duration_ns``."""
        hold = self._period_hold if duration_ns == self._period_ns else _hold(duration_ns * 1e-9)
        for plant, channel, centre_v in self._valves:
            plant.advance(hold, valve_v[channel] - centre_v)

    def potentiometer_v(self) -> Sequence[float]:
        """Potentiometer voltages (V, by channel), 0 to 10 V."""
        volts = [0.0, 0.0, 0.0]
        for plant, channel, volts_at in self._potentiometers:
            volts[channel] = min(max(volts_at(plant.position), 0.0), 10.0)
        return volts
