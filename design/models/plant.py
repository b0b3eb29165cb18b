"""Plant models: the plant document, and the plant as the loop sees it.

A continuous loop sees G(s). A sampled loop sees G behind a zero-order hold and whole samples of delay; here
that is a polynomial pair as well, in the bilinear plane s = 2/T (z - 1)/(z + 1). There a controller sampled
by Tustin's rule has its continuous coefficients again, the unit circle is the imaginary axis, and every norm
is that of the sampled loop exactly. So all the mathematics of this package is written once, for s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
import numpy as np

from design.errors import DesignError
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array
from design.models.plant_limits import because, hidden_text, hidden_unstable_mode, what_limits
from hil.core.documents import Document, from_json
from hil.core.errors import DocumentError


class TransferFunction(NamedTuple):
    """num/den, arrays (..., n + 1) of coefficients in falling powers of s."""

    num: Array
    den: Array


@dataclass(frozen=True)
class Sampling:
    """The loop's period in seconds and whole samples between a measurement and its action on the valve."""

    period_s: float
    delay_samples: int = 1

    def warp(self, omega: Array | float) -> Array:
        """Frequency of the bilinear plane for a true frequency in rad/s."""
        return 2.0 / self.period_s * np.tan(0.5 * self.period_s * np.asarray(omega, dtype=float))

    def unwarp(self, omega: Array | float) -> Array:
        """True frequency in rad/s for a frequency of the bilinear plane."""
        return 2.0 / self.period_s * np.arctan(0.5 * self.period_s * np.asarray(omega, dtype=float))


class Plant(Document, frozen=True, kw_only=True):
    """An identified plant: output unit per input unit, num/den in falling powers of s, relative to rest."""

    format: Literal["hil-plant"]
    version: Literal[1]
    name: str
    description: str = ""
    input_unit: Literal["V"]
    output_unit: Literal["m", "rad"]
    sample_time_s: Annotated[float, msgspec.Meta(gt=0.0)] | None = None
    """Period of the record it was identified from."""
    num: list[float]
    den: list[float]
    origin: dict[str, Any] = msgspec.field(default_factory=dict)

    @property
    def gain_sign(self) -> float:
        """1 or -1: the sign of feedback that negative feedback with a positive gain is, at low frequency."""
        return float(np.sign(np.trim_zeros(self.num, "b")[-1] * np.trim_zeros(self.den, "f")[0]))

    def transfer_function(self, sampling: Sampling | None = None) -> TransferFunction:
        """G(s), or with ``sampling`` hold, plant and delay in the bilinear plane."""
        num = np.trim_zeros(np.asarray(self.num, dtype=float), "f")
        den = np.trim_zeros(np.asarray(self.den, dtype=float), "f")
        if sampling is None:
            return TransferFunction(num, den)
        return delayed(zero_order_hold(TransferFunction(num, den), sampling.period_s), sampling)


def read_plant(text: str, source: str) -> Plant:
    """Read and check the text of a plant document. Raises DocumentError naming file, key and reason."""
    plant = from_json(text, Plant, source)
    if not any(plant.den):
        raise DocumentError(f"{source}: den: all coefficients are 0")
    if not any(plant.num):
        raise DocumentError(f"{source}: num: the plant's gain is 0; nothing can be controlled through it")
    G = plant.transfer_function()
    if len(G.num) > len(G.den):
        raise DocumentError(
            f"{source}: num has degree {len(G.num) - 1}, den {len(G.den) - 1}: improper, no plant answers "
            "before its input; check the order of the coefficients (falling powers of s)"
        )
    hidden = hidden_unstable_mode(G.num, G.den)
    if hidden is not None:
        raise DocumentError(f"{source}: {hidden_text(hidden)}")
    return plant


def check_plant_fits(plant: Plant, source: str, unit: str) -> None:
    """Refuse a plant whose output is not in the axis' unit. Raises DocumentError."""
    if plant.output_unit != unit:
        raise DocumentError(f"{source}: output_unit: {plant.output_unit}, but the axis is in {unit}")


def as_list(plants: Plant | Sequence[Plant]) -> list[Plant]:
    """One plant or several."""
    return [plants] if isinstance(plants, Plant) else list(plants)


def limit_notes(plants: Plant | Sequence[Plant], sampling: Sampling | None, wanted_rad_s: float = 0.0) -> str:
    """What these plants make hard for any controller, to be told with a failure; empty if nothing.

    ``wanted_rad_s`` is the crossover that was asked for.
    """
    several = as_list(plants)
    signs = {plant.name: plant.gain_sign for plant in several}
    delay_s = 0.0 if sampling is None else (sampling.delay_samples + 0.5) * sampling.period_s
    limits = [
        limit if len(several) == 1 else f"{plant.name}: {limit}"
        for plant in several
        for limit in what_limits(*plant.transfer_function(), delay_s, wanted_rad_s)
    ]
    if len(set(signs.values())) > 1:
        reversed_ones = ", ".join(name for name, sign in signs.items() if sign < 0.0)
        limits.append(
            f"of these plants {reversed_ones} moves against its input, the others with it: hardly any "
            "controller holds them all"
        )
    return because(limits)


def loop_models(plants: Plant | Sequence[Plant], sampling: Sampling | None) -> list[TransferFunction]:
    """What the loop sees of one plant or several. Raises DesignError where a mode is hidden and unstable."""
    several = as_list(plants)
    for plant in several:
        hidden = hidden_unstable_mode(*plant.transfer_function())
        if hidden is not None:
            raise DesignError(f"plant {plant.name}: {hidden_text(hidden)}")
    return [plant.transfer_function(sampling) for plant in several]


def paper_plant() -> Plant:
    """The paper's eq. (15), shipped with the package."""
    name = "plants/paper.json"
    return read_plant(resources.files("design.models").joinpath(name).read_text("utf-8"), name)


def zero_order_hold(G: TransferFunction, period_s: float) -> TransferFunction:
    """G behind a zero-order hold, in the bilinear plane; exact, and no worse conditioned for short periods.

    With Φ = exp(AT): A_w = 2/T (Φ - I)(Φ + I)^-1, and the factor 1 - sT/2 is the zero at z = ∞.
    """
    n = len(G.den) - 1
    num, den = G.num / G.den[0], G.den / G.den[0]
    direct = float(num[0]) if len(num) == n + 1 else 0.0
    if n == 0:
        return TransferFunction(num, den)
    from scipy.linalg import expm

    poles = poly.roots(den)
    scale = max(float(np.abs(poles).max()), 1e-3 / period_s)
    # Companion form in time scaled by the fastest pole, so that no entry dwarfs the others.
    scaled_den = den / scale ** np.arange(n + 1)
    scaled_num = poly.add(np.zeros(n + 1), num)[1:] / scale ** np.arange(1, n + 1) - direct * scaled_den[1:]
    A = np.eye(n, k=-1)
    A[0] = -scaled_den[1:]
    B = np.eye(n, 1)
    C = scaled_num.reshape(1, n)
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:] = A, np.eye(n)
    step = period_s * scale
    phi = expm(block * step)[:n, n:]
    plus = 2.0 * np.eye(n) + A @ phi
    if np.linalg.norm(plus, -2) < 1e-12:
        raise DesignError(
            f"the plant has an undamped mode at half the sampling frequency ({np.pi / period_s:.4g} rad/s): "
            "a loop of this period cannot see it"
        )
    inverse = np.linalg.inv(plus)
    A_w = 2.0 / step * A @ phi @ inverse
    B_w, C_w = phi @ B, 2.0 / step * C @ inverse
    den_w = poly.from_roots(np.tanh(0.5 * step * poles / scale) * (2.0 / step + 0j)).real
    num_w = numerator(A_w, B_w, C_w, den_w)
    num_w = poly.add(poly.multiply(num_w, np.array([-0.5 * step, 1.0])), direct * den_w)
    back = scale ** np.arange(n + 1.0)
    return TransferFunction(num_w * back, den_w * back)


def numerator(A: Array, B: Array, C: Array, den: Array) -> Array:
    """Numerator (n,) of C (sI - A)^-1 B over ``den``, det(sI - A).

    Fitted to its values at points spread over all magnitudes of the poles, each relative to its own size:
    so slow and fast zeros keep their digits alike.
    """
    n = len(A)
    moduli = np.abs(np.linalg.eigvals(A))
    moduli = moduli[moduli > 1e-12 * moduli.max(initial=0.0)]
    if not len(moduli):
        moduli = np.ones(1)
    k = np.arange(8 * n)
    golden = 0.5 * np.sqrt(5.0) - 0.5
    radii = np.geomspace(0.2 * moduli.min(), 5.0 * moduli.max(), len(k))
    s = radii * np.exp(1j * np.pi * ((0.5 + k * golden) % 1.0))
    resolvents = np.linalg.solve(s[:, None, None] * np.eye(n) - A, np.broadcast_to(B, (len(s), n, 1)))
    values = (C @ resolvents)[:, 0, 0] * np.polyval(den, s)
    size = np.abs(values)
    if not size.all():
        return np.zeros(max(n, 1))
    rows = s[:, None] ** np.arange(n - 1, -1, -1) / size[:, None]
    columns = np.abs(rows).max(axis=0, initial=0.0)
    rows, right = rows / columns, values / size
    fitted = np.linalg.lstsq(
        np.concatenate([rows.real, rows.imag]), np.concatenate([right.real, right.imag]), rcond=None
    )[0]
    return np.asarray(fitted / columns)


def delayed(G: TransferFunction, sampling: Sampling) -> TransferFunction:
    """G with the sampling's whole samples of delay, z^-1 = (1 - sT/2)/(1 + sT/2)."""
    num, den = G
    half = 0.5 * sampling.period_s
    for _ in range(sampling.delay_samples):
        num = poly.multiply(num, np.array([-half, 1.0]))
        den = poly.multiply(den, np.array([half, 1.0]))
    return TransferFunction(num, den)


def to_z(H: TransferFunction, period_s: float) -> TransferFunction:
    """From the bilinear plane to z (Tustin's rule): polynomials in falling powers of z, den monic."""
    n = max(H.num.shape[-1], H.den.shape[-1])
    pair = [
        poly.substitute_fraction(
            np.concatenate([np.zeros((*p.shape[:-1], n - p.shape[-1])), p], axis=-1),
            (2.0 / period_s, -2.0 / period_s),
            (1.0, 1.0),
        )
        for p in H
    ]
    lead = pair[1][..., :1]
    return TransferFunction(pair[0] / lead, pair[1] / lead)
