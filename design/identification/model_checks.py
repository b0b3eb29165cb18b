"""What can be said against a model after it was fitted: its record may still be bad in ways that only a model shows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from design.errors import DesignError
from design.identification.covariance import noise_autoregression
from design.identification.dynamics_problem import DynamicsProblem, FreeNumerator
from design.identification.estimate import Estimate
from design.identification.experiment import Experiment
from design.identification.findings import Finding, Kind, Severity
from design.identification.levenberg_marquardt import minimise
from design.identification.models import DiscreteModel, logarithms
from design.identification.output_error import fit_output_error
from design.identification.pole_sections import PoleSections, from_poles
from design.identification.record_checks import Expectations
from design.identification.residuals import Correlation, ResidualAnalysis
from design.identification.simulation_error import Dynamics, SimulationError
from design.identification.stalls import find_stalls, noise_std, quantum
from design.identification.structures import Armax, Arx, BoxJenkins, ContinuousPoles, OutputError
from design.identification.uncertainty import Properties, response_band
from design.identification.validation import Comparison, compare, overall_fit

POOR_PERCENT = 70.0
"""Fit on validation data below which a model is reported as poor."""
REFUSED_PERCENT = 10.0
"""Fit on validation data below which no model is given."""
EXPLAINED_PERCENT = 90.0
"""Fit below which an error that the sensor does not explain is reported."""
MAX_NOISE_RATIO = 20.0
"""Ratio of the model's error to the sensor's noise above which it is reported."""
MAX_STALLED = 0.005
"""Share of clear motions of the model in which the output may stand still."""
REFUSED_STALLED = 0.3
"""Share of clear motions of the model without a motion of the output above which no model is given."""
MAX_DRIFT = 0.1
"""Drift over a record, as a share of the output's standard deviation, above which it is reported."""
DRIFT_SIGNIFICANCE = 4.0
"""Number of standard deviations of the drift's estimate above which it counts as real."""
MAX_UNCERTAINTY = 0.3
"""Standard deviation of a gain or pole, as a share of it, above which it is reported."""
MAX_FIT_LOSS = 10.0
"""Difference in per cent between the fits on estimation and validation data above which it is reported."""
MAX_MISSING_DYNAMICS = 0.15
"""Share of the error that earlier inputs explain above which the model is too far off to judge friction by it."""
ROUNDING = 1e-7
"""Ratio of the model's error to the output's standard deviation up to which the error is rounding."""
REFUSED_UNCERTAINTY = 0.2
"""Smallest standard deviation of the frequency response, as a share of it, above which no model is given."""
SLOWEST_USEFUL = 0.003
"""Fastest pole times the sample time below which the record is sampled far too fast, or its sample time is wrong."""
NEAR_NYQUIST = 0.8
"""Frequency of a lightly damped mode, as a share of half the sampling frequency, from which it may be an alias."""
MAX_DEAD_SAMPLES = 12
"""Largest dead time in samples that is looked for."""
MIN_IMPROVEMENT = 0.02
"""Share of the simulation error's variance that a dead time must remove to be suggested."""
MAX_LOST_PERCENT = 2.0
"""Fit in per cent that a missing dead time may cost before the model is doubtful."""


def check_model(
    estimate: Estimate,
    validation: Sequence[Comparison],
    analysis: ResidualAnalysis,
    properties: Properties,
    expected: Expectations,
    drift: bool,
) -> list[Finding]:
    """Findings about a model and its record."""
    stable = estimate.discrete.stable
    estimation = [compare(estimate.discrete, experiment, drift=drift) for experiment in estimate.experiments]
    found = list(_fit(estimate, estimation, validation)) if stable else []
    found += [
        *_search(estimate),
        *_stability(estimate),
        *_time_scale(estimate),
        *_uncertainty(estimate, properties),
        *_known_plant(estimate, properties, expected),
    ]
    if stable and not drift:
        found += _drift(estimate)
    if isinstance(estimate.structure, OutputError | ContinuousPoles) and _has_error(estimate):
        found += _dynamics(estimate, analysis, overall_fit(estimation))
        if _explained(analysis.from_input) < MAX_MISSING_DYNAMICS:
            found += _stalls([*estimation, *validation], expected)
    return found


def _search(estimate: Estimate) -> Iterator[Finding]:
    name = estimate.experiments[0].name
    if not estimate.converged:
        yield Finding(
            Kind.NOT_CONVERGED, Severity.WARN, name, str(estimate.structure), 0.0, 0.0, "",
            "the search for the parameters ended before it had converged",
            "choose a smaller structure, or record longer",
        )  # fmt: skip
    for parameter in estimate.at_bound:
        value = float(estimate.parameters.values[estimate.parameters.names.index(parameter)])
        yield Finding(
            Kind.SEARCH_BOUND, Severity.WARN, name, parameter, value, value, "",
            "it lies at a search bound",
            "choose a smaller structure: the record does not show this parameter",
        )  # fmt: skip


def _stability(estimate: Estimate) -> Iterator[Finding]:
    sizes = np.abs(estimate.discrete.poles_z)
    if len(sizes) and sizes.max() >= 1.0 + 1e-12:
        yield Finding(
            Kind.UNSTABLE, Severity.WARN, estimate.experiments[0].name, str(estimate.structure), float(sizes.max()), 1.0, "",
            f"the model is unstable: its largest pole has modulus {sizes.max():.6g} (limit 1). A free-running simulation "
            "cannot confirm it, only predictions can",
            "check it against a frequency response, or stabilise the plant and record again",
        )  # fmt: skip


def _fit(
    estimate: Estimate, estimation: Sequence[Comparison], validation: Sequence[Comparison]
) -> Iterator[Finding]:
    names, record = validation[0].experiment.names, validation[0].experiment.name
    own, other = overall_fit(estimation), overall_fit(validation)
    explained = min(comparison.input_percent for comparison in validation)
    if not min(other, explained) >= REFUSED_PERCENT:
        yield from _reasons_for_no_fit(estimate, own, min(other, explained), record)
        return
    if other < POOR_PERCENT:
        yield Finding(
            Kind.POOR_FIT, Severity.WARN, record, names.y, other, POOR_PERCENT, "%",
            f"the model's free-running simulation follows it to {other:.3g} % only (limit {POOR_PERCENT:g} %)",
            "raise the amplitude, look at the residuals, or choose another structure",
        )  # fmt: skip
    noise = max(_sensor_noise(comparison.experiment) for comparison in estimation)
    if own < EXPLAINED_PERCENT and estimate.noise_std > MAX_NOISE_RATIO * noise > 0.0:
        yield Finding(
            Kind.NOT_EXPLAINED, Severity.WARN, estimation[0].experiment.name, names.y, estimate.noise_std / noise, MAX_NOISE_RATIO, "",
            f"the model's error is {estimate.noise_std / noise:.3g} times the noise of the sensor (limit {MAX_NOISE_RATIO:g}): "
            "the plant does something that the model does not, or is disturbed",
            "look for end stops, friction or saturation in the record; choose another structure",
        )  # fmt: skip
    if own - other > MAX_FIT_LOSS:
        yield Finding(
            Kind.POOR_FIT, Severity.WARN, record, names.y, own - other, MAX_FIT_LOSS, "%",
            f"the fit is {own:.3g} % on the data of the estimation, {other:.3g} % on the others (difference limit "
            f"{MAX_FIT_LOSS:g} %)",
            "choose a smaller structure, record longer, or make both records under the same conditions",
        )  # fmt: skip


def _reasons_for_no_fit(estimate: Estimate, own: float, fit: float, record: str) -> Iterator[Finding]:
    names = estimate.experiments[0].names
    swapped = _fit_of_swapped(estimate.experiments) if own < POOR_PERCENT else -np.inf
    if swapped > max(POOR_PERCENT, fit + 20.0):
        yield Finding(
            Kind.SWAPPED, Severity.REFUSE, record, f"{names.u} and {names.y}", swapped, POOR_PERCENT, "%",
            f"{names.u} follows from {names.y} to {swapped:.3g} %, but {names.y} from {names.u} to {max(fit, 0.0):.3g} %",
            "exchange the two columns",
        )  # fmt: skip
        return
    yield Finding(
        Kind.POOR_FIT, Severity.REFUSE, record, names.y, fit, REFUSED_PERCENT, "%",
        f"{names.u} explains {max(fit, 0.0):.3g} % of it in a free-running simulation (limit {REFUSED_PERCENT:g} %)",
        "raise the amplitude above friction and noise; check that both channels belong to one axis and one time; for "
        "an unstable plant, record in closed loop and choose ARMAX",
    )  # fmt: skip


def _sensor_noise(experiment: Experiment) -> float:
    y = np.where(experiment.observed, experiment.y, np.nan)
    return max(noise_std(y), quantum(y) / np.sqrt(12.0))


def _fit_of_swapped(experiments: Sequence[Experiment]) -> float:
    """Fit in per cent of a small model from y to u."""
    swapped = [
        Experiment(np.where(e.observed, e.y, np.nan), e.u, e.sample_time_s, name=e.name).part(0, 6000)
        for e in experiments
    ]
    try:
        model = fit_output_error(swapped, OutputError(2, 2, 1)).discrete
        return overall_fit([compare(model, experiment) for experiment in swapped])
    except DesignError:
        return -np.inf


def _stalls(comparisons: Sequence[Comparison], expected: Expectations) -> Iterator[Finding]:
    for comparison in comparisons:
        names, record = comparison.experiment.names, comparison.experiment.name
        stalls = find_stalls(comparison)
        if stalls.between > MAX_STALLED:
            severity = Severity.REFUSE if stalls.between > REFUSED_STALLED else Severity.WARN
            limit = REFUSED_STALLED if severity is Severity.REFUSE else MAX_STALLED
            yield Finding(
                Kind.FRICTION, severity, record, names.y, 100.0 * stalls.between, 100.0 * limit, "%",
                f"it stands still in {100.0 * stalls.between:.3g} % of the times at which the model moves clearly (limit "
                f"{100.0 * limit:g} %): friction or a dead zone holds it",
                "raise the amplitude",
            )  # fmt: skip
        if stalls.at_extremes > MAX_STALLED and expected.travel is None:
            yield Finding(
                Kind.END_STOPS, Severity.WARN, record, names.y, 100.0 * stalls.at_extremes, 100.0 * MAX_STALLED, "%",
                f"it stands still at its extreme values in {100.0 * stalls.at_extremes:.3g} % of the times at which the "
                f"model moves clearly (limit {100.0 * MAX_STALLED:g} %): an end stop, a converter at its limit, or friction",
                "state the travel, so that these samples are left out; centre the axis, or lower the amplitude",
            )  # fmt: skip


def _drift(estimate: Estimate) -> Iterator[Finding]:
    """A slope of the output, estimated for the dynamics that were found."""
    model = estimate.discrete
    for experiment, residual in zip(estimate.experiments, estimate.residuals, strict=True):
        data = SimulationError(
            [experiment], skipped=max(0, model.nk + len(model.b) - 1 - model.order), drift=True
        )
        found = data.simulate(Dynamics(model.f, model.b[:, None], model.nk)) if data.residuals else None
        if found is None:
            continue
        parts = data.fitted(found)
        slope = float(parts[0].common[1])
        errors = [np.where(part.stretch.root_weight > 0.0, part.residual, 0.0) for part in parts]
        noise = noise_autoregression(errors)
        variance = (
            sum(float(e @ e) for e in errors) / data.residuals * noise.innovation / float(noise.a.sum()) ** 2
        )
        # A line from -0.5 to 0.5 has the mean square 1/12.
        std = float(np.sqrt(12.0 * variance / data.residuals))
        spread = float(np.nanstd(np.where(experiment.observed, experiment.y, np.nan)))
        if abs(slope) > DRIFT_SIGNIFICANCE * std and abs(slope) > MAX_DRIFT * spread:
            names = experiment.names
            yield Finding(
                Kind.DRIFT, Severity.WARN, experiment.name, names.y, slope, MAX_DRIFT * spread, names.y_unit,
                f"it drifts by {slope:.3g} {names.y_unit} over the record (limit {MAX_DRIFT * spread:.3g} {names.y_unit})",
                "estimate the drift with the model, or look for its cause (temperature, supply, a leak)",
            )  # fmt: skip


def _time_scale(estimate: Estimate) -> Iterator[Finding]:
    model, name = estimate.discrete, estimate.experiments[0].name
    T = model.sample_time_s
    poles = logarithms(model.f, T)
    if not len(poles):
        return
    fastest = float(np.abs(poles).max())
    if fastest * T < SLOWEST_USEFUL:
        yield Finding(
            Kind.SAMPLE_TIME, Severity.WARN, name, "sample time", T, SLOWEST_USEFUL / fastest, "s",
            f"{T:.4g} s is very short beside the plant's fastest time constant of {1.0 / fastest:.4g} s (at least "
            f"{SLOWEST_USEFUL / fastest:.4g} s is usual)",
            "check the unit of the sample time (seconds), or average the record",
        )  # fmt: skip
    for s in poles:
        damping = -s.real / abs(s)
        if s.imag > NEAR_NYQUIST * np.pi / T and damping < 0.3:
            yield Finding(
                Kind.SAMPLE_TIME, Severity.WARN, name, "sample time", float(s.imag), NEAR_NYQUIST * np.pi / T, "rad/s",
                f"a mode at {s.imag:.4g} rad/s lies close to half the sampling frequency, {np.pi / T:.4g} rad/s: it may be the "
                "image of a faster one",
                "sample faster, or filter the sensor before it is sampled",
            )  # fmt: skip


def _uncertainty(estimate: Estimate, properties: Properties) -> Iterator[Finding]:
    name = estimate.experiments[0].name
    known_to = _best_known(estimate)
    if not known_to <= REFUSED_UNCERTAINTY:
        names = estimate.experiments[0].names
        yield Finding(
            Kind.UNCERTAIN, Severity.REFUSE, name, f"{names.u} to {names.y}", 100.0 * known_to, 100.0 * REFUSED_UNCERTAINTY,
            "%",
            f"at no frequency is the response known better than to {100.0 * known_to:.3g} % (limit "
            f"{100.0 * REFUSED_UNCERTAINTY:g} %)",
            f"check that {names.u} acts on {names.y}; record longer, or raise the amplitude",
        )  # fmt: skip
        return
    values = [
        ("pole", abs(root.value), root.std, "rad/s") for root in properties.poles if root.value.imag >= 0.0
    ]
    gain = properties.velocity_gain or properties.gain
    if gain is not None:
        values.insert(0, ("gain", abs(gain.value), gain.std, ""))
    for what, size, std, unit in values:
        share = std / size if size else np.inf
        if share > MAX_UNCERTAINTY:
            at = f"{what} {size:.4g} {unit}".strip()
            yield Finding(
                Kind.UNCERTAIN, Severity.WARN, name, what, 100.0 * share, 100.0 * MAX_UNCERTAINTY, "%",
                f"{at} has a standard deviation of {100.0 * share:.3g} % (limit {100.0 * MAX_UNCERTAINTY:g} %): too little "
                "excitation there",
                "record longer, excite at this frequency, raise the amplitude, or choose a smaller structure",
            )  # fmt: skip


def _best_known(estimate: Estimate) -> float:
    """Standard deviation of the frequency response as a share of it, at the frequency where it is smallest."""
    T = estimate.discrete.sample_time_s
    longest = max(map(len, estimate.experiments))
    band = response_band(estimate, np.geomspace(2.0 * np.pi / (longest * T), 0.9 * np.pi / T, 50))
    return float(np.min(band.magnitude_std))


def _known_plant(estimate: Estimate, properties: Properties, expected: Expectations) -> Iterator[Finding]:
    """A gain or speed that differs from that of an earlier model by a factor that a wrong unit or sign explains."""
    if expected.plant is None:
        return
    name, names = estimate.experiments[0].name, estimate.experiments[0].names
    before, after = expected.plant.gain, estimate.discrete.gain
    if np.isfinite(before) and np.isfinite(after) and before:
        for factor, reason in _GAIN_FACTORS.items():
            if abs(after / before / factor - 1.0) < 0.3:
                yield Finding(
                    Kind.UNITS, Severity.WARN, name, names.y, after / before, 1.0, "",
                    f"the gain is {after / before:.4g} times that of the known plant", f"check: {reason}",
                )  # fmt: skip
    speeds = np.sort(np.abs(expected.plant.poles)), np.sort([abs(root.value) for root in properties.poles])
    if len(speeds[0]) != len(speeds[1]) or not (speeds[0] > 0.0).all():
        return
    ratio = float(np.median(speeds[1] / speeds[0]))
    for factor in _TIME_FACTORS:
        if abs(ratio / factor - 1.0) < 0.25:
            yield Finding(
                Kind.SAMPLE_TIME, Severity.WARN, name, "sample time", ratio, 1.0, "",
                f"the plant is {ratio:.4g} times as fast as the known one",
                f"check that {estimate.discrete.sample_time_s:g} s is the sample time, in seconds",
            )  # fmt: skip


_GAIN_FACTORS = {
    1000.0: "y in thousandths of its unit?",
    100.0: "y in hundredths of its unit?",
    180.0 / np.pi: "y in degrees instead of rad?",
    0.001: "u in thousandths of its unit?",
    -1.0: "actuator or sensor connected the other way round?",
}
"""Ratio of the gain to the known one, and what would explain it."""
_TIME_FACTORS = (1e-3, 1.0 / 60.0, 0.1, 0.5, 2.0, 10.0, 60.0, 1e3)
"""Ratios of the speed to the known one that a wrong sample time explains."""


def _dynamics(estimate: Estimate, analysis: ResidualAnalysis, fit: float) -> Iterator[Finding]:
    """A dead time that the structure lacks, or other dynamics, if the residuals show that some are missing."""
    if analysis.from_input.passed or not np.isfinite(fit):
        return
    names, name, nk = estimate.experiments[0].names, estimate.experiments[0].name, estimate.discrete.nk
    suggested = _dead_time(estimate)
    if suggested is None:
        yield Finding(
            Kind.NOT_EXPLAINED, Severity.NOTE, name, names.y, analysis.from_input.probability,
            1.0 - analysis.from_input.level, "",
            f"the model's error depends on earlier values of {names.u} (probability by chance "
            f"{analysis.from_input.probability:.1g}): some dynamics are missing",
            "try a larger structure",
        )  # fmt: skip
        return
    samples, improvement = suggested
    lost = (100.0 - fit) * (1.0 - float(np.sqrt(1.0 - improvement)))
    yield Finding(
        Kind.DEAD_TIME, Severity.WARN if lost > MAX_LOST_PERCENT else Severity.NOTE, name, names.y, samples, nk, "samples",
        f"a delay of nk = {samples} instead of {nk} would raise the fit by {lost:.3g} % (limit {MAX_LOST_PERCENT:g} %)",
        f"use nk = {samples}, or a continuous structure with a dead time",
    )  # fmt: skip


def _has_error(estimate: Estimate) -> bool:
    """False if the error is nothing but rounding."""
    spread = max(float(np.nanstd(np.where(e.observed, e.y, np.nan))) for e in estimate.experiments)
    return estimate.noise_std > ROUNDING * spread


def _explained(correlation: Correlation) -> float:
    """Share of the variance of the error that the input explains, at the lags of a white input."""
    return float(np.max(correlation.values**2, initial=0.0))


def _dead_time(estimate: Estimate) -> tuple[int, float] | None:
    """The shortest larger delay in samples that lowers the error nearly as far as any, and the share that it removes."""
    model = estimate.discrete
    T, n = model.sample_time_s, model.order
    if not model.stable or n == 0:
        return None
    sections = PoleSections.of_order(n, T)
    theta = from_poles(logarithms(model.f, T), sections)
    if theta is None:
        return None
    parts = [experiment.part(0, 12_000) for experiment in estimate.experiments]
    data = SimulationError(parts, skipped=MAX_DEAD_SAMPLES + len(model.b))
    costs = {}
    for nk in range(model.nk, model.nk + MAX_DEAD_SAMPLES):
        problem = DynamicsProblem(data, FreeNumerator(sections, len(model.b), nk))
        outcome = minimise(problem, theta, 1e-2, 12)
        if outcome is None:
            return None
        costs[nk] = outcome.trial.cost
        theta = outcome.theta
    present, least = costs[model.nk], min(costs.values())
    if not present - least > MIN_IMPROVEMENT * present:
        return None
    shortest = min(nk for nk, cost in costs.items() if cost <= least + 0.1 * (present - least))
    return shortest, 1.0 - costs[shortest] / present
