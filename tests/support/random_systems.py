"""Random systems as polynomials and, independently of them, as cascades of small state spaces.

The norms of the cascades are slycot's. So the reference shares no polynomial with the code under test.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import slycot
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from design.models.transfer_function import TransferFunction

patient = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much])
"""Settings for random loops: many are unstable and rejected; a slow machine must not fail a test."""

Array = NDArray[np.float64]
Blocks = tuple[Array, Array, Array, Array]


@dataclass(frozen=True)
class System:
    """A gain times numerator over denominator sections: (1,), (1, a) or (1, a, b) in falling powers."""

    gain: float
    num_sections: tuple[tuple[float, ...], ...]
    den_sections: tuple[tuple[float, ...], ...]

    @property
    def polynomials(self) -> TransferFunction:
        num, den = np.array([self.gain]), np.ones(1)
        for section in self.num_sections:
            num = np.polymul(num, section)
        for section in self.den_sections:
            den = np.polymul(den, section)
        return TransferFunction(num, den)

    @property
    def order(self) -> int:
        return sum(len(section) - 1 for section in self.den_sections)

    def at(self, s: complex) -> complex:
        num, den = self.parts_at(s)
        return num / den

    def parts_at(self, s: complex) -> tuple[complex, complex]:
        num, den = complex(self.gain), 1.0 + 0.0j
        for section in self.num_sections:
            num *= np.polyval(section, s)
        for section in self.den_sections:
            den *= np.polyval(section, s)
        return num, den

    @property
    def state_space(self) -> Blocks:
        """The cascade of the denominator sections, each with as many zeros as its order allows."""
        nums = [np.ones(1) for _ in self.den_sections]
        for zeros in self.num_sections:
            for i, poles in enumerate(self.den_sections):
                if len(nums[i]) + len(zeros) - 1 <= len(poles):
                    nums[i] = np.polymul(nums[i], zeros)
                    break
            else:
                raise ValueError("zeros do not fit the sections")
        A, B, C, D = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[self.gain]])
        for num, den in zip(nums, self.den_sections, strict=True):
            a, b, c, d = _companion(num, np.array(den))
            A = np.block([[A, np.zeros((len(A), len(a)))], [b @ C, a]])
            B, C, D = np.vstack([B, b @ D]), np.hstack([d @ C, c]), d @ D
        return A, B, C, D


def sections(
    count: int, min_damping: float = 1e-3, integrators: bool = False
) -> st.SearchStrategy[tuple[float, ...]]:
    """Draw a section of degree ``count`` (1 or 2), stable or not, with its mode between 0.1 and 30 rad/s."""
    speed = st.floats(-1.0, 1.5).map(lambda exponent: 10.0**exponent)
    sign = st.sampled_from([1.0, 1.0, 1.0, -1.0])
    if count == 1:
        real = st.builds(lambda w, side: (1.0, side * w), speed, sign)
        return st.one_of(real, st.just((1.0, 0.0))) if integrators else real
    damping = st.floats(np.log10(min_damping), 0.0).map(lambda exponent: 10.0**exponent)
    return st.builds(lambda w, zeta, side: (1.0, side * 2.0 * zeta * w, w * w), speed, damping, sign)


@st.composite
def systems(
    draw: st.DrawFn,
    min_order: int = 1,
    max_order: int = 8,
    min_damping: float = 1e-3,
    strictly_proper: bool = False,
) -> System:
    """Draw a plant: unstable, integrating, non-minimum phase or not, with a gain of 0.1 to 10 at 1 rad/s."""
    order = draw(st.integers(min_order, max_order))
    pairs = draw(st.integers(0, order // 2))
    den = [draw(sections(2, min_damping)) for _ in range(pairs)]
    den += [draw(sections(1, integrators=True)) for _ in range(order - 2 * pairs)]
    zero_pairs = draw(st.integers(0, pairs))
    num = [draw(sections(2, min_damping)) for _ in range(zero_pairs)]
    num += [draw(sections(1)) for _ in range(draw(st.integers(0, order - 2 * pairs)))]
    if strictly_proper and sum(map(len, num)) - len(num) == order and num:
        num.pop()
    system = System(1.0, tuple(num), tuple(den))
    gain = 10.0 ** draw(st.floats(-1.0, 1.0)) / abs(system.at(1.0j))
    return System(gain, tuple(num), tuple(den))


def slycot_margin(G: System, K: System) -> float:
    """Return 1/‖T_zw‖∞ by slycot's ab13dd; 0 if the loop is unstable.

    ab13dd sometimes stops at a peak that is not the highest, so the largest norm of four runs is used.
    """
    return min(slycot_margins(G, K))


def slycot_margins(G: System, K: System) -> list[float]:
    """Return the margins of four runs: with and without equilibration, at two tolerances."""
    A, B, C, D = closed_loop(G, K)
    if np.linalg.eigvals(A).real.max(initial=-1.0) >= 0.0:
        return [0.0]
    n = len(A)
    runs = [
        slycot.ab13dd("C", "I", equilibrated, "D", n, 2, 2, A, np.eye(n), B, C, D, tolerance)[0]
        for equilibrated in "SN"
        for tolerance in (1e-9, 1e-10)
    ]
    return [1.0 / run for run in runs]


def margin_at(G: System, K: System, omega: float) -> float:
    """Return 1/σ_max(T_zw(jω)), from the state space of the loop."""
    A, B, C, D = closed_loop(G, K)
    value = D + C @ np.linalg.solve(1j * omega * np.eye(len(A)) - A, B) if np.isfinite(omega) else D
    return float(1.0 / np.linalg.norm(value, 2))


def margin_of_sections(G: System, K: System, omega: float) -> float:
    """Return 1/σ_max(T_zw(jω)) from the sections, which lose no digits by cancellation; ω may be ∞."""
    if not np.isfinite(omega):
        return margin_at(G, K, omega)
    (Gn, Gd), (Kn, Kd) = G.parts_at(1j * omega), K.parts_at(1j * omega)
    return float(abs(Gn * Kn + Gd * Kd) / np.hypot(abs(Gn), abs(Gd)) / np.hypot(abs(Kn), abs(Kd)))


def closed_loop(G: System, K: System) -> Blocks:
    """Return T_zw of eq. (13), from (w1, w2) to (y, u) with y = G (u + w2) + w1 and u = -K y."""
    A, B, C, D = G.state_space
    a, b, c, d = K.state_space
    q = 1.0 / (1.0 + (D @ d)[0, 0])
    Cy, Dy = q * np.hstack([C, -D @ c]), q * np.hstack([np.ones((1, 1)), D])
    Cu, Du = -np.hstack([np.zeros((1, len(A))), c]) - d @ Cy, -d @ Dy
    Acl = np.block([[A, np.zeros((len(A), len(a)))], [np.zeros((len(a), len(A))), a]])
    Acl = Acl + np.vstack([B @ Cu, b @ Cy])
    Bcl = np.vstack([B @ (Du + np.array([[0.0, 1.0]])), b @ Dy])
    return Acl, Bcl, np.vstack([Cy, Cu]), np.vstack([Dy, Du])


def _companion(num: Array, den: Array) -> Blocks:
    n = len(den) - 1
    padded = np.concatenate([np.zeros(n + 1 - len(num)), num])
    A = np.eye(n, k=-1)
    A[0] = -den[1:]
    return A, np.eye(n, 1), (padded[1:] - den[1:] * padded[0]).reshape(1, n), padded[:1].reshape(1, 1)
