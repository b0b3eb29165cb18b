"""What a plant forbids, whatever the controller: hidden unstable modes, and what its poles and zeros cost.

Skogestad and Postlethwaite, Multivariable Feedback Control, 2nd ed., secs 4.7 and 5.6 to 5.9. All rates in
rad/s. Only words come from here; nothing is decided by them but the refusal of a hidden mode.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array, ComplexArray, Flags

_THE_SAME = 1e-7
_NEARLY = 0.05
"""Relative distance of a pole and a zero."""


def hidden_unstable_mode(num: Array, den: Array) -> complex | None:
    """An unstable pole, or one on the axis, that is a zero as well; None if there is none."""
    pairs = _unstable_pairs(num, den, _THE_SAME)
    return pairs[0][0] if pairs else None


def hidden_text(pole: complex) -> str:
    """What is wrong with a plant that has a hidden unstable mode."""
    return (
        f"its unstable pole at s = {_place(pole)} is cancelled by a zero at the same place: the mode runs "
        "away unseen, and no controller can stop it; leave both out if they come from the identification, or "
        "measure something that sees the mode"
        if pole != 0.0
        else "num and den share the root s = 0: an integrator that drifts unseen, and no controller can stop "
        "it; leave both out if they come from the identification"
    )


def what_limits(num: Array, den: Array, delay_s: float, wanted_rad_s: float) -> list[str]:
    """Sentences on what this plant makes hard behind a delay, where a crossover is wanted; often none."""
    zeros, poles = poly.roots(num), poly.roots(den)
    found = [
        f"the unstable pole at s = {_place(pole)} is nearly cancelled by the zero at {_place(zero)}: hardly "
        "any controller can hold it"
        for pole, zero in _unstable_pairs(num, den, _NEARLY)
    ]
    if num[-1] == 0.0 and den[-1] != 0.0:
        found.append("the plant's gain is 0 at s = 0: no controller holds its output at a constant setpoint")
    right_zeros, right_poles = zeros[_is_right(zeros)], poles[_is_right(poles)]
    if len(right_zeros):
        slowest = right_zeros[np.abs(right_zeros).argmin()]
        found.append(
            f"the plant's zero at s = {_place(slowest)} (it first moves the wrong way) allows no crossover "
            f"much over {0.5 * abs(slowest):.3g} rad/s"
        )
    if len(right_poles):
        fastest = right_poles[np.abs(right_poles).argmax()]
        wanted_rad_s = max(wanted_rad_s, 2.0 * abs(fastest))
        found.append(
            f"the plant's unstable pole at s = {_place(fastest)} needs a crossover over about "
            f"{2.0 * abs(fastest):.3g} rad/s, and makes a step overshoot unless the setpoint is weighted"
        )
    integrators = len(den) - len(np.trim_zeros(den, "b"))
    if integrators >= 2:
        found.append(
            f"the plant's {integrators} integrators make a step overshoot unless the setpoint is weighted"
        )
    if wanted_rad_s * delay_s > 0.7:
        found.append(
            f"the loop's hold and delay, {delay_s:.3g} s, allow no crossover over {1.0 / delay_s:.3g} rad/s"
        )
    return found


def because(limits: Sequence[str]) -> str:
    """The sentences, to go after an error's."""
    return "".join(f"\nNote: {limit}" for limit in limits)


def _unstable_pairs(num: Array, den: Array, near: float) -> list[tuple[complex, complex]]:
    """Unstable poles, one of each pair, with the zero that cancels each."""
    zeros = list(poly.roots(num))
    found = []
    for pole in poly.roots(den):
        if not zeros or pole.real < -_THE_SAME * abs(pole):
            continue
        distance = [abs(zero - pole) for zero in zeros]
        i = int(np.argmin(distance))
        if distance[i] <= near * abs(pole):
            zero = complex(zeros.pop(i))
            if pole.imag >= 0.0:
                found.append((complex(pole), zero))
    return found


def _is_right(roots: ComplexArray) -> Flags:
    return np.asarray(np.real(roots) > _THE_SAME * np.abs(roots))


def _place(root: complex) -> str:
    if abs(root.imag) <= _THE_SAME * abs(root):
        return f"{root.real:.4g}"
    real = root.real if abs(root.real) > _THE_SAME * abs(root) else 0.0
    return f"{real:.4g} ± {abs(root.imag):.4g}j"
