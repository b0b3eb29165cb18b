r"""The error of a free-running simulation, reduced to a few rows, for any parametrisation of the dynamics.

The model of one stretch of data is

    F(q) w(k) = B(q) u(k - lag),    y(k) = w(k) + c_0 + c_1 t(k) + e(k)

with w free to start anywhere. F is given; B, the initial states, the offset c_0 and the drift c_1 enter
linearly and are eliminated exactly (variable projection). What the search sees is a problem in the dynamics
alone. The slope is Kaufman's: with the linear unknowns held,

    dy/df_j = -q^-j w / F,    dy/db_j = q^-(lag + j) u / F

so that two filter runs give all columns. Masked samples have weight 0. Nothing is computed from an output
that was not measured.

A plant with an integrator keeps any offset of its output; an offset of its input shows as a ramp. So the
powers of time that are estimated begin at the number of integrators.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from design.identification.estimators.elimination import Layout, Reduced, projected, reduce
from design.identification.estimators.stacking import filtered_differences
from design.identification.least_squares import solved
from design.identification.models.difference_basis import basis, differences
from design.identification.records.experiment import Experiment, Stretch, stretches
from design.mathematics.polynomials import Array

MAX_MODULUS = 1e150
"""Modulus of a simulated signal from which a candidate counts as overflowing."""


class Dynamics(NamedTuple):
    """F and, for given F, all numerators that the structure allows.

    ``f`` (n + 1,) in powers of z^-1, f[0] = 1; ``numerators`` (nb, v) in powers of z^-1, whose combinations
    are B; ``lag`` samples from the input to B's first coefficient.
    """

    f: Array
    numerators: Array
    lag: int


class Slopes(NamedTuple):
    """Derivatives of the dynamics: df[1:] (n, p) and dnumerators (nb, v, p) for p parameters."""

    f: Array
    numerators: Array


@dataclass(frozen=True)
class Simulated:
    """A candidate that was simulated over the data."""

    cost: float
    dynamics: Dynamics
    gains: Array
    """Factors (v,) of the numerators."""
    columns: list[Array]
    reduced: Reduced

    def with_gains(self, gains: Array) -> Simulated:
        """Return the candidate with other factors (v,) of the numerators. Its cost is not theirs."""
        return replace(self, gains=gains)

    @property
    def b(self) -> Array:
        """Coefficients (nb,) of B in powers of z^-1."""
        return np.asarray(self.dynamics.numerators @ self.gains)


class Fitted(NamedTuple):
    """Model, residual and nuisance values of one stretch."""

    stretch: Stretch
    motion: Array
    """Model output (m,) without offset and drift."""
    common: Array
    """Offset and drift (c,), in powers of the relative time, as estimated for the experiment."""
    residual: Array
    """y - model (m,). Meaningless where the weight is 0."""


class SimulationError:
    """The data of several experiments, ready to be compared with candidates."""

    def __init__(
        self,
        experiments: Sequence[Experiment],
        *,
        skipped: int = 0,
        drift: bool = False,
        integrators: int = 0,
    ) -> None:
        self.experiments = list(experiments)
        self.stretches = stretches(self.experiments, skipped)
        self.powers = range(integrators, integrators + 1 + drift)
        self.residuals = sum(int(np.count_nonzero(s.root_weight)) for s in self.stretches)
        self.scale = float(sum(np.sum((s.root_weight * s.y) ** 2) for s in self.stretches))
        self._common = [self._powers_of_time(s) for s in self.stretches]
        self._whole = [bool((s.root_weight == 1.0).all()) for s in self.stretches]

    def unknowns(self, order: int) -> int:
        """Return the number of nuisance unknowns with F of this order: initial states, offsets, drifts."""
        offsets = len({s.experiment for s in self.stretches}) * len(self.powers)
        return order * len(self.stretches) + offsets

    def simulate(self, dynamics: Dynamics) -> Simulated | None:
        """Fit the linear unknowns to the data for given dynamics. None where the simulation overflows."""
        f, numerators, lag = dynamics
        n, nb = len(f) - 1, len(numerators)
        impulse = np.zeros(max(map(len, self.stretches)))
        impulse[0] = 1.0
        with np.errstate(over="ignore", invalid="ignore"):
            free = differences(lfilter([1.0], f, impulse), n, 0)
            forced = filtered_differences([stretch.u for stretch in self.stretches], f, nb, lag)
        if not (_moderate([free[:1]]) and _moderate([driven[-1:] for driven in forced])):
            return None
        columns = []
        for stretch, common, driven in zip(self.stretches, self._common, forced, strict=True):
            block = np.empty((n + len(common) + nb + 1, len(stretch)))
            block[:n] = free[:, : len(stretch)]
            block[n : n + len(common)] = common
            block[n + len(common) : -1] = driven
            block[-1] = stretch.y
            columns.append(block)
        reduced = self._reduce(columns, Layout(n, len(self.powers), nb + 1))
        A = reduced.shared[:, :nb] @ (basis(nb) @ numerators)
        right = reduced.shared[:, nb]
        gains = solved(A, right)
        return Simulated(float(np.sum((right - A @ gains) ** 2)), dynamics, gains, columns, reduced)

    def linearised(self, simulated: Simulated, slopes: Slopes) -> tuple[Array, Array, Array]:
        """Return A (r, v), J (r, p) and e (r,).

        The residuals near the candidate are e - A dgains - J dθ, up to an orthogonal part.
        """
        n, nb = len(simulated.dynamics.f) - 1, len(simulated.dynamics.numerators)
        blocks = []
        parts = self.fitted(simulated)
        slopes_of_f = filtered_differences([part.motion for part in parts], simulated.dynamics.f, n, 1)
        for block, fitted, by_f in zip(simulated.columns, parts, slopes_of_f, strict=True):
            extended = np.empty((len(block) + n, block.shape[1]))
            extended[: len(block) - 1] = block[:-1]
            np.negative(by_f, out=extended[len(block) - 1 : -1])
            extended[-1] = fitted.residual
            blocks.append(extended)
        R = self._reduce(blocks, Layout(n, len(self.powers), nb + n + 1)).shared
        A, J = self._chained(R[:, :nb], R[:, nb : nb + n], simulated, slopes)
        return A, J, R[:, -1]

    def sensitivities(self, simulated: Simulated, slopes: Slopes) -> list[Array]:
        """Return the weighted derivatives (v + p, m) of the output on each stretch, nuisances eliminated."""
        n, c = len(simulated.dynamics.f) - 1, len(self.powers)
        columns = []
        motions = [part.motion for part in self.fitted(simulated)]
        slopes_of_f = filtered_differences(motions, simulated.dynamics.f, n, 1)
        for block, S in zip(simulated.columns, slopes_of_f, strict=True):
            A, J = self._chained(block[n + c : -1].T, -S.T, simulated, slopes)
            columns.append(np.concatenate([block[: n + c], A.T, J.T, np.zeros((1, block.shape[1]))]))
        reduced = self._reduce(columns, Layout(n, c, len(columns[0]) - n - c))
        found = projected(columns, [stretch.experiment for stretch in self.stretches], reduced)
        return [block * stretch.root_weight for block, stretch in zip(found, self.stretches, strict=True)]

    def fitted(self, simulated: Simulated) -> list[Fitted]:
        """Return the model output and residual on each stretch."""
        n, nb, c = len(simulated.dynamics.f) - 1, len(simulated.dynamics.numerators), len(self.powers)
        beta = basis(nb) @ simulated.b
        shared = np.concatenate([beta, [-1.0]])
        experiments = [stretch.experiment for stretch in self.stretches]
        values = {i: simulated.reduced.common_values(i, shared) for i in set(experiments)}
        states = simulated.reduced.local_values([values[i] for i in experiments], shared)
        found = []
        for stretch, block, local in zip(self.stretches, simulated.columns, states, strict=True):
            common = values[stretch.experiment]
            motion = local @ block[:n] + beta @ block[n + c : -1]
            residual = stretch.y - motion - common @ block[n : n + c]
            found.append(Fitted(stretch, motion, common, residual))
        return found

    def outputs(self, simulated: Simulated) -> list[tuple[Stretch, Array]]:
        """Return the model output (m,) with initial state, offset and drift on each stretch."""
        found = []
        for fitted, powers in zip(self.fitted(simulated), self._common, strict=True):
            found.append((fitted.stretch, fitted.motion + fitted.common @ powers))
        return found

    def _chained(self, X: Array, S: Array, simulated: Simulated, slopes: Slopes) -> tuple[Array, Array]:
        """Return the columns of the gains and of the parameters, from those of B's and F's coefficients."""
        V = basis(X.shape[1])
        A = X @ (V @ simulated.dynamics.numerators)
        J = S @ (basis(S.shape[1]) @ slopes.f)
        if slopes.numerators.any():
            J = J + X @ (V @ np.einsum("bvp,v->bp", slopes.numerators, simulated.gains))
        return A, J

    def _reduce(self, columns: list[Array], layout: Layout) -> Reduced:
        weighted = [
            block if whole else block * stretch.root_weight
            for block, stretch, whole in zip(columns, self.stretches, self._whole, strict=True)
        ]
        return reduce(weighted, [stretch.experiment for stretch in self.stretches], layout)

    def _powers_of_time(self, stretch: Stretch) -> Array:
        """Return the powers (c, m) of the time, -0.5 to 0.5 over the experiment."""
        count = max(len(self.experiments[stretch.experiment]), 2)
        t = np.arange(stretch.start, stretch.start + len(stretch)) / (count - 1) - 0.5
        return np.array([t**power for power in self.powers])


def _moderate(signals: Sequence[Array]) -> bool:
    """Return True if all values are numbers that can be squared."""
    values = signals[0] if len(signals) == 1 else np.concatenate(signals, axis=1)
    return bool(np.abs(values).max(initial=0.0) < MAX_MODULUS)
