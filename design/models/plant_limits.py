"""What a plant makes hard or impossible for every controller: hidden unstable modes, zeros, poles and delays.

Source: Skogestad and Postlethwaite, Multivariable Feedback Control, 2nd ed., secs 4.7 and 5.6 to 5.9. Only a
hidden unstable mode is refused. All other findings are hints to the user, and change no result.
"""

from __future__ import annotations

import numpy as np

from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array, ComplexArray, Flags

_COINCIDENT = 1e-7
"""Relative distance below which a pole and a zero are the same, or a root lies on the imaginary axis."""
_NEARLY_COINCIDENT = 0.05
"""Relative distance below which a zero nearly cancels a pole."""


def hidden_unstable_mode(num: Array, den: Array) -> complex | None:
    """Return a pole in Re s >= 0 (1/s) that a zero cancels; None if there is none."""
    pairs = _unstable_pairs(num, den, _COINCIDENT)
    return pairs[0][0] if pairs else None


def hidden_mode_message(pole: complex) -> str:
    """Return what is wrong with a plant that hides an unstable mode, and what to do."""
    if pole == 0.0:
        return (
            "num and den share the root s = 0: the plant hides an integrator that drifts, and no controller "
            "can stop it; remove the root from both if the identification added it"
        )
    return (
        f"its unstable pole at s = {_root_text(pole)} is cancelled by a zero at the same place: the plant "
        "hides a mode that diverges, and no controller can stop it; remove both if the identification added "
        "them, or measure an output that shows the mode"
    )


def performance_limits(num: Array, den: Array, delay_s: float, wanted_rad_s: float) -> list[str]:
    """Return sentences on what makes this plant hard to control; an empty list if nothing does.

    ``delay_s`` is the delay of the loop, with half a period for its hold. ``wanted_rad_s`` is the crossover
    that is specified, or 0.
    """
    zeros, poles = poly.roots(num), poly.roots(den)
    found = [
        f"the plant's unstable pole at s = {_root_text(pole)} is nearly cancelled by its zero at "
        f"{_root_text(zero)}: hardly any controller can stabilise it"
        for pole, zero in _unstable_pairs(num, den, _NEARLY_COINCIDENT)
    ]
    if num[-1] == 0.0 and den[-1] != 0.0:
        found.append(
            "the plant's gain is 0 at s = 0: no controller can hold its output at a constant setpoint"
        )
    right_zeros, right_poles = zeros[_is_right(zeros)], poles[_is_right(poles)]
    if len(right_zeros):
        slowest = right_zeros[np.abs(right_zeros).argmin()]
        found.append(
            f"the plant's zero at s = {_root_text(slowest)} (it first moves in the wrong direction) allows "
            f"no crossover much over {0.5 * abs(slowest):.3g} rad/s"
        )
    if len(right_poles):
        fastest = right_poles[np.abs(right_poles).argmax()]
        wanted_rad_s = max(wanted_rad_s, 2.0 * abs(fastest))
        found.append(
            f"the plant's unstable pole at s = {_root_text(fastest)} needs a crossover over about "
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


def _unstable_pairs(num: Array, den: Array, distance: float) -> list[tuple[complex, complex]]:
    """Return the poles in Re s >= 0, one of each pair, that have a zero within the relative ``distance``."""
    zeros = list(poly.roots(num))
    found = []
    for pole in poly.roots(den):
        if not zeros or pole.real < -_COINCIDENT * abs(pole):
            continue
        distances = [abs(zero - pole) for zero in zeros]
        i = int(np.argmin(distances))
        if distances[i] <= distance * abs(pole):
            zero = complex(zeros.pop(i))
            if pole.imag >= 0.0:
                found.append((complex(pole), zero))
    return found


def _is_right(roots: ComplexArray) -> Flags:
    return np.asarray(np.real(roots) > _COINCIDENT * np.abs(roots))


def _root_text(root: complex) -> str:
    if abs(root.imag) <= _COINCIDENT * abs(root):
        return f"{root.real:.4g}"
    real = root.real if abs(root.real) > _COINCIDENT * abs(root) else 0.0
    return f"{real:.4g} ± {abs(root.imag):.4g}j"
