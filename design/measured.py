"""A measured record beside what the plant model says of it: the data of Fig. 5.

A record is a CSV with the columns time_s, u, y: valve offset in V, position in the plant's unit, evenly
sampled, u held between samples. The model's initial state and the record's offset are fitted, for a record
seldom begins at rest at 0.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass

import numpy as np

from design.plant import Plant, Sampling, to_z
from design.polynomials import Array
from hil.errors import DocumentError

COLUMNS = ("time_s", "u", "y")


@dataclass(frozen=True)
class ModelFit:
    """Record and model, arrays (k,) over ``time_s``."""

    time_s: Array
    input_v: Array
    measured: Array
    model: Array

    @property
    def fit_percent(self) -> float:
        """100 (1 - |y - model| / |y - mean y|)."""
        spread = float(np.linalg.norm(self.measured - self.measured.mean()))
        return 100.0 * (1.0 - float(np.linalg.norm(self.measured - self.model)) / spread)


def compare(plant: Plant, text: str, source: str) -> ModelFit:
    """The record ``text`` beside the model's output for its input. Raises DocumentError naming the row."""
    time_s, u, y = _columns(text, source)
    period_s = float((time_s[-1] - time_s[0]) / (len(time_s) - 1))
    uneven = np.abs(np.diff(time_s) - period_s)
    if not uneven.max() < 0.05 * period_s:
        row = int(uneven.argmax()) + 3
        raise DocumentError(
            f"{source}: row {row}: {np.diff(time_s)[row - 3]:.6g} s since the row before, the mean is "
            f"{period_s:.6g} s; the record must be evenly sampled"
        )
    if not np.ptp(y) > 0.0:
        raise DocumentError(f"{source}: y never changes; there is nothing to compare")
    num, den = to_z(plant.transfer_function(Sampling(period_s, delay_samples=0)), period_s)
    n = len(den) - 1
    forced = _filtered(num, den, u)
    # Motions from every initial state, z^i/den for i = 1 … n, and a constant.
    free = [_filtered(np.eye(1, n + 1, k)[0], den, np.eye(1, len(u))[0]) for k in range(n)]
    basis = np.stack([*free, np.ones_like(u)], axis=1)
    weights = np.linalg.lstsq(basis, y - forced, rcond=None)[0]
    return ModelFit(time_s - time_s[0], u, y, forced + basis @ weights)


def _filtered(num: Array, den: Array, u: Array) -> Array:
    """num/den in falling powers of z, applied to u from rest."""
    from scipy.signal import lfilter

    lead = np.zeros(len(den) - len(num))
    return np.asarray(lfilter(np.concatenate([lead, num]), den, u), dtype=float)


def _columns(text: str, source: str) -> tuple[Array, Array, Array]:
    rows = list(csv.DictReader(io.StringIO(text)))
    names = tuple(rows[0]) if rows else ()
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise DocumentError(
            f"{source}: column {', '.join(missing)} is missing; a record has the columns {', '.join(COLUMNS)}"
        )
    if len(rows) < 10:
        raise DocumentError(f"{source}: {len(rows)} rows are too few for a record")
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
