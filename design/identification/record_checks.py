"""What can be said against a record before a model is fitted to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from design.identification.causality import later_input_share
from design.identification.experiment import Experiment, runs
from design.identification.feedback import feedback
from design.identification.findings import Finding, Kind, Severity
from design.identification.models import ContinuousModel
from design.identification.structures import Armax, Arx, BoxJenkins, ContinuousPoles, OutputError, Structure
from design.mathematics.polynomials import Array, Flags

MIN_SAMPLES_PER_UNKNOWN = 10
"""Number of output samples for each parameter of the model below which a record is refused."""
MIN_SAMPLES = 50
"""Number of output samples below which a record is refused, whatever the model."""
MIN_VALIDATION_SAMPLES = 20
"""Number of output samples below which a record cannot validate a model."""
MAX_PERIOD_ERROR = 0.02
"""Relative difference of the sample time from the rig's period above which a record is refused."""
MAX_MISSING = 0.05
"""Share of missing samples above which the gaps are reported."""
REFUSED_MISSING = 0.8
"""Share of missing samples above which a record is refused."""
MAX_AT_LIMIT = 0.01
"""Share of samples at a limit of the input above which saturation is reported."""
MAX_AT_STOPS = 0.2
"""Share of samples at the ends of the travel above which a record is refused."""
STOP_MARGIN = 0.01
"""Share of the travel next to its ends that counts as reached."""
SMALLEST_SPREAD = 1e-50
"""Range of a signal up to which it counts as constant."""
MIN_LEVELS = 20
"""Number of different output values below which the resolution is reported."""
PERSISTENCE = 1e-11
"""Smallest singular value of the delayed inputs, as a share of the largest, that still counts as excitation."""
MAX_FEEDBACK = 0.3
"""Ratio of the input's prediction errors with and without the output, below which the loop is closed."""

MAX_LATER_INPUT = 0.05
"""Share of the output's prediction error that later inputs may explain."""


@dataclass(frozen=True)
class Expectations:
    """What is known about the rig or plant before the experiment. None means not known."""

    input_range: tuple[float, float] | None = None
    """Limits of the actuator, in units of u."""
    travel: tuple[float, float] | None = None
    """End stops, in units of y."""
    plant: ContinuousModel | None = None
    """An earlier model of the plant."""
    sample_time_s: float | None = None
    """The period of the rig."""
    closed_loop: bool | None = None
    """Whether a controller acted during the experiment."""


def parameters_of(structure: Structure) -> int:
    """Number of parameters of a structure."""
    match structure:
        case OutputError(nb, nf):
            return nb + nf
        case Arx(na, nb):
            return na + nb
        case Armax(na, nb, nc):
            return na + nb + nc
        case BoxJenkins(nb, nc, nd, nf):
            return nb + nc + nd + nf
        case ContinuousPoles():
            return (
                structure.real + 2 * structure.pairs + structure.zeros + 1 + bool(structure.max_dead_time_s)
            )


def check_record(experiment: Experiment, structure: Structure, expected: Expectations) -> list[Finding]:
    """Findings about one record that a model is to be fitted to."""
    found = list(_size(experiment, structure))
    if any(finding.severity is Severity.REFUSE for finding in found):
        return found
    found += _period(experiment, expected)
    found += _signals(experiment)
    found += _excitation(experiment, structure)
    found += _input_range(experiment, expected)
    found += _travel(experiment, expected)
    found += _resolution(experiment)
    found += _loop(experiment, structure, expected)
    if not any(finding.kind is Kind.FEEDBACK for finding in found):
        found += _time_shift(experiment, structure)
    return found


def check_validation(experiment: Experiment, expected: Expectations) -> list[Finding]:
    """Findings about one record that a model is to be compared with."""
    names, record = experiment.names, experiment.name
    usable = np.isfinite(experiment.u) & experiment.observed
    count = int(np.count_nonzero(usable))
    if count < MIN_VALIDATION_SAMPLES:
        return [
            Finding(
                Kind.TOO_FEW_SAMPLES,
                Severity.REFUSE,
                record,
                names.y,
                count,
                MIN_VALIDATION_SAMPLES,
                "samples",
                f"{count} samples for the validation, {MIN_VALIDATION_SAMPLES} are needed",
                "record longer, or give a record for the validation",
            )  # fmt: skip
        ]
    still = _constant(Kind.CONSTANT_INPUT, record, names.u, names.u_unit, experiment.u[usable])
    return [
        *(
            replace(finding, remedy="excite the plant throughout, or give a record for the validation")
            for finding in still
        ),
        *_constant(Kind.CONSTANT_OUTPUT, record, names.y, names.y_unit, experiment.y[usable]),
        *_input_range(experiment, expected),
        *_travel(experiment, expected),
    ]


def without_stops(experiment: Experiment, expected: Expectations) -> Experiment:
    """The record without the periods at an end stop: no linear model holds there, and each begins a new stretch."""
    if expected.travel is None:
        return experiment
    stopped = _at_stops(experiment, expected.travel)
    return experiment.interrupted(stopped) if stopped.any() else experiment


def _size(experiment: Experiment, structure: Structure) -> Iterator[Finding]:
    y, name = experiment.names.y, experiment.name
    count = int(np.count_nonzero(experiment.observed))
    needed = max(MIN_SAMPLES, MIN_SAMPLES_PER_UNKNOWN * parameters_of(structure))
    if count < needed:
        yield Finding(
            Kind.TOO_FEW_SAMPLES, Severity.REFUSE, name, y, count, needed, "samples",
            f"{count} samples that are known and count, {needed} are needed for {structure}",
            "record longer, or choose a smaller structure",
        )  # fmt: skip
        return
    missing = 1.0 - float(np.mean(np.isfinite(experiment.y) & np.isfinite(experiment.u)))
    if missing > MAX_MISSING:
        severity = Severity.REFUSE if missing > REFUSED_MISSING else Severity.WARN
        limit = REFUSED_MISSING if severity is Severity.REFUSE else MAX_MISSING
        yield Finding(
            Kind.GAPS, severity, name, y, 100.0 * missing, 100.0 * limit, "%",
            f"{100.0 * missing:.3g} % of the samples are missing (limit {100.0 * limit:g} %)",
            "look for lost frames, and record again",
        )  # fmt: skip
    known = np.isfinite(experiment.u)
    lengths = [last - first for first, last in runs(known)]
    needed = 5 * parameters_of(structure)
    usable = sum(length for length in lengths if length >= needed)
    if usable < 0.5 * len(experiment):
        yield Finding(
            Kind.GAPS, Severity.REFUSE, name, experiment.names.u, 100.0 * usable / len(experiment), 50.0, "%",
            f"only {100.0 * usable / len(experiment):.3g} % of the record lies in stretches of {needed} or more periods "
            f"with a known input (limit 50 %); the longest has {max(lengths, default=0)}",
            "record without interruptions, or state that the input was held in the gaps",
        )  # fmt: skip


def _period(experiment: Experiment, expected: Expectations) -> Iterator[Finding]:
    known, given = expected.sample_time_s, experiment.sample_time_s
    if known is not None and abs(given / known - 1.0) > MAX_PERIOD_ERROR:
        yield Finding(
            Kind.SAMPLE_TIME, Severity.REFUSE, experiment.name, "sample time", given, known, "s",
            f"{given:.6g} s, but the rig's period is {known:.6g} s (limit {100.0 * MAX_PERIOD_ERROR:g} %)",
            "give the true sample time, in seconds",
        )  # fmt: skip


def _signals(experiment: Experiment) -> Iterator[Finding]:
    names, record = experiment.names, experiment.name
    yield from _constant(
        Kind.CONSTANT_INPUT, record, names.u, names.u_unit, experiment.u[np.isfinite(experiment.u)]
    )
    yield from _constant(
        Kind.CONSTANT_OUTPUT, record, names.y, names.y_unit, experiment.y[experiment.observed]
    )


_REMEDIES = {
    Kind.CONSTANT_INPUT: "excite the plant; check that the right channel was recorded",
    Kind.CONSTANT_OUTPUT: "check the sensor, its wire and the channel; raise the amplitude if the plant did not move",
}


def _constant(kind: Kind, record: str, signal: str, unit: str, values: Array) -> Iterator[Finding]:
    spread = float(np.ptp(values))
    if spread <= max(1e-9 * float(np.abs(values).max()), SMALLEST_SPREAD):
        at = "0" if not values.any() else f"{values[0]:.6g} {unit}"
        text = f"it stays at {at}"
        yield Finding(kind, Severity.REFUSE, record, signal, spread, 0.0, unit, text, _REMEDIES[kind])


def _excitation(experiment: Experiment, structure: Structure) -> Iterator[Finding]:
    """Rank of the delayed inputs: a constant excites one parameter, a sine two, and so on."""
    needed = parameters_of(structure)
    known = max(runs(np.isfinite(experiment.u)), key=lambda span: span[1] - span[0])
    u = experiment.u[known[0] : min(known[1], known[0] + 20_000)]
    u = u - u.mean()
    if len(u) <= 2 * needed or not u.any():
        return
    delayed = np.lib.stride_tricks.sliding_window_view(u, needed)
    singular = np.linalg.svd(np.linalg.qr(delayed, mode="r"), compute_uv=False)
    order = int(np.count_nonzero(singular > PERSISTENCE * singular[0]))
    if order < needed:
        yield Finding(
            Kind.EXCITATION, Severity.REFUSE, experiment.name, experiment.names.u, order, needed, "",
            f"it excites {order} parameters, {structure} has {needed}",
            "use a PRBS, a multisine with more lines or a chirp, or a smaller structure",
        )  # fmt: skip


def _input_range(experiment: Experiment, expected: Expectations) -> Iterator[Finding]:
    if expected.input_range is None:
        return
    (low, high), names = expected.input_range, experiment.names
    u = experiment.u[np.isfinite(experiment.u)]
    outside = _outside(u, low, high, 0.05)
    if outside is not None:
        yield Finding(
            Kind.UNITS, Severity.REFUSE, experiment.name, names.u, outside, _nearer(outside, low, high), names.u_unit,
            f"it reaches {outside:.4g} {names.u_unit}, but the actuator takes {low:g} to {high:g} {names.u_unit}"
            + _scaled(outside, low, high),
            "give it in the right unit, as an offset from the actuator's centre",
        )  # fmt: skip
        return
    margin = 1e-6 * (high - low)
    share = float(np.mean((u >= high - margin) | (u <= low + margin)))
    if share > MAX_AT_LIMIT:
        yield Finding(
            Kind.SATURATION, Severity.WARN, experiment.name, names.u, 100.0 * share, 100.0 * MAX_AT_LIMIT, "%",
            f"{100.0 * share:.3g} % of it lies at a limit of the actuator (limit {100.0 * MAX_AT_LIMIT:g} %)",
            "lower the amplitude",
        )  # fmt: skip


def _travel(experiment: Experiment, expected: Expectations) -> Iterator[Finding]:
    if expected.travel is None:
        return
    (low, high), names = expected.travel, experiment.names
    outside = _outside(experiment.y[experiment.observed], low, high, 0.2)
    if outside is not None:
        yield Finding(
            Kind.UNITS, Severity.REFUSE, experiment.name, names.y, outside, _nearer(outside, low, high), names.y_unit,
            f"it reaches {outside:.4g} {names.y_unit}, but the travel is {low:g} to {high:g} {names.y_unit}"
            + _scaled(outside, low, high),
            "give it in the right unit, with its zero where the travel has it",
        )  # fmt: skip
        return
    share = float(np.mean(_at_stops(experiment, expected.travel)[experiment.observed]))
    if share > 0.0:
        severity = Severity.REFUSE if share > MAX_AT_STOPS else Severity.WARN
        yield Finding(
            Kind.END_STOPS, severity, experiment.name, names.y, 100.0 * share, 100.0 * MAX_AT_STOPS, "%",
            f"{100.0 * share:.3g} % of it lies at an end of the travel (limit {100.0 * MAX_AT_STOPS:g} %); these samples "
            "are left out",
            "centre the axis first, measure the actuator's offset, or lower the amplitude",
        )  # fmt: skip


def _resolution(experiment: Experiment) -> Iterator[Finding]:
    levels = len(np.unique(experiment.y[experiment.observed][:20_000]))
    if levels < MIN_LEVELS:
        yield Finding(
            Kind.RESOLUTION, Severity.WARN, experiment.name, experiment.names.y, levels, MIN_LEVELS, "",
            f"it takes only {levels} different values (limit {MIN_LEVELS})",
            "raise the amplitude, or use a converter of finer resolution",
        )  # fmt: skip


def _loop(experiment: Experiment, structure: Structure, expected: Expectations) -> Iterator[Finding]:
    """Closed-loop data with a structure that takes its noise for independent of the input."""
    if isinstance(structure, BoxJenkins | Armax):
        return
    found = feedback(experiment) if expected.closed_loop is None else None
    ratio = found.with_output if found is not None else 0.0
    if expected.closed_loop or (found is not None and ratio < MAX_FEEDBACK):
        known = "as stated" if expected.closed_loop else f"a controller computes it from {experiment.names.y}"
        yield Finding(
            Kind.FEEDBACK, Severity.WARN, experiment.name, experiment.names.u, ratio, MAX_FEEDBACK, "",
            f"the loop was closed: {known}. {structure} takes it for independent of the noise in {experiment.names.y}, "
            "and is biased if that noise is strong",
            "record in open loop, or choose ARMAX or BJ",
        )  # fmt: skip


def _time_shift(experiment: Experiment, structure: Structure) -> Iterator[Finding]:
    """An output that answers before its input."""
    nk = 1 if isinstance(structure, ContinuousPoles) else structure.nk
    share = later_input_share(experiment, nk)
    if share > MAX_LATER_INPUT:
        names = experiment.names
        yield Finding(
            Kind.TIME_SHIFT, Severity.WARN, experiment.name, names.y, 100.0 * share, 100.0 * MAX_LATER_INPUT, "%",
            f"{100.0 * share:.3g} % of what its past does not explain depends on values of {names.u} that come later than nk = "
            f"{nk} allows (limit {100.0 * MAX_LATER_INPUT:g} %): it answers before its input, or a controller acts",
            "check the times of both columns and the transport delay, or use a smaller nk",
        )  # fmt: skip


def _at_stops(experiment: Experiment, travel: tuple[float, float]) -> Flags:
    low, high = travel
    margin = STOP_MARGIN * (high - low)
    with np.errstate(invalid="ignore"):
        return np.asarray((experiment.y > high - margin) | (experiment.y < low + margin))


def _outside(values: Array, low: float, high: float, margin: float) -> float | None:
    """The value farthest outside the range, if it leaves it by more than ``margin`` times its width."""
    excess = np.maximum(values - high, low - values)
    worst = int(np.argmax(excess))
    return float(values[worst]) if excess[worst] > margin * (high - low) else None


def _nearer(value: float, low: float, high: float) -> float:
    return high if value > high else low


_SCALES = {1000.0: "thousandths of the unit", 100.0: "hundredths of the unit", 180.0 / np.pi: "degrees"}


def _scaled(outside: float, low: float, high: float) -> str:
    """The usual factors by which the value, divided, would lie in the range."""
    limit = _nearer(outside, low, high)
    ratio = outside / limit if limit else 0.0
    reasons = [reason for factor, reason in _SCALES.items() if 3.0 < ratio <= 1.2 * factor]
    return f": in {' or '.join(reasons)}?" if reasons else ""


def overlapping(first: Sequence[Experiment], second: Sequence[Experiment]) -> bool:
    """True if an experiment of one list has the same samples as one of the other."""
    return any(_same(a, b) for a in first for b in second)


def _same(a: Experiment, b: Experiment) -> bool:
    def equal(x: Array, y: Array) -> bool:
        return np.array_equal(x, y, equal_nan=True)

    return a is b or (equal(a.u, b.u) and equal(a.y, b.y))
