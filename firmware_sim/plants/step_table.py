"""Exact steps of a transfer function under a constant input, for any duration in nanoseconds.

The transfer function is realised as x' = A x + B u, y = C x + D u. If u is constant for a time h,

    x(t + h) = x(t) + Ea(h) x(t) + Eb(h) u,    y(t + h) = C x(t + h) + D u,
    Ea(h) = exp(A h) - I,    Eb(h) = integral of exp(A t) B from t = 0 to h.

A *step* has Ea, Eb and the coefficients of y(t + h) for one duration. The table has a step for each digit of
a hexadecimal number of nanoseconds. So a duration that was never seen before, as in real time, costs a few
products of a matrix and a vector, and no matrix exponential.

A step holds Ea and not exp(A h), because exp(A h) is close to the identity matrix for a short time and the
difference would lose its digits. Two steps are composed as E(g + h) = E(g) + E(h) + E(g) E(h), which keeps
them.

Only + - * / are used, in a fixed order, so a run gives the same bytes on every machine. ``sum`` is not used,
because its rounding depends on the version of Python.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, Final, TypeAlias

from firmware_sim.plants.linear_model import LinearModel

Step: TypeAlias = tuple[float, ...]
"""The n rows of [Ea | Eb], then [C + C Ea | C Eb + D]: (n + 1)^2 numbers for order n."""
State: TypeAlias = Sequence[float]
Rows: TypeAlias = list[list[float]]
"""The n rows of [Ea | Eb] of one duration."""

MAX_ORDER: Final = 20
"""Largest order of a model."""
MAX_RATE_RAD_S: Final = 1e8
"""Limit of the bound of the poles' magnitude. Beyond it a nanosecond is not short."""

_BASE: Final = 16
_DIGITS: Final = 9
"""Number of hexadecimal digits in the table: 16^9 ns are 69 s. A longer duration repeats the largest step."""
_TAYLOR_TERMS: Final = 12


@dataclass(frozen=True)
class StepTable:
    """The realisation of a model (without its dead time), and its steps."""

    order: int
    advance: Callable[[State, Step, float], tuple[State, float]]
    """Function (x, step, u) -> (x, y) at the end of the step."""
    _output: tuple[float, ...]
    """Output row [C | D] of the realisation."""
    _levels: tuple[tuple[Step, ...], ...]
    """Steps of 1 to 15 times 16^level nanoseconds, by level."""

    def steps(self, duration_ns: int) -> Iterator[Step]:
        """Return steps of the table whose durations add up to ``duration_ns``."""
        for level in self._levels[:-1]:
            duration_ns, digit = divmod(duration_ns, _BASE)
            if digit:
                yield level[digit - 1]
        while duration_ns:
            digit = min(duration_ns, _BASE - 1)
            yield self._levels[-1][digit - 1]
            duration_ns -= digit

    def step(self, duration_ns: int) -> Step:
        """Return one step of ``duration_ns``, which must not be 0."""
        width = self.order + 1
        first, *others = (
            [list(step[i : i + width]) for i in range(0, self.order * width, width)]
            for step in self.steps(duration_ns)
        )
        for other in others:
            first = _composed(first, other)
        return _flat(first, self._output)


@lru_cache(maxsize=32)
def step_table(model: LinearModel) -> StepTable:
    """Realise a model. Raises ValueError, which says what is wrong, for a model that cannot be simulated."""
    num, den, rate_rad_s = _scaled(model)
    order = len(den) - 1
    output = (*(num[k] - num[0] * den[k] for k in range(1, order + 1)), num[0])
    return StepTable(order, _unrolled(order), output, _levels(den, output, rate_rad_s))


def _scaled(model: LinearModel) -> tuple[Sequence[float], Sequence[float], float]:
    """Return num and monic den, of equal length, in powers of s/w, and w in rad/s.

    w is a power of 2, so scaling does not round. It is at least 1, and so large that no coefficient of the
    scaled den exceeds 1; then no pole is faster than 2 w.
    """
    num, den = _without_leading_zeros(model.num), _without_leading_zeros(model.den)
    if not den:
        raise ValueError("den: all coefficients are 0")
    if len(num) > len(den):
        raise ValueError(
            f"num has degree {len(num) - 1} and den has degree {len(den) - 1}: the degree of num must not "
            "exceed that of den (coefficients are in falling powers of s)"
        )
    if len(den) - 1 > MAX_ORDER:
        raise ValueError(f"den: degree {len(den) - 1} exceeds the limit of {MAX_ORDER}")
    num = (*(len(den) - len(num)) * (0.0,), *num)
    num, den = tuple(b / den[0] for b in num), tuple(a / den[0] for a in den)
    if not all(map(math.isfinite, (*num, *den))):
        raise ValueError(
            "num, den: a coefficient divided by the first one of den is too large for a floating-point number"
        )
    # |a| < 2^e for (m, e) = frexp(a), so |a|^(1/k) < 2^(e/k).
    exponent = max((0, *(-(-math.frexp(a)[1] // k) for k, a in enumerate(den) if k and a)))
    rate = math.ldexp(1.0, exponent)
    if rate > MAX_RATE_RAD_S:
        raise ValueError(
            f"den: a pole may be as fast as {rate:.1g} rad/s, beyond the limit of {MAX_RATE_RAD_S:g} rad/s; "
            "check the coefficients and their order (falling powers of s)"
        )
    return _in_powers_of(rate, num), _in_powers_of(rate, den), rate


def _in_powers_of(rate: float, coefficients: Sequence[float]) -> Sequence[float]:
    scaled, factor = [], 1.0
    for coefficient in coefficients:
        scaled.append(coefficient / factor)
        factor *= rate
    return scaled


def _without_leading_zeros(coefficients: Sequence[float]) -> tuple[float, ...]:
    first = next((k for k, coefficient in enumerate(coefficients) if coefficient), len(coefficients))
    return tuple(coefficients[first:])


def _levels(den: Sequence[float], output: Sequence[float], rate_rad_s: float) -> tuple[tuple[Step, ...], ...]:
    unit = _nanosecond(den, rate_rad_s)
    levels = []
    for _ in range(_DIGITS):
        steps = [unit]
        for digit in range(2, _BASE + 1):
            half = steps[digit // 2 - 1]
            double = _composed(half, half)
            steps.append(_composed(double, unit) if digit % 2 else double)
        unit = steps.pop()
        levels.append(tuple(_flat(rows, output) for rows in steps))
    return tuple(levels)


def _nanosecond(den: Sequence[float], rate_rad_s: float) -> Rows:
    """Return the step of one nanosecond, by its Taylor series.

    The realisation is the controllable canonical form in time units of 1/rate.
    """
    order = len(den) - 1
    h = 1e-9 * rate_rad_s
    generator = [[h if j == i - 1 else 0.0 for j in range(order + 1)] for i in range(order)]
    if generator:
        generator[0] = [*(-h * a for a in den[1:]), h]
    total = term = generator
    for k in range(2, _TAYLOR_TERMS + 1):
        term = [[value / k for value in row] for row in _product(generator, term)]
        total = [[a + b for a, b in zip(*rows, strict=True)] for rows in zip(total, term, strict=True)]
    return total


def _composed(first: Rows, second: Rows) -> Rows:
    """Return the step whose duration is the sum of both."""
    return [
        [a + b + c for a, b, c in zip(*rows, strict=True)]
        for rows in zip(first, second, _product(first, second), strict=True)
    ]


def _product(first: Rows, second: Rows) -> Rows:
    """Return the product [Ea1 Ea2 | Ea1 Eb2] of two steps."""
    product = []
    for row in first:
        out = [0.0] * len(row)
        for factor, other in zip(row[:-1], second, strict=True):
            for j, value in enumerate(other):
                out[j] += factor * value
        product.append(out)
    return product


def _flat(rows: Rows, output: Sequence[float]) -> Step:
    """Return the step with these rows of [Ea | Eb], for an output row [C | D]."""
    last = list(output)
    for c, row in zip(output[:-1], rows, strict=True):
        for j, value in enumerate(row):
            last[j] += c * value
    return (*(value for row in rows for value in row), *last)


@cache
def _unrolled(order: int) -> Callable[[State, Step, float], tuple[State, float]]:
    """Return the function (x, step, u) -> (x, y) at the end of the step.

    It is compiled from a text without loops, which is five times faster than loops over the numbers.
    """
    x = [f"x{i}" for i in range(order)]
    e = [[f"e{i}_{j}" for j in range(order + 1)] for i in range(order + 1)]
    *changes, output = (" + ".join(map(" * ".join, zip(row, [*x, "u"], strict=True))) for row in e)
    following = "".join(f"{before} + ({change}), " for before, change in zip(x, changes, strict=True))
    source = f"""
def advance(state, step, u):
    [{", ".join(x)}] = state
    [{", ".join(name for row in e for name in row)}] = step
    return ({following}), {output}
"""
    functions: dict[str, Any] = {}
    exec(source, functions)
    advance: Callable[[State, Step, float], tuple[State, float]] = functions["advance"]
    return advance
