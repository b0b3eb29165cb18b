"""A batch of closed loops, and what can be read off them; each reading is made once, when first asked for."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from design import margins
from design import polynomials as poly
from design.loop_shaping import shaped
from design.plant import Sampling, TransferFunction
from design.polynomials import Array, Flags
from design.responses import StepResponses, step_responses
from design.structures import Controller

_SAMPLES = 512
_BAND = 0.02


class Loops:
    """Controllers (B, n + 1) on one plant, in s or in the bilinear plane of ``sampling``.

    ``desired`` is the open loop whose shape is specified: the shaped plant Gs while weights are selected,
    else GK itself. ``horizon_s`` is how long step responses are followed.
    """

    def __init__(
        self,
        G: TransferFunction,
        K: Controller,
        *,
        W: TransferFunction = margins.UNIT,
        sampling: Sampling | None = None,
        horizon_s: float = 6.0,
        desired: TransferFunction | None = None,
    ) -> None:
        self.G, self.K, self.W = G, Controller(*(np.atleast_2d(p) for p in K)), W
        self.sampling, self.horizon_s = sampling, horizon_s
        self.open = shaped(G, self.K.feedback)
        self.desired = self.open if desired is None else desired
        self.desired_name = "GK" if desired is None else "Gs"

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

    @cached_property
    def response(self) -> StepResponses:
        """Unit step responses over the horizon; those of unstable loops are 0."""
        if self.sampling is None:
            step_s, samples = self.horizon_s / (_SAMPLES - 1), _SAMPLES
        else:
            step_s = self.sampling.period_s
            samples = int(np.ceil(self.horizon_s / step_s)) + 1
        stable = np.flatnonzero(self.stable)
        y, u = np.zeros((2, len(self.stable), samples))
        if len(stable):
            K = Controller(*(p if len(p) == 1 else p[stable] for p in self.K))
            some = step_responses(self.G, K, self.sampling, step_s, samples)
            y[stable], u[stable] = some.y, some.u
        return StepResponses(step_s * np.arange(float(samples)), y, u)

    @cached_property
    def overshoot(self) -> Array:
        """Largest y over its final value, less 1 (B,); between samples by a parabola."""
        y = self.response.y
        k = np.clip(y.argmax(axis=-1), 1, y.shape[-1] - 2)[:, None]
        before, top, after = (np.take_along_axis(y, k + i, axis=-1)[:, 0] for i in (-1, 0, 1))
        highest = y.max(axis=-1)
        if self.sampling is None:
            bend = before - 2.0 * top + after
            with np.errstate(divide="ignore", invalid="ignore"):
                rise = -0.125 * (after - before) ** 2 / bend
            highest = highest + np.where((bend < 0.0) & (top == highest), rise, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.maximum(highest / self.final_value - 1.0, 0.0))

    @cached_property
    def settling_s(self) -> Array:
        """Time (B,) after which y stays within 2 % of its final value; ∞ if not within the horizon."""
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.abs(self.response.y / self.final_value[:, None] - 1.0) - _BAND
        outside = off > 0.0
        last = off.shape[-1] - 1 - np.argmax(outside[:, ::-1], axis=-1)
        following = np.minimum(last + 1, off.shape[-1] - 1)
        rows = np.arange(len(off))
        a, b = off[rows, last], off[rows, following]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(a > b, a / (a - b), 0.0)
        settled = self.response.time_s[last] + share * self.response.time_s[1]
        settled = np.where(outside.any(axis=-1), settled, 0.0)
        return np.where(outside[:, -1] | ~np.isfinite(self.final_value), np.inf, settled)

    @cached_property
    def rise_s(self) -> Array:
        """Time (B,) from 10 % to 90 % of the final value; ∞ if not within the horizon."""
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = self.response.y / self.final_value[:, None]
            high, low = self._first_above(relative, 0.9), self._first_above(relative, 0.1)
            return np.where(np.isfinite(high), high - low, np.inf)

    def _first_above(self, relative: Array, level: float) -> Array:
        reached = relative >= level
        k = np.argmax(reached, axis=-1)
        rows = np.arange(len(relative))
        a, b = relative[rows, np.maximum(k - 1, 0)], relative[rows, k]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(b > a, (level - a) / (b - a), 1.0)
        time_s = (np.maximum(k - 1, 0) + np.where(k > 0, share, 0.0)) * self.response.time_s[1]
        return np.where(reached.any(axis=-1), time_s, np.inf)

    @cached_property
    def effort(self) -> Array:
        """Largest |u| (B,) after a unit step of the setpoint, in output units of the controller."""
        return np.asarray(np.abs(self.response.u).max(axis=-1))

    @cached_property
    def error(self) -> Array:
        """|1 - y| (B,) for t -> ∞ after a unit step."""
        return np.abs(1.0 - self.final_value)

    def true_frequency(self, omega: Array) -> Array:
        """Frequencies of the loop's plane in true rad/s."""
        if self.sampling is None:
            return omega
        return np.asarray(self.sampling.unwarp(omega))
