"""A model's poles and gain: can a sampled record show them, are they determined, are they what is known?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from design.identification.analysis.uncertainty import Properties, response_band
from design.identification.checks.expectations import Expectations
from design.identification.estimators.estimate import Estimate
from design.identification.findings import Finding, Kind, Severity
from design.identification.models.model import logarithms

MAX_UNCERTAINTY = 0.3
"""Standard deviation of a gain or pole, as a share of it, above which it is reported."""
REFUSED_UNCERTAINTY = 0.2
"""Smallest standard deviation of the frequency response, as a share of it, above which no model is given."""
SLOWEST_USEFUL = 0.003
"""Fastest pole times the sample time, below which a record is sampled far too fast."""
NEAR_NYQUIST = 0.8
"""Share of half the sampling frequency from which a lightly damped mode may be an alias."""
LIGHT_DAMPING = 0.3
"""Damping ratio below which a mode counts as lightly damped."""
GAIN_FACTORS = {
    1000.0: "y in thousandths of its unit?",
    100.0: "y in hundredths of its unit?",
    180.0 / np.pi: "y in degrees instead of rad?",
    0.001: "u in thousandths of its unit?",
    -1.0: "actuator or sensor connected the other way round?",
}
"""Ratio of the gain to the known one, and what would explain it."""
TIME_FACTORS = (1e-3, 1.0 / 60.0, 0.1, 0.5, 2.0, 10.0, 60.0, 1e3)
"""Ratios of the speed to the known one that a wrong sample time explains."""
MAX_GAIN_CHANGE = 3.0
"""Ratio of the gain to the known one, or its inverse, above which the gain is reported without a reason."""
_AGREEMENT = 0.25
"""Relative difference up to which a ratio counts as one of these."""


def check_time_scale(estimate: Estimate) -> Iterator[Finding]:
    """Find poles that are much slower than the sampling, or too fast for it."""
    model, name = estimate.discrete, estimate.experiments[0].name
    T = model.sample_time_s
    poles = logarithms(model.f, T)
    fastest = float(np.abs(poles).max(initial=0.0))
    if 0.0 < fastest * T < SLOWEST_USEFUL:
        yield Finding(
            kind=Kind.SAMPLE_TIME,
            severity=Severity.WARN,
            record=name,
            signal="sample time",
            figure=T,
            limit=SLOWEST_USEFUL / fastest,
            unit="s",
            text=(
                f"{T:.4g} s is very short beside the plant's fastest time constant, {1.0 / fastest:.4g} s "
                f"(usual is {SLOWEST_USEFUL / fastest:.4g} s or more)"
            ),
            remedy="check the unit of the sample time (seconds), or average the record",
        )
    limit = NEAR_NYQUIST * np.pi / T
    for s in poles:
        if s.imag > limit and -s.real < LIGHT_DAMPING * abs(s):
            yield Finding(
                kind=Kind.SAMPLE_TIME,
                severity=Severity.WARN,
                record=name,
                signal="sample time",
                figure=float(s.imag),
                limit=limit,
                unit="rad/s",
                text=(
                    f"a mode at {s.imag:.4g} rad/s lies close to half the sampling frequency, "
                    f"{np.pi / T:.4g} rad/s: it may be the image of a faster one"
                ),
                remedy="sample faster, or filter the sensor before it is sampled",
            )


def check_uncertainty(estimate: Estimate, properties: Properties) -> Iterator[Finding]:
    """Find a gain or poles that the record does not determine."""
    first = estimate.experiments[0]
    best_known = _best_known(estimate)
    if not best_known <= REFUSED_UNCERTAINTY:
        yield Finding(
            kind=Kind.UNCERTAIN,
            severity=Severity.REFUSE,
            record=first.name,
            signal=f"{first.names.u} to {first.names.y}",
            figure=100.0 * best_known,
            limit=100.0 * REFUSED_UNCERTAINTY,
            unit="%",
            text=(
                f"at no frequency is the response known better than to {100.0 * best_known:.3g} % (limit "
                f"{100.0 * REFUSED_UNCERTAINTY:g} %)"
            ),
            remedy=(
                f"check that {first.names.u} acts on {first.names.y}; if {first.names.y} drifts, estimate "
                "the drift; record longer, or raise the amplitude"
            ),
        )
        return
    values = [
        ("pole", abs(root.value), root.std, " rad/s") for root in properties.poles if root.value.imag >= 0.0
    ]
    gain = properties.velocity_gain or properties.gain
    if gain is not None:
        values.insert(0, ("gain", abs(gain.value), gain.std, ""))
    for what, size, std, unit in values:
        percent = 100.0 * std / size if size else np.inf
        if percent > 100.0 * MAX_UNCERTAINTY:
            yield Finding(
                kind=Kind.UNCERTAIN,
                severity=Severity.WARN,
                record=first.name,
                signal=f"{what} {size:.4g}{unit}",
                figure=percent,
                limit=100.0 * MAX_UNCERTAINTY,
                unit="%",
                text=(
                    f"its standard deviation is {percent:.3g} % of it (limit {100.0 * MAX_UNCERTAINTY:g} "
                    "%): too little excitation"
                ),
                remedy=(
                    "record longer, excite at this frequency, raise the amplitude, or choose a smaller "
                    "structure"
                ),
            )


def _best_known(estimate: Estimate) -> float:
    """Return the smallest standard deviation of the frequency response, as a share of it."""
    T = estimate.discrete.sample_time_s
    longest = max(map(len, estimate.experiments))
    band = response_band(estimate, np.geomspace(2.0 * np.pi / (longest * T), 0.9 * np.pi / T, 50))
    return float(np.min(band.magnitude_std))


def check_known_plant(
    estimate: Estimate, properties: Properties, expected: Expectations
) -> Iterator[Finding]:
    """Find a gain or speed that differs from the known plant's by a factor that a wrong unit explains."""
    if expected.plant is None:
        return
    first, T = estimate.experiments[0], estimate.discrete.sample_time_s
    ratio = estimate.discrete.gain / expected.plant.gain if expected.plant.gain else np.nan
    reason = _reason_of_gain(ratio)
    if reason:
        yield Finding(
            kind=Kind.UNITS,
            severity=Severity.WARN,
            record=first.name,
            signal=first.names.y,
            figure=ratio,
            limit=1.0,
            unit="",
            text=f"the gain is {ratio:.4g} times that of the known plant",
            remedy=f"check: {reason}",
        )
    before = np.sort(np.abs(expected.plant.poles))
    after = np.sort([abs(root.value) for root in properties.poles])
    if len(before) != len(after) or not (before > 0.0).all():
        return
    speed = float(np.median(after / before))
    if any(abs(speed / factor - 1.0) < _AGREEMENT for factor in TIME_FACTORS):
        yield Finding(
            kind=Kind.SAMPLE_TIME,
            severity=Severity.WARN,
            record=first.name,
            signal="sample time",
            figure=speed,
            limit=1.0,
            unit="",
            text=f"with a sample time of {T:g} s the plant is {speed:.4g} times as fast as the known one",
            remedy="check the sample time and its unit (seconds)",
        )


def _reason_of_gain(ratio: float) -> str:
    """What explains this ratio of the gain to the known one. Empty if the ratio is not surprising."""
    for factor, reason in GAIN_FACTORS.items():
        if abs(ratio / factor - 1.0) < _AGREEMENT:
            return reason
    if 1.0 / MAX_GAIN_CHANGE < ratio < MAX_GAIN_CHANGE or np.isnan(ratio):
        return ""
    return "units, signs and channels of both signals; is it the same plant?"
