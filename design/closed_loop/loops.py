"""A batch of closed loops and all that can be read off them; each reading is computed when first needed."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from design.closed_loop.responses import StepResponses, closed_loop, step_responses
from design.closed_loop.step_readings import StepReadings
from design.closed_loop.step_simulation import modes, simulate_steps
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array, Flags, Indices
from design.models.controller import Controller
from design.models.realisation import StateSpace
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction
from design.robustness import margins
from design.robustness.loop_shaping import shaped

_CONTINUOUS_SAMPLES, _MAX_SAMPLED_SAMPLES = 512, 4096
"""Samples of a response to be drawn: for a continuous loop, and at most for a sampled loop."""


class ClosedLoops:
    """B controllers (B, n + 1) on one plant (n + 1,), with negative feedback.

    All polynomials are in s or, with ``sampling``, in the bilinear plane. ``W`` is the weight W1 with which
    the margin ε is computed. ``desired`` is the open loop whose shape is specified: the shaped plant Gs while
    a weight is selected, and GK otherwise.
    """

    def __init__(
        self,
        G: TransferFunction,
        K: Controller,
        *,
        W: TransferFunction = margins.UNIT,
        sampling: Sampling | None = None,
        desired: TransferFunction | None = None,
    ) -> None:
        self.G, self.K, self.W = G, Controller(*(np.atleast_2d(p) for p in K)), W
        self.sampling = sampling
        self._desired = desired

    def subset(self, chosen: Indices) -> ClosedLoops:
        """Return the loops with the indices ``chosen``."""

        def of(p: Array) -> Array:
            return p if len(p) == 1 else p[chosen]

        def pair(H: TransferFunction) -> TransferFunction:
            return TransferFunction(*(of(np.atleast_2d(p)) for p in H))

        K, W = Controller(*(of(p) for p in self.K)), pair(self.W)
        desired = None if self._desired is None else pair(self._desired)
        return ClosedLoops(self.G, K, W=W, sampling=self.sampling, desired=desired)

    @cached_property
    def open(self) -> TransferFunction:
        """The open loop GK (B, n + 1)."""
        return shaped(self.G, self.K.feedback)

    @property
    def desired(self) -> TransferFunction:
        """The open loop whose shape is specified."""
        return self.open if self._desired is None else self._desired

    @property
    def desired_name(self) -> str:
        """Symbol of the open loop whose shape is specified: Gs or GK."""
        return "GK" if self._desired is None else "Gs"

    @cached_property
    def closed(self) -> Array:
        """Characteristic polynomials (B, n + 1) of the closed loops."""
        return np.atleast_2d(margins.characteristic(self.G, self.K.feedback))

    @cached_property
    def stable(self) -> Flags:
        """Internal stability (B,)."""
        return poly.hurwitz(self.closed)

    @cached_property
    def margin(self) -> Array:
        """Stability margin ε (B,) of eq. (13); 0 where unstable."""
        return margins.stability_margin(self.G, self.K.feedback, self.W)

    @cached_property
    def final_value(self) -> Array:
        """Final value (B,) of y after a unit step of the setpoint."""
        above = np.atleast_2d(self.G.num)[:, -1] * self.K.num_r[:, -1]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(above / self.closed[:, -1])

    @cached_property
    def error(self) -> Array:
        """Steady-state error |1 - y| (B,) after a unit step of the setpoint."""
        return np.abs(1.0 - self.final_value)

    def response(self, horizon_s: float) -> StepResponses:
        """Return the unit step responses up to a time, to be drawn; an unstable loop's response is 0."""
        if self.sampling is None:
            step_s, samples = horizon_s / (_CONTINUOUS_SAMPLES - 1), _CONTINUOUS_SAMPLES
        else:
            step_s = self.sampling.period_s
            samples = int(np.ceil(horizon_s / step_s)) + 1
        y, u = np.zeros((2, len(self.stable), samples))
        if self.stable.any():
            some = step_responses(self.G, self._stable_controllers, self.sampling, step_s, samples)
            y[self.stable], u[self.stable] = some.y, some.u
        every = -(-samples // _MAX_SAMPLED_SAMPLES)
        return StepResponses(step_s * np.arange(float(samples))[::every], y[:, ::every], u[:, ::every])

    @property
    def overshoot(self) -> Array:
        """Largest y over its final value, less 1 (B,); ∞ where unstable, or where the final value is 0."""
        return np.asarray(np.maximum(self._output.highest - 1.0, 0.0))

    @property
    def settling_s(self) -> Array:
        """Time (B,) after which y stays within 2 % of its final value; ∞ where unstable or the value is 0."""
        return self._output.settling_s

    @property
    def rise_s(self) -> Array:
        """Time (B,) from 10 % to 90 % of y's final value; ∞ where unstable or the value is 0."""
        return self._output.rise_s

    @property
    def itae(self) -> Array:
        """Integral of t |1 - y/y(∞)| dt (B,) in s²; ∞ where unstable or the final value y(∞) is 0."""
        return self._output.itae

    @cached_property
    def effort(self) -> Array:
        """Largest |u| (B,) in V after a setpoint step of one output unit; ∞ where unstable."""
        num = poly.multiply(np.atleast_2d(self.G.den), self.K.num_r)
        with np.errstate(all="ignore"):
            final = np.broadcast_to(num[:, -1] / self.closed[:, -1], self.stable.shape)
        direct = np.zeros(len(self.stable))
        if self.stable.any():
            direct[self.stable] = self._step.D[:, 1, 0]
        unit = np.maximum(np.abs(final), np.abs(direct))
        unit = np.where(unit > 0.0, unit, 1.0)
        readings = self._step_readings(1, num, final, unit)
        return np.asarray(unit * np.maximum(readings.highest, -readings.lowest))

    def true_frequency(self, omega: Array) -> Array:
        """Return frequencies of the loop's plane in true rad/s; ∞ (never reached) remains ∞."""
        if self.sampling is None:
            return omega
        return np.where(np.isinf(omega), np.inf, self.sampling.unwarp(omega))

    @cached_property
    def _output(self) -> StepReadings:
        """Readings of y after a unit step of the setpoint."""
        num = poly.multiply(np.atleast_2d(self.G.num), self.K.num_r)
        return self._step_readings(0, num, self.final_value, self.final_value)

    def _step_readings(self, output: int, num: Array, final: Array, unit: Array) -> StepReadings:
        """Return the readings of y (output 0) or u (output 1), relative to ``unit`` (B,).

        ``num`` is the numerator over :attr:`closed`. Readings are ∞ where the loop is unstable or the unit is
        0.
        """
        found = StepReadings(*np.full((5, len(self.stable)), np.inf))
        chosen = np.flatnonzero(self.stable & np.isfinite(unit) & (unit != 0.0))
        if len(chosen):
            among_stable = np.searchsorted(np.flatnonzero(self.stable), chosen)
            A, B, C, D = (part[among_stable] for part in self._step)
            scale = 1.0 / unit[chosen]
            C, D = (scale[:, None, None] * part[:, output : output + 1] for part in (C, D))
            num = num if len(num) == 1 and len(self.stable) > 1 else num[chosen]
            loop_modes = modes(num, self.closed[chosen], self.sampling, np.abs(unit[chosen]))
            readings = simulate_steps(
                StateSpace(A, B, C, D),
                final[chosen] * scale,
                loop_modes,
                self.sampling,
                extremes_only=output == 1,
            )
            for all_values, values in zip(found, readings, strict=True):
                all_values[chosen] = values
        return found

    @cached_property
    def _stable_controllers(self) -> Controller:
        stable = self.stable
        return Controller(*(p if len(p) == 1 and len(stable) > 1 else p[stable] for p in self.K))

    @cached_property
    def _step(self) -> StateSpace:
        """State space from r to [y, u] of the stable loops."""
        with np.errstate(all="ignore"):
            return closed_loop(self.G, self._stable_controllers)
