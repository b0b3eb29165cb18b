"""The continuous model behind a zero-order hold of which a sampled model is the image, if there is one.

A sampled pole z is the image of s = log(z)/T. The logarithm exists as a real model where no pole lies on
the negative real axis or at 0, and it is unique among modes below half the sampling frequency. With the
poles known, the sampled numerator is a linear function of the continuous one, which is inverted. Whole
samples of delay are a dead time.

A pole on the negative real axis changes sign at each sample; no continuous plant of the same order does
that. A pole at 0 is a delay or noise. For such models ``estimators.nearest_continuous`` gives
a model that comes close.
"""

from __future__ import annotations

import numpy as np

from design.errors import DesignError
from design.identification.least_squares import solved
from design.identification.models.difference_basis import basis
from design.identification.models.held_discretisation import held_numerators
from design.identification.models.model import ContinuousModel, DiscreteModel, logarithms
from design.mathematics.polynomials import Array, from_roots

_ON_THE_AXIS = 1e-7
"""Largest argument, as a distance from π, of a pole that counts as lying on the negative real axis."""
_ROUNDING = 1e-11
"""Share of the largest term at the fastest pole below which a leading coefficient is rounding."""
_AT_ZERO = 1e-12
"""Largest modulus of a pole that counts as lying at 0."""


class NoContinuousModelError(DesignError):
    """No continuous model behind a zero-order hold has this sampled image."""


def invert_hold(model: DiscreteModel) -> ContinuousModel:
    """Return the continuous model of which ``model`` is the image behind a zero-order hold.

    A delay of nk samples becomes a dead time of nk - 1 sample times, for the hold itself needs one. Raises
    NoContinuousModelError, whose text names the pole, where no such model exists.
    """
    T = model.sample_time_s
    b, lag = model.b, model.nk
    while len(b) > 1 and b[0] == 0.0:
        b, lag = b[1:], lag + 1
    n = len(np.trim_zeros(model.f, "b")) - 1
    b = np.trim_zeros(b, "b") if b.any() else b[:1]
    _check_poles(model)
    if len(b) > n + (lag == 0):
        raise NoContinuousModelError(
            f"{len(b)} coefficients in B with {n} poles: no continuous model of order {n} behind a "
            f"zero-order hold has them; choose nb <= {n}, or a continuous structure with a dead time"
        )
    f = model.f[: n + 1]
    direct = float(b[0]) if lag == 0 else 0.0
    delayed = np.concatenate([np.zeros(min(lag, 1)), b, np.zeros(n)])[: n + 1] - direct * f
    poles = logarithms(f, T)
    den = from_roots(poles[None])[0].real
    num = np.concatenate([np.zeros(1), _continuous_numerator(den, f, delayed[1:], T)]) + direct * den
    speed = np.abs(poles).max(initial=1e-3 / T)
    sizes = np.abs(num) * speed ** np.arange(n, -1.0, -1.0)
    first = int(np.argmax(sizes > _ROUNDING * sizes.max(initial=0.0)))
    return ContinuousModel(num[first:], den, max(lag - 1, 0) * T)


def _continuous_numerator(den: Array, f: Array, b: Array, sample_time_s: float) -> Array:
    """Return the numerator (n,) in falling powers of s, whose sampled image over f is b (n,)."""
    n = len(den) - 1
    if n == 0:
        return np.zeros(0)
    images = held_numerators(den[None], f[None], 0, np.zeros(1), n, sample_time_s)[0, :-1]
    V = basis(n)
    rows, right = V @ images, V @ b
    return solved(rows, right)[::-1]


def _check_poles(model: DiscreteModel) -> None:
    T = model.sample_time_s
    for z in model.poles_z:
        if abs(z) < _AT_ZERO:
            raise NoContinuousModelError(
                "a pole at z = 0: a delay of one sample, or an order that is too high; lower nf or raise nk"
            )
        if abs(abs(np.angle(z)) - np.pi) < _ON_THE_AXIS:
            raise NoContinuousModelError(
                f"a pole at z = {z.real:.4g}, on the negative real axis: no continuous model of order "
                f"{model.order} behind a zero-order hold of {T:g} s has it; lower nf, sample faster, or "
                "use a continuous structure"
            )
