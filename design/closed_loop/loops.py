"""A batch of closed loops, and what can be read off them; each reading is made once, when first asked for."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from design.closed_loop.responses import StepResponses, closed_loop, step_responses
from design.closed_loop.step_course import follow, modes
from design.closed_loop.step_readings import StepCourse
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array, Flags, Indices
from design.models.controller import Controller
from design.models.plant import Sampling, TransferFunction
from design.models.realisation import StateSpace
from design.robustness import margins
from design.robustness.loop_shaping import shaped

_SAMPLES, _MOST_SAMPLES = 512, 4096
"""Of a response that is drawn: of a continuous one, and at most of a sampled one."""


class ClosedLoops:
    """Controllers (B, n + 1) on one plant, in s or in the bilinear plane of ``sampling``.

    ``desired`` is the open loop whose shape is specified: the shaped plant Gs while weights are selected,
    else GK itself.
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
        self.open = shaped(G, self.K.feedback)
        self.desired = self.open if desired is None else desired
        self.desired_name = "GK" if desired is None else "Gs"

    def some(self, chosen: Indices) -> ClosedLoops:
        """Those of the batch."""

        def of(p: Array) -> Array:
            return p if len(p) == 1 else p[chosen]

        def pair(H: TransferFunction) -> TransferFunction:
            return TransferFunction(*(of(np.atleast_2d(p)) for p in H))

        K, W = Controller(*(of(p) for p in self.K)), pair(self.W)
        desired = None if self.desired is self.open else pair(self.desired)
        return ClosedLoops(self.G, K, W=W, sampling=self.sampling, desired=desired)

    @cached_property
    def closed(self) -> Array:
        """Characteristic polynomials."""
        return np.atleast_2d(margins.characteristic(self.G, self.K.feedback))

    @cached_property
    def stable(self) -> Flags:
        """Internal stability (B,)."""
        return poly.hurwitz(self.closed)

    @cached_property
    def margin(self) -> Array:
        """ε (B,)."""
        return margins.stability_margin(self.G, self.K.feedback, self.W)

    @cached_property
    def final_value(self) -> Array:
        """y (B,) for t -> ∞ after a unit step of the setpoint."""
        above = np.atleast_2d(self.G.num)[:, -1] * self.K.num_r[:, -1]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(above / self.closed[:, -1])

    def response(self, horizon_s: float) -> StepResponses:
        """Unit step responses up to a time, to be drawn; those of unstable loops are 0."""
        if self.sampling is None:
            step_s, samples = horizon_s / (_SAMPLES - 1), _SAMPLES
        else:
            step_s = self.sampling.period_s
            samples = int(np.ceil(horizon_s / step_s)) + 1
        y, u = np.zeros((2, len(self.stable), samples))
        if self.stable.any():
            some = step_responses(self.G, self._stable_controllers, self.sampling, step_s, samples)
            y[self.stable], u[self.stable] = some.y, some.u
        every = -(-samples // _MOST_SAMPLES)
        return StepResponses(step_s * np.arange(float(samples))[::every], y[:, ::every], u[:, ::every])

    @property
    def overshoot(self) -> Array:
        """Largest y over its final value, less 1 (B,); ∞ where unstable, or y goes to 0."""
        return np.asarray(np.maximum(self._course.highest - 1.0, 0.0))

    @property
    def settling_s(self) -> Array:
        """Time (B,) after which y stays within 2 % of its final value; ∞ where unstable, or y goes to 0."""
        return self._course.settled_s

    @property
    def rise_s(self) -> Array:
        """Time (B,) from 10 % to 90 % of the final value; ∞ as for settling."""
        return self._course.rise_s

    @property
    def itae(self) -> Array:
        """∫ t |1 - y| dt (B,) in s², y relative to its final value; ∞ as for settling."""
        return self._course.itae

    @cached_property
    def effort(self) -> Array:
        """Largest |u| (B,) after a unit step of the setpoint, in output units of the controller."""
        num = poly.multiply(np.atleast_2d(self.G.den), self.K.num_r)
        with np.errstate(all="ignore"):
            final = np.broadcast_to(num[:, -1] / self.closed[:, -1], self.stable.shape)
        direct = np.zeros(len(self.stable))
        if self.stable.any():
            direct[self.stable] = self._step.D[:, 1, 0]
        unit = np.maximum(np.abs(final), np.abs(direct))
        course = self._follow(1, num, final, np.where(unit > 0.0, unit, 1.0))
        return np.asarray(np.where(unit > 0.0, unit, 1.0) * np.maximum(course.highest, -course.lowest))

    @cached_property
    def _course(self) -> StepCourse:
        num = poly.multiply(np.atleast_2d(self.G.num), self.K.num_r)
        return self._follow(0, num, self.final_value, self.final_value)

    def _follow(self, output: int, num: Array, final: Array, unit: Array) -> StepCourse:
        """y (0) or u (1), num its numerators over ``closed``, relative to ``unit``; ∞ where unstable."""
        found = StepCourse(*np.full((5, len(self.stable)), np.inf))
        chosen = np.flatnonzero(self.stable & np.isfinite(unit) & (unit != 0.0))
        if len(chosen):
            among = np.searchsorted(np.flatnonzero(self.stable), chosen)
            A, B, C, D = (part[among] for part in self._step)
            scale = 1.0 / unit[chosen]
            C, D = (scale[:, None, None] * part[:, output : output + 1] for part in (C, D))
            num = num if len(num) == 1 and len(self.stable) > 1 else num[chosen]
            shown = modes(num, self.closed[chosen], self.sampling, np.abs(unit[chosen]))
            course = follow(
                StateSpace(A, B, C, D), final[chosen] * scale, shown, self.sampling, is_effort=output == 1
            )
            for all_of_them, some in zip(found, course, strict=True):
                all_of_them[chosen] = some
        return found

    @cached_property
    def _stable_controllers(self) -> Controller:
        stable = self.stable
        return Controller(*(p if len(p) == 1 and len(stable) > 1 else p[stable] for p in self.K))

    @cached_property
    def _step(self) -> StateSpace:
        """From r to [y, u], of the stable loops."""
        with np.errstate(all="ignore"):
            return closed_loop(self.G, self._stable_controllers)

    @cached_property
    def error(self) -> Array:
        """|1 - y| (B,) for t -> ∞ after a unit step."""
        return np.abs(1.0 - self.final_value)

    def true_frequency(self, omega: Array) -> Array:
        """Frequencies of the loop's plane in true rad/s."""
        if self.sampling is None:
            return omega
        return np.asarray(self.sampling.unwarp(omega))
