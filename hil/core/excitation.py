"""Excitation signals for identification: valve voltages or setpoint offsets, one value a period.

==============  ===========================================================================================
``prbs``        Pseudo-random binary sequence, ±amplitude. It changes at most every ``clock_periods`` periods.
                With ``levels`` of 3, 5 or 7 it is a multi-level pseudo-random sequence. Both are maximum
                length sequences over GF(levels) (Golomb, *Shift Register Sequences*, 1967).
``multisine``   A sum of sines of equal amplitude on the lines of a band. The signal repeats, so that a
                spectrum of whole repetitions has no leakage (Pintelon and Schoukens, *System Identification*,
                2012, ch. 5). Phases are random or Schroeder's.
``chirp``       A sine whose frequency sweeps over a band, linearly or logarithmically, once.
``steps``       A staircase +amplitude, 0, -amplitude, 0, each held for ``hold_s``.
``csv``         A table of columns time_s,value; each value is held until the next row.
==============  ===========================================================================================

All values are deviations: volts about the voltage at which the axis stands still, or, where the setpoint is
excited, the axis' unit about its centre. Random choices come from ``random.Random(seed)``, whose stream does
not change between Python versions.
"""

from __future__ import annotations

import math
from itertools import product
from random import Random
from typing import Annotated, Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from hil.core.documents import Document
from hil.core.errors import DocumentError

Array: TypeAlias = NDArray[np.float64]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Seed = Annotated[int, msgspec.Meta(ge=0, le=2**32)]

DECIMALS = 9
"""Digits of a value after the decimal point."""
MAX_SAMPLES = 2_000_000
"""Longest excitation in periods: six hours at 0.0112 s."""


class Prbs(Document, frozen=True, tag_field="kind", tag="prbs"):
    """A maximum length sequence of two or more levels."""

    amplitude: Positive
    duration_s: Positive
    clock_periods: Annotated[int, msgspec.Meta(ge=1, le=10_000)] = 12
    """The value may change every so many periods. Power is flat up to about 0.44/(clock_periods Ts) Hz."""
    levels: Literal[2, 3, 5, 7] = 2
    seed: Seed = 1


class Multisine(Document, frozen=True, tag_field="kind", tag="multisine"):
    """A periodic sum of sines on all lines between two frequencies."""

    amplitude: Positive
    """Largest absolute value of the sum."""
    duration_s: Positive
    low_rad_s: Positive = 0.2
    high_rad_s: Positive = 40.0
    repetitions: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 2
    """Whole repetitions within the duration. Lines are 2 pi repetitions/duration apart, in rad/s."""
    phases: Literal["random", "schroeder"] = "schroeder"
    seed: Seed = 1


class Chirp(Document, frozen=True, tag_field="kind", tag="chirp"):
    """A sine whose frequency moves from ``low_rad_s`` to ``high_rad_s`` within the duration."""

    amplitude: Positive
    duration_s: Positive
    low_rad_s: Positive = 0.2
    high_rad_s: Positive = 40.0
    sweep: Literal["linear", "logarithmic"] = "logarithmic"


class Steps(Document, frozen=True, tag_field="kind", tag="steps"):
    """A staircase: +amplitude, 0, -amplitude, 0, and again."""

    amplitude: Positive
    duration_s: Positive
    hold_s: Positive = 2.0


class Table(Document, frozen=True, tag_field="kind", tag="csv"):
    """Values from a CSV file; the times start at 0 and increase."""

    file: str
    time_s: list[float]
    value: list[float]


Signal: TypeAlias = Prbs | Multisine | Chirp | Steps | Table
KINDS: dict[str, type[Document]] = {
    "prbs": Prbs,
    "multisine": Multisine,
    "chirp": Chirp,
    "steps": Steps,
    "csv": Table,
}


def samples(signal: Signal, period_s: float) -> Array:
    """Return the values of ``signal``, one a period of ``period_s`` seconds, shape (n,).

    Raises DocumentError where the signal does not fit the sample time: a band beyond the Nyquist frequency, a
    multisine without a line, a duration under one clock.
    """
    match signal:
        case Prbs():
            values = _prbs(signal, period_s)
        case Multisine():
            values = _multisine(signal, period_s)
        case Chirp():
            values = _chirp(signal, period_s)
        case Steps():
            n = _periods(signal.duration_s, period_s)
            pattern = signal.amplitude * np.array([1.0, 0.0, -1.0, 0.0])
            values = pattern[(np.arange(n) * period_s / signal.hold_s + 1e-9).astype(int) % 4]
        case Table():
            values = _table(signal, period_s)
    return np.round(values, DECIMALS)  # a replay on another machine must get the same values


class SpectrumSummary(NamedTuple):
    """What a record of excitation excites."""

    peak: float
    """Largest absolute value."""
    rms: float
    """Root mean square about the mean."""
    crest_factor: float
    """Largest deviation from the mean, divided by the rms: 1 for a square wave, 1.41 for a sine."""
    low_rad_s: float
    """A twentieth of the power lies at lower frequencies, the mean left out."""
    high_rad_s: float
    """A twentieth of the power lies at higher frequencies."""


def summarise_spectrum(values: Array, period_s: float) -> SpectrumSummary:
    """Return peak, rms, crest factor and the band that holds 90 % of the power of ``values`` (n,)."""
    deviation = values - values.mean()
    rms = float(np.sqrt(np.mean(deviation**2)))
    power = np.abs(np.fft.rfft(deviation)) ** 2
    share = np.cumsum(power) / max(float(power.sum()), 1e-300)
    omega = 2.0 * np.pi * np.fft.rfftfreq(len(values), period_s)
    low, high = (float(omega[min(int(np.searchsorted(share, s)), len(omega) - 1)]) for s in (0.05, 0.95))
    crest = float(np.max(np.abs(deviation))) / rms if rms > 0.0 else math.inf
    return SpectrumSummary(float(np.max(np.abs(values))), rms, crest, low, high)


def band_power(values: Array, period_s: float, edges_rad_s: Array) -> Array:
    """Return the share of the power of ``values`` (n,) between each two of the (m + 1,) edges, shape (m,)."""
    power = np.abs(np.fft.rfft(values - values.mean())) ** 2
    omega = 2.0 * np.pi * np.fft.rfftfreq(len(values), period_s)
    found, _ = np.histogram(omega, bins=edges_rad_s, weights=power)
    return np.asarray(found / max(float(power.sum()), 1e-300), dtype=np.float64)


def read_table(text: str, file: str) -> Table:
    """Read a CSV of columns time_s,value; a header is optional. Raises DocumentError naming file and row."""
    times: list[float] = []
    values: list[float] = []
    for number, line in enumerate(text.splitlines(), start=1):
        cells = [cell.strip() for cell in line.split(",")]
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            time_s, value = (float(cell) for cell in cells)
        except ValueError:
            if not times and not any(_is_number(cell) for cell in cells):
                continue  # a header
            raise DocumentError(
                f"{file}: row {number}: {line.strip()!r} is not time_s,value: two numbers"
            ) from None
        if not (math.isfinite(time_s) and math.isfinite(value)):
            raise DocumentError(f"{file}: row {number}: {line.strip()!r} is not finite")
        if times and time_s <= times[-1]:
            raise DocumentError(
                f"{file}: row {number}: time {time_s:g} s does not come after {times[-1]:g} s; sort the rows"
            )
        times.append(time_s)
        values.append(value)
    if len(times) < 2:
        raise DocumentError(f"{file}: {len(times)} rows of time_s,value; at least 2 are needed")
    if times[0] != 0.0:
        raise DocumentError(f"{file}: the first row is at {times[0]:g} s; the times must start at 0")
    return Table(file=file, time_s=times, value=values)


def m_sequence(base: int, length: int, seed: int) -> list[int]:
    """Return ``length`` digits 0 … base - 1 of a maximum length sequence over GF(``base``), base prime.

    The register is just long enough that the sequence does not repeat within ``length`` digits. ``seed``
    chooses where in the period it starts.
    """
    degree = 2
    while base**degree - 1 < length:
        degree += 1
    taps = _primitive_recurrence(base, degree)
    random = Random(seed)
    register = [random.randrange(base) for _ in range(degree)]
    if not any(register):
        register[-1] = 1
    digits = []
    for _ in range(length):
        digits.append(register[0])
        fed_back = sum(tap * digit for tap, digit in zip(taps, register, strict=True)) % base
        register = [*register[1:], fed_back]
    return digits


def _periods(duration_s: float, period_s: float) -> int:
    """Return the number of periods in a duration. Raises DocumentError for none, or too many."""
    count = round(duration_s / period_s) if math.isfinite(duration_s) and duration_s < 1e9 else 0
    if not 2 <= count <= MAX_SAMPLES:
        raise DocumentError(
            f"excitation: duration {duration_s:g} s is {count} periods of {period_s:g} s; "
            f"give 2 to {MAX_SAMPLES} periods"
        )
    return count


def _prbs(signal: Prbs, period_s: float) -> Array:
    count = _periods(signal.duration_s, period_s)
    digits = m_sequence(signal.levels, -(-count // signal.clock_periods), signal.seed)
    half = (signal.levels - 1) / 2.0
    levels = signal.amplitude * (np.array(digits, dtype=np.float64) - half) / half
    return np.repeat(levels, signal.clock_periods)[:count]


def _multisine(signal: Multisine, period_s: float) -> Array:
    _check_band(signal.low_rad_s, signal.high_rad_s, period_s)
    per_repetition = _periods(signal.duration_s / signal.repetitions, period_s)
    spacing = 2.0 * math.pi / (per_repetition * period_s)
    first = math.ceil(signal.low_rad_s / spacing - 1e-9)
    last = min(math.floor(signal.high_rad_s / spacing + 1e-9), (per_repetition - 1) // 2)
    if last < first:
        raise DocumentError(
            f"excitation: no line between {signal.low_rad_s:g} and {signal.high_rad_s:g} rad/s: lines are "
            f"{spacing:g} rad/s apart; lengthen the duration or widen the band"
        )
    count = last - first + 1
    if signal.phases == "schroeder":
        phases = np.array([-math.pi * k * (k - 1) / count for k in range(1, count + 1)])
    else:
        random = Random(signal.seed)
        phases = np.array([random.uniform(0.0, 2.0 * math.pi) for _ in range(count)])
    spectrum = np.zeros(per_repetition // 2 + 1, dtype=np.complex128)
    spectrum[first : last + 1] = np.exp(1j * phases)
    once = np.fft.irfft(spectrum, per_repetition)
    return np.tile(once * (signal.amplitude / np.max(np.abs(once))), signal.repetitions)


def _chirp(signal: Chirp, period_s: float) -> Array:
    _check_band(signal.low_rad_s, signal.high_rad_s, period_s)
    count = _periods(signal.duration_s, period_s)
    t, total = np.arange(count) * period_s, count * period_s
    low, high = signal.low_rad_s, signal.high_rad_s
    if signal.sweep == "linear":
        angle = low * t + 0.5 * (high - low) * t * t / total
    else:
        ratio = math.log(high / low)
        angle = low * total / ratio * np.expm1(ratio * t / total)
    return np.asarray(signal.amplitude * np.sin(angle), dtype=np.float64)


def _table(signal: Table, period_s: float) -> Array:
    if len(signal.time_s) != len(signal.value) or len(signal.time_s) < 2:
        raise DocumentError("excitation: time_s and value must have the same length, at least 2")
    if not all(math.isfinite(number) for number in (*signal.time_s, *signal.value)):
        raise DocumentError("excitation: time_s and value must be finite")
    if any(after <= before for before, after in zip(signal.time_s, signal.time_s[1:], strict=False)):
        raise DocumentError("excitation: time_s must increase")
    count = _periods(signal.time_s[-1], period_s)
    # A billionth of a period, so that a row is read in the period that it names.
    rows = np.searchsorted(np.array(signal.time_s), (np.arange(count) + 1e-9) * period_s, side="right") - 1
    return np.array(signal.value)[np.maximum(rows, 0)]


def _check_band(low_rad_s: float, high_rad_s: float, period_s: float) -> None:
    nyquist = math.pi / period_s
    if not low_rad_s < high_rad_s:
        raise DocumentError(f"excitation: band {low_rad_s:g} to {high_rad_s:g} rad/s is empty")
    if high_rad_s >= nyquist:
        raise DocumentError(
            f"excitation: band end {high_rad_s:g} rad/s is not under the Nyquist frequency "
            f"{nyquist:.1f} rad/s of the sample time {period_s:g} s"
        )


def _primitive_recurrence(base: int, degree: int) -> tuple[int, ...]:
    """Return taps c of s[k + n] = sum c[i] s[k + i] mod base whose sequences have period base^n - 1.

    The characteristic polynomial is then primitive: the order of x modulo it is exactly base^n - 1 (Lidl and
    Niederreiter, *Finite Fields*, 1997, theorem 3.16). The first such polynomial in counting order is taken.
    """
    order = base**degree - 1
    factors = _prime_factors(order)
    one = [1] + [0] * (degree - 1)
    for taps in product(range(base), repeat=degree):
        if taps[0] == 0:
            continue
        if _power_of_x(order, taps, base) == one and all(
            _power_of_x(order // factor, taps, base) != one for factor in factors
        ):
            return taps
    raise AssertionError("every field has a primitive polynomial of every degree")


def _power_of_x(exponent: int, taps: tuple[int, ...], base: int) -> list[int]:
    """Return x^exponent modulo x^n - sum taps[i] x^i over GF(base), coefficients in rising powers."""
    n = len(taps)
    result, square = [1] + [0] * (n - 1), [0, 1] + [0] * (n - 2)
    while exponent:
        if exponent & 1:
            result = _multiply(result, square, taps, base)
        square = _multiply(square, square, taps, base)
        exponent >>= 1
    return result


def _multiply(a: list[int], b: list[int], taps: tuple[int, ...], base: int) -> list[int]:
    n = len(taps)
    full = [0] * (2 * n - 1)
    for i, x in enumerate(a):
        if x:
            for j, y in enumerate(b):
                full[i + j] += x * y
    for power in range(2 * n - 2, n - 1, -1):
        carried = full[power] % base
        for i, tap in enumerate(taps):
            full[power - n + i] += carried * tap
    return [coefficient % base for coefficient in full[:n]]


def _prime_factors(number: int) -> set[int]:
    found, divisor = set(), 2
    while divisor * divisor <= number:
        while number % divisor == 0:
            found.add(divisor)
            number //= divisor
        divisor += 1
    return found | ({number} if number > 1 else set())


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
