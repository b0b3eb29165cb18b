"""Plant models: the plant document, its checks, and the plant as a loop sees it.

A plant document says from which input to which output its model leads, and which delays the model contains:

- ``num`` and ``den``, in falling powers of s, and ``dead_time_s`` together are the model of the record that
  the plant was identified from. Its input is the valve voltage u as recorded, held constant for a period.
- ``contains_delay_samples`` says how many periods of the rig's transport delay lie between the recorded u and
  the valve, and so inside the model. It is 0 if the recorded u acts on the valve at once, as in eq. (15) of
  the paper, and 1 if the plant was identified through a rig whose boards apply a command at the next SYNC.

A loop with a delay of its own (``Sampling.delay_samples``) takes the place of the rig. Its delay replaces the
one that the model contains, so that the transport delay counts exactly once:

    delay of the loop = dead_time_s - contains_delay_samples * sample_time_s + delay_samples * period_s
"""

from __future__ import annotations

from importlib import resources
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from design.errors import DesignError
from design.models.plant_limits import hidden_mode_message, hidden_unstable_mode
from design.models.sampling import Sampling, zero_order_hold
from design.models.transfer_function import TransferFunction
from hil.core.documents import Document, from_json
from hil.core.errors import DocumentError

MAX_ORDER = 20
"""Largest degree of num and den."""
MIN_COEFFICIENT, MAX_COEFFICIENT = 1e-100, 1e100
"""Moduli between which coefficients must lie unless they are 0; the mathematics squares them."""
_ROUNDING = 1e-9
"""Share of a period below which a delay is a rounding error."""
_COVARIANCE_ROUNDING = 1e-9
"""Relative asymmetry, or negative eigenvalue, of a covariance that is a rounding error."""

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
DeadTime = Annotated[float, msgspec.Meta(ge=0.0, le=10.0)]


class DiscreteModel(Document, frozen=True):
    """The model as it was identified, from u to y as recorded: num/den in falling powers of z."""

    num: list[float]
    den: list[float]
    sample_time_s: Positive


class Covariance(Document, frozen=True):
    """The covariance matrix of the identified parameters, in the order of their names."""

    parameters: list[str]
    matrix: list[list[float]]


class Plant(Document, frozen=True, kw_only=True, omit_defaults=True):
    """An identified plant: output unit per input unit, relative to the point of operation."""

    format: Literal["hil-plant"]
    version: Literal[1]
    name: str
    description: str = ""
    input_unit: Literal["V"]
    output_unit: Literal["m", "rad"]
    sample_time_s: Positive | None = None
    """Period in s of the record that the plant was identified from."""
    num: list[float]
    """Numerator in falling powers of s."""
    den: list[float]
    """Denominator in falling powers of s."""
    dead_time_s: DeadTime = 0.0
    """Dead time of the model in s, in addition to num/den."""
    contains_delay_samples: Annotated[int, msgspec.Meta(ge=0, le=20)] = 0
    """Periods of ``sample_time_s`` of the rig's transport delay that the model contains."""
    discrete: DiscreteModel | None = None
    covariance: Covariance | None = None
    fit: dict[str, float] = msgspec.field(default_factory=dict)
    """Fit of the model in percent, 100 for a perfect one, by the name of the record."""
    conditions: dict[str, bool | int | float | str] = msgspec.field(default_factory=dict)
    """Conditions of the experiment, such as the supply pressure, by name."""
    recording: str | None = None
    """SHA-256 of the recording that the plant was identified from, as 64 hexadecimal digits."""
    warnings: list[str] = msgspec.field(default_factory=list)
    """What speaks against the model; every design with this plant repeats it."""
    origin: dict[str, Any] = msgspec.field(default_factory=dict)
    """Where the model comes from, in any form."""

    @property
    def rational_part(self) -> TransferFunction:
        """The model num/den (n + 1,) without its dead time."""
        return TransferFunction(
            np.trim_zeros(np.asarray(self.num, dtype=float), "f"),
            np.trim_zeros(np.asarray(self.den, dtype=float), "f"),
        )

    @property
    def gain_sign(self) -> float:
        """The sign of the gain at low frequency: 1 or -1."""
        return float(np.sign(np.trim_zeros(self.num, "b")[-1] * np.trim_zeros(self.den, "f")[0]))

    @property
    def own_dead_time_s(self) -> float:
        """Dead time of the plant itself in s, without the rig's transport delay.

        It is below 0 if num/den contain a part of the transport delay.
        """
        return self.dead_time_s - self.contains_delay_samples * (self.sample_time_s or 0.0)

    @property
    def is_rational(self) -> bool:
        """True if num/den alone are the plant without the rig's transport delay."""
        return abs(self.own_dead_time_s) <= _ROUNDING * (self.sample_time_s or self.dead_time_s or 1.0)

    def loop_delay_s(self, sampling: Sampling) -> float:
        """Return the delay in s, beside num/den and the hold, of a loop with this plant.

        Raises DesignError if the model contains more delay than the loop has.
        """
        loop_s = sampling.delay_samples * sampling.period_s
        delay_s = self.own_dead_time_s + loop_s
        if delay_s < -_ROUNDING * sampling.period_s:
            raise DesignError(
                f"plant {self.name}: contains_delay_samples: its model contains "
                f"{self.contains_delay_samples} periods of {self.sample_time_s:g} s of the rig's transport "
                f"delay, but this loop has only {loop_s + self.dead_time_s:g} s (delay_samples "
                f"{sampling.delay_samples} at {sampling.period_s:g} s): correct contains_delay_samples, or "
                "identify the plant with the delay of this loop"
            )
        return max(delay_s, 0.0)

    def transfer_function(self, sampling: Sampling | None = None) -> TransferFunction:
        """Return G(s), or with ``sampling`` the hold, the plant and all delays in the bilinear plane.

        Both are exact. Raises DesignError for a continuous loop with a dead time, which no polynomials can
        represent, and as :meth:`loop_delay_s` and :func:`zero_order_hold` do.
        """
        if sampling is not None:
            return self._behind_hold(sampling.period_s, self.loop_delay_s(sampling))
        if not self.is_rational:
            what = (
                f"dead_time_s: the plant has a dead time of {self.own_dead_time_s:g} s"
                if self.own_dead_time_s > 0.0
                else "contains_delay_samples: num and den contain a part of the rig's transport delay"
            )
            raise DesignError(
                f"plant {self.name}: {what}, which a continuous loop cannot represent exactly; design for "
                'the sampled loop (loop.design = "sampled")'
            )
        return self.rational_part

    def record_model(self, period_s: float) -> TransferFunction:
        """Return the model from u to y of a record with this period, in the bilinear plane.

        It contains the delays that the model contains, and no others.
        """
        return self._behind_hold(period_s, self.dead_time_s)

    def _behind_hold(self, period_s: float, delay_s: float) -> TransferFunction:
        try:
            return zero_order_hold(self.rational_part, period_s, delay_s)
        except DesignError as error:
            raise DesignError(f"plant {self.name}: {error}") from None


def read_plant(text: str, source: str) -> Plant:
    """Read and check the text of a plant document; ``source``, a file name, goes into error messages.

    Raises DocumentError that names file, key, reason and remedy.
    """
    plant = from_json(text, Plant, source)
    _check_polynomials(plant.num, plant.den, source, "s")
    hidden = hidden_unstable_mode(*plant.rational_part)
    if hidden is not None:
        raise DocumentError(f"{source}: {hidden_mode_message(hidden)}")
    if plant.contains_delay_samples and plant.sample_time_s is None:
        raise DocumentError(
            f"{source}: contains_delay_samples: {plant.contains_delay_samples} periods, but sample_time_s, "
            "the length of a period, is missing; add it"
        )
    if plant.discrete is not None:
        _check_polynomials(plant.discrete.num, plant.discrete.den, f"{source}: discrete", "z")
    if plant.covariance is not None:
        _check_covariance(plant.covariance, f"{source}: covariance")
    for name, percent in plant.fit.items():
        if percent > 100.0:
            raise DocumentError(f"{source}: fit.{name}: {percent:g} % is over 100 %; give the fit in percent")
    if plant.recording is not None and not _is_sha256(plant.recording):
        raise DocumentError(
            f"{source}: recording: {plant.recording!r} is not a SHA-256 of 64 hexadecimal digits; copy it "
            "from `sha256sum FILE`"
        )
    return plant


def check_plant_fits(plant: Plant, source: str, unit: str) -> None:
    """Raise DocumentError unless the plant's output is in the axis' unit."""
    if plant.output_unit != unit:
        raise DocumentError(f"{source}: output_unit: {plant.output_unit}, but the axis is in {unit}")


def paper_plant() -> Plant:
    """Return the paper's eq. (15), which is shipped with the package."""
    name = "plants/paper.json"
    return read_plant(resources.files("design.models").joinpath(name).read_text("utf-8"), name)


def _check_polynomials(num: list[float], den: list[float], source: str, variable: str) -> None:
    for key, coefficients in (("num", num), ("den", den)):
        if len(coefficients) > MAX_ORDER + 1:
            raise DocumentError(
                f"{source}: {key}: {len(coefficients)} coefficients are order {len(coefficients) - 1}; the "
                f"largest order is {MAX_ORDER}: identify a model of lower order"
            )
        for i, coefficient in enumerate(coefficients):
            if coefficient and not MIN_COEFFICIENT <= abs(coefficient) <= MAX_COEFFICIENT:
                raise DocumentError(
                    f"{source}: {key}[{i}]: {coefficient:g} is neither 0 nor between {MIN_COEFFICIENT:g} and "
                    f"{MAX_COEFFICIENT:g}: scale num and den by a common factor"
                )
    if not any(den):
        raise DocumentError(f"{source}: den: all coefficients are 0; give the denominator of the model")
    if not any(num):
        raise DocumentError(f"{source}: num: the plant's gain is 0; no controller can act through it")
    above, below = len(np.trim_zeros(num, "f")) - 1, len(np.trim_zeros(den, "f")) - 1
    if above > below:
        raise DocumentError(
            f"{source}: num has degree {above}, den {below}: the model is improper and would respond before "
            f"its input; check the order of the coefficients (falling powers of {variable})"
        )


def _check_covariance(covariance: Covariance, source: str) -> None:
    n = len(covariance.parameters)
    if n == 0 or n != len(set(covariance.parameters)):
        raise DocumentError(f"{source}.parameters: give the name of each parameter once")
    if len(covariance.matrix) != n or any(len(row) != n for row in covariance.matrix):
        raise DocumentError(f"{source}.matrix: it must have {n} rows of {n} numbers, one for each parameter")
    matrix = np.array(covariance.matrix)
    size = np.sqrt(np.abs(np.outer(np.diag(matrix), np.diag(matrix))))
    if (np.abs(matrix - matrix.T) > _COVARIANCE_ROUNDING * size).any():
        raise DocumentError(f"{source}.matrix: it is not symmetric, so it is no covariance")
    scaled = matrix / np.where(size > 0.0, size, 1.0)
    if (np.diag(matrix) < 0.0).any() or np.linalg.eigvalsh(scaled).min() < -_COVARIANCE_ROUNDING:
        raise DocumentError(f"{source}.matrix: it has a negative eigenvalue, so it is no covariance")


def _is_sha256(text: str) -> bool:
    return len(text) == 64 and all(character in "0123456789abcdef" for character in text)
