"""Frequency responses measured without a model, with coherence, to draw behind every parametric one.

Three methods. Averaged spectra (Welch) suit long records of noise-like inputs. The local rational method
(McKelvey and Guérin, 2012), which extends the local polynomial one (Pintelon and Schoukens, System
Identification, 2nd ed., chapter 7), fits Y D = U N + T in a window around each frequency: response N/D and
the transient T of the unknown past are smooth functions of frequency. It resolves much lower frequencies,
and a slow pole does not bias it. The exact lines of a periodic input are the ratio of its Fourier
coefficients, averaged over periods.

All responses lead from the held input to the sampled output, as that of a ``DiscreteModel`` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.fft import rfft

from design.errors import DesignError
from design.identification.records.experiment import Experiment, runs
from design.mathematics.polynomials import Array, ComplexArray

POINTS = 200
"""Number of frequencies of the local rational method."""
WINDOW_SHARE = 0.15
"""Width of a local window as a share of its frequency, once that holds more lines than are needed."""
MAX_LINES = 448
"""Largest number of lines in a local window."""
SHORTEST_RUN = 64
"""Number of samples without a gap below which a run is not used."""
_POLYNOMIAL = 3
"""Number of coefficients of the local polynomials N and T. D has one beside its leading 1."""
_LOCAL_UNKNOWNS = 2 * _POLYNOMIAL + 1
_SPARE_LINES = 6
"""Number of lines in a local window beyond the unknowns, from which the noise is estimated."""


class Method(StrEnum):
    """How a response was measured."""

    AVERAGED_SPECTRA = "averaged spectra"
    LOCAL_RATIONAL = "local rational"
    PERIODIC_LINES = "lines of a periodic input"


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """A measured frequency response, arrays (k,)."""

    method: Method
    omega_rad_s: Array
    response: ComplexArray
    coherence: Array
    """Share of the output's power at a frequency that the input explains, 0 to 1."""
    std: Array
    """Standard deviation of the response, of its real and of its imaginary part alike."""


def frequency_response(
    experiments: Sequence[Experiment], *, period_samples: int | None = None
) -> FrequencyResponse:
    """Measure the response by the method that suits the records.

    ``period_samples`` is the period of a periodic input; its exact lines are used. Raises DesignError where
    no run without a gap is long enough.
    """
    if period_samples is not None:
        return periodic_lines(experiments, period_samples)
    return local_rational(experiments)


def averaged_spectra(
    experiments: Sequence[Experiment], segment_samples: int | None = None
) -> FrequencyResponse:
    """Measure the response by Welch's method: Hann windows that overlap by half, each without its mean.

    By default a segment is an eighth of the samples. Raises DesignError where fewer than two segments fit
    between the gaps.
    """
    parts = _runs(experiments)
    length = segment_samples or max(SHORTEST_RUN, sum(len(u) for u, _ in parts) // 8)
    segments = [
        (u[start : start + length], y[start : start + length])
        for u, y in parts
        for start in range(0, len(u) - length + 1, max(length // 2, 1))
    ]
    if len(segments) < 2:
        raise DesignError(
            f"averaged spectra: {len(segments)} segments of {length} samples without a gap; 2 are needed"
        )
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(length) + 0.5) / length)
    U, Y = (
        rfft([window * (part - part.mean()) for part in side], axis=-1)
        for side in zip(*segments, strict=True)
    )
    keep = slice(1, (length + 1) // 2)
    uu = np.sum(np.abs(U) ** 2, axis=0)[keep]
    yy = np.sum(np.abs(Y) ** 2, axis=0)[keep]
    yu = np.sum(Y * np.conj(U), axis=0)[keep]
    excited = uu > 1e-12 * uu.max(initial=0.0)
    uu, yy, yu = uu[excited], yy[excited], yu[excited]
    omega = (2.0 * np.pi * np.arange(length // 2 + 1)[keep] / length / experiments[0].sample_time_s)[excited]
    coherence = np.clip(np.abs(yu) ** 2 / np.maximum(uu * yy, np.finfo(float).tiny), 0.0, 1.0)
    # Overlapping Hann windows are correlated by 1/6; k of them count as 18/19 k.
    independent = len(segments) * 18.0 / 19.0 if len(segments) > 2 else float(len(segments))
    G = yu / uu
    noise = (1.0 - coherence) * yy / len(segments) * independent / max(independent - 1.0, 1.0)
    variance = noise / uu * len(segments) / independent
    return FrequencyResponse(Method.AVERAGED_SPECTRA, omega, G, coherence, np.sqrt(0.5 * variance))


def local_rational(experiments: Sequence[Experiment], points: int = POINTS) -> FrequencyResponse:
    """Measure the response by the local rational method, at frequencies spread evenly over the logarithm.

    Runs are averaged by their variances. Raises DesignError where no run is long enough.
    """
    parts = _runs(experiments)
    T = experiments[0].sample_time_s
    longest = max(len(u) for u, _ in parts)
    lines = _LOCAL_UNKNOWNS + _SPARE_LINES + 1
    if longest < 4 * lines:
        raise DesignError(
            f"local rational: the longest run without a gap has {longest} samples; {4 * lines} are needed"
        )
    lowest, highest = 2.0 * np.pi / (longest * T), np.pi / T * (1.0 - 1.0 / longest)
    omega = np.geomspace(lowest, highest, points)
    weight, explained, power = np.zeros((3, points))
    total = np.zeros(points, dtype=np.complex128)
    for u, y in parts:
        if len(u) < 4 * lines:
            continue
        G, variance, own_explained, own_power = _local_fits(u, y, omega * T * len(u) / (2.0 * np.pi), lines)
        share = 1.0 / np.maximum(variance, np.finfo(float).tiny)
        weight, total = weight + share, total + share * G
        explained, power = explained + own_explained, power + own_power
    coherence = np.clip(explained / np.maximum(power, np.finfo(float).tiny), 0.0, 1.0)
    return FrequencyResponse(Method.LOCAL_RATIONAL, omega, total / weight, coherence, np.sqrt(0.5 / weight))


def periodic_lines(experiments: Sequence[Experiment], period_samples: int) -> FrequencyResponse:
    """Measure the response at the lines of an input with this period in samples.

    The first period of each run is left out if there are three or more, for its transient. The noise is the
    scatter between periods. Raises DesignError where no run has two periods.
    """
    spectra = []
    for u, y in _runs(experiments):
        periods = len(u) // period_samples
        first = 1 if periods >= 3 else 0
        if periods - first >= 1:
            block = [
                x[first * period_samples : periods * period_samples].reshape(-1, period_samples)
                for x in (u, y)
            ]
            spectra.append([rfft(part, axis=-1)[:, 1 : (period_samples + 1) // 2] for part in block])
    count = sum(len(U) for U, _ in spectra)
    if count < 2:
        raise DesignError(
            f"periodic lines: {count} whole periods of {period_samples} samples without a gap; 2 are needed"
        )
    U = np.concatenate([U for U, _ in spectra])
    Y = np.concatenate([Y for _, Y in spectra])
    input_line = U.mean(axis=0)
    excited = np.abs(input_line) > 1e-6 * np.abs(input_line).max(initial=0.0)
    omega = (
        2.0 * np.pi * np.arange(1, (period_samples + 1) // 2) / period_samples / experiments[0].sample_time_s
    )
    U, Y, input_line = U[:, excited], Y[:, excited], input_line[excited]
    mean = Y.mean(axis=0)
    G = mean / input_line
    scatter = np.sum(np.abs(Y - G * U) ** 2, axis=0) / max(count - 1, 1)
    signal = np.abs(mean) ** 2
    return FrequencyResponse(
        Method.PERIODIC_LINES,
        omega[excited],
        G,
        signal / np.maximum(signal + scatter, np.finfo(float).tiny),
        np.sqrt(0.5 * scatter / count) / np.abs(input_line),
    )


def _runs(experiments: Sequence[Experiment]) -> list[tuple[Array, Array]]:
    """Return the inputs and outputs of all runs without a gap. Raises DesignError where there is none."""
    found = []
    for experiment in experiments:
        for first, last in runs(experiment.observed & np.isfinite(experiment.u)):
            if last - first >= SHORTEST_RUN:
                found.append((experiment.u[first:last], experiment.y[first:last]))
    if not found:
        raise DesignError(
            f"frequency response: no run of {SHORTEST_RUN} samples without a gap; record without gaps"
        )
    return found


def _local_fits(u: Array, y: Array, at: Array, fewest: int) -> tuple[ComplexArray, Array, Array, Array]:
    """Return the response, its variance, and the explained and total power of y at the lines ``at`` (k,).

    The window grows with the frequency, so that a long record gives a smooth response.
    """
    U, Y = rfft(u - u.mean()), rfft(y - y.mean())
    doublings = np.floor(np.log2(np.clip(WINDOW_SHARE * at / fewest, 1.0, MAX_LINES / fewest)))
    found = np.zeros((4, len(at)), dtype=np.complex128)
    for doubling in np.unique(doublings):
        own = doublings == doubling
        found[:, own] = _rational_fit(U, Y, at[own], fewest << int(doubling))
    return found[0], *found[1:].real


def _rational_fit(U: ComplexArray, Y: ComplexArray, at: Array, lines: int) -> ComplexArray:
    """Return the same quantities as rows (4, k), from windows of one number of lines."""
    # Line 0 is lost with the mean.
    first = np.clip(np.rint(at).astype(int) - lines // 2, 1, len(U) - lines)
    index = first[:, None] + np.arange(lines)
    scale = 0.5 * lines
    powers = ((index - at[:, None]) / scale)[..., None] ** np.arange(_POLYNOMIAL)
    rows = np.concatenate(
        [U[index][..., None] * powers, powers, -Y[index][..., None] * powers[..., 1:2]], axis=-1
    )
    sizes = np.linalg.norm(rows, axis=1)
    rows = rows / np.maximum(sizes, np.finfo(float).tiny)[:, None]
    left, singular, right = np.linalg.svd(rows, full_matrices=False)
    inverse = np.where(singular > 1e-10 * singular[:, :1], 1.0 / np.maximum(singular, 1e-300), 0.0)
    solved = (np.conj(np.swapaxes(left, 1, 2)) @ Y[index][..., None])[..., 0]
    coefficients = (np.conj(np.swapaxes(right, 1, 2)) @ (inverse * solved)[..., None])[..., 0] / sizes
    # The first row of the inverse's Gram matrix: variance of the response for noise of variance 1.
    spread = np.sum(np.abs(np.conj(right[:, :, 0]) * inverse) ** 2, axis=1) / sizes[:, 0] ** 2
    residual = Y[index] - (left @ solved[..., None])[..., 0]
    noise = np.sum(np.abs(residual) ** 2, axis=1) / (lines - _LOCAL_UNKNOWNS)
    G = coefficients[:, 0]
    explained = np.sum(np.abs(U[index] * (powers @ coefficients[:, :_POLYNOMIAL, None])[..., 0]) ** 2, axis=1)
    return np.stack([G, spread * noise, explained / lines, explained / lines + noise])
