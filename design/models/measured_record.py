"""A measured record compared with what the plant model says of it: the data of Fig. 5.

A record is a CSV file with the columns time_s, u and y: the valve voltage relative to its centre in V, and
the position in the plant's unit. It is evenly sampled, and u is constant between samples. A record seldom
begins at rest at 0. So the initial state of the model and the offset of the record are fitted.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, replace

import numpy as np

from design.mathematics.polynomials import Array
from design.models.plant import Plant
from design.models.sampling import to_z
from hil.core.errors import DocumentError

COLUMNS = ("time_s", "u", "y")
MIN_ROWS = 10
POOR_PERCENT = 70.0
"""Fit in percent below which the record does not confirm the model."""
FACTORS = {
    1000.0: "y in mm, the model in m?",
    100.0: "y in cm, the model in m?",
    180.0 / np.pi: "y in degrees, the model in rad?",
    0.001: "u in mV?",
    -1.0: "valve or potentiometer the other way round than in the model?",
}
"""Frequent mistakes in a record, by the factor that they bring into its y."""


@dataclass(frozen=True)
class ModelFit:
    """A record and the output of the model for its input: arrays (k,) over ``time_s``."""

    source: str
    time_s: Array
    input_v: Array
    measured: Array
    model: Array
    doubt: str = ""
    """Warning that the record does not confirm the model, with a likely reason; empty for a good fit."""

    @property
    def fit_percent(self) -> float:
        """Fit of the model in percent: 100 (1 - |y - model| / |y - mean y|)."""
        return _fit_percent(self.measured, self.model)


def compare(plant: Plant, text: str, source: str) -> ModelFit:
    """Compare the record ``text``, from the file ``source``, with the output of the model for its input.

    Raises DocumentError that names the row or the column.
    """
    time_s, u, y = _columns(text, source)
    period_s = float((time_s[-1] - time_s[0]) / (len(time_s) - 1))
    uneven = np.abs(np.diff(time_s) - period_s)
    if not uneven.max() < 0.05 * period_s:
        row = int(uneven.argmax()) + 3
        raise DocumentError(
            f"{source}: row {row}: {np.diff(time_s)[row - 3]:.6g} s after the row before, but the mean is "
            f"{period_s:.6g} s; give an evenly sampled record"
        )
    if not np.ptp(y) > 0.0:
        raise DocumentError(f"{source}: y never changes, so there is nothing to compare; record a motion")
    forced, free = _motions(plant, u, period_s)
    model = forced + free @ np.linalg.lstsq(free, y - forced, rcond=None)[0]
    fit = ModelFit(source, time_s - time_s[0], u, y, model)
    if fit.fit_percent >= POOR_PERCENT:
        return fit
    return replace(
        fit,
        doubt=f"{source}: the model follows this record to {fit.fit_percent:.1f} % only"
        + _explanation(plant, u, y, period_s),
    )


def _explanation(plant: Plant, u: Array, y: Array, period_s: float) -> str:
    """Return the mistake in the record that would explain the poor fit, as the rest of a sentence."""
    gain, fit_percent = _with_gain(plant, u, y, period_s)
    if fit_percent >= POOR_PERCENT:
        why = [text for factor, text in FACTORS.items() if abs(gain / factor - 1.0) < 0.25]
        number = f"{gain:.0f}" if abs(gain) >= 100.0 else f"{gain:.2g}"
        misfit = f": its y is {number} times what the model says; without this factor they agree to"
        return f"{misfit} {fit_percent:.1f} %; {why[0] if why else 'other units, or another plant?'}"
    if np.ptp(u) > 0.0 and _with_gain(plant, y, u, period_s)[1] >= POOR_PERCENT:
        return ": with u and y exchanged they agree; are the columns swapped?"
    return ": another plant or axis, other conditions, or a time shift between u and y?"


def _with_gain(plant: Plant, u: Array, y: Array, period_s: float) -> tuple[float, float]:
    """Return the gain on the model that fits best, and the fit with this gain in percent."""
    forced, free = _motions(plant, u, period_s)
    columns = np.column_stack([forced, free])
    size = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    weights = np.linalg.lstsq(columns / size, y, rcond=None)[0] / size
    return float(weights[0]), _fit_percent(y, columns @ weights)


def _fit_percent(measured: Array, model: Array) -> float:
    return 100.0 * (
        1.0 - float(np.linalg.norm(measured - model) / np.linalg.norm(measured - measured.mean()))
    )


def _motions(plant: Plant, u: Array, period_s: float) -> tuple[Array, Array]:
    """Return the model's output (k,) for u from rest, and its free motions with a constant (k, n + 1)."""
    num, den = to_z(plant.record_model(period_s), period_s)
    n = len(den) - 1
    # The motions from all initial states are spanned by z^i/den for i = 1 … n.
    free = [_filtered(np.eye(1, n + 1, k)[0], den, np.eye(1, len(u))[0]) for k in range(n)]
    return _filtered(num, den, u), np.stack([*free, np.ones_like(u)], axis=1)


def _filtered(num: Array, den: Array, u: Array) -> Array:
    """Return the output of num/den, in falling powers of z, for the input u from rest.

    This is the transposed direct form II, in plain Python: importing scipy.signal takes longer.
    """
    n = len(den) - 1
    lead = [0.0] * (len(den) - len(num))
    b, a = [*lead, *(num / den[0]).tolist()], (den / den[0]).tolist()
    states, y = [0.0] * (n + 1), []
    for x in u.tolist():
        out = b[0] * x + states[0]
        for i in range(n):
            states[i] = b[i + 1] * x - a[i + 1] * out + states[i + 1]
        y.append(out)
    return np.array(y)


def _columns(text: str, source: str) -> tuple[Array, Array, Array]:
    """Return time_s, u and y (k,) of a CSV text; raise DocumentError for a missing or unreadable value."""
    rows = list(csv.DictReader(io.StringIO(text)))
    names = tuple(rows[0]) if rows else ()
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise DocumentError(
            f"{source}: column {', '.join(missing)} is missing; a record has the columns {', '.join(COLUMNS)}"
        )
    if len(rows) < MIN_ROWS:
        raise DocumentError(f"{source}: {len(rows)} rows are too few for a record; give at least {MIN_ROWS}")
    table = np.zeros((3, len(rows)))
    for i, row in enumerate(rows):
        for j, name in enumerate(COLUMNS):
            try:
                table[j, i] = float(row[name])
            except (TypeError, ValueError):
                raise DocumentError(f"{source}: row {i + 2}: {name}: {row[name]!r} is not a number") from None
    if not np.isfinite(table).all():
        number = int(np.argwhere(~np.isfinite(table))[0, 1]) + 2
        raise DocumentError(f"{source}: row {number}: not a finite number")
    return table[0], table[1], table[2]
