"""A linear model of one axis: a transfer function with dead time, and eq. (15) of the paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class LinearModel:
    """G(s) = num(s)/den(s) exp(-dead_time_s s), from volts of offset to displacement in the axis' unit.

    ``num`` and ``den`` are coefficients in falling powers of s; the degree of ``num`` does not exceed that of
    ``den``. Poles may be unstable, repeated, or at 0.
    """

    num: tuple[float, ...]
    den: tuple[float, ...]
    dead_time_s: float = 0.0


def _equation_15() -> LinearModel:
    gain, zero, slow_pole, mode_1_s, mode_1_s2 = 0.47947, 90.76, 0.4231, 16.97, 167.9
    den = (1.0, slow_pole + mode_1_s, slow_pole * mode_1_s + mode_1_s2, slow_pole * mode_1_s2)
    return LinearModel((gain, gain * zero), den)


EQUATION_15: Final = _equation_15()
"""The paper's vertical axis: 0.47947 (s + 90.76) / ((s + 0.4231) (s^2 + 16.97 s + 167.9)), in m/V."""
