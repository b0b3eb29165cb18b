"""From records to a model with its uncertainty, its fit on other data, and all that speaks against it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from design.errors import DesignError
from design.identification.analysis.comparison import Comparison, compare, overall_fit
from design.identification.analysis.frequency_response import FrequencyResponse, frequency_response
from design.identification.analysis.residuals import ResidualAnalysis, analyse_residuals
from design.identification.analysis.uncertainty import Properties, properties
from design.identification.checks.expectations import NOTHING_KNOWN, Expectations
from design.identification.checks.model_checks import check_model
from design.identification.checks.range_checks import without_stops
from design.identification.checks.record_checks import check_record, check_validation
from design.identification.estimators.estimate import Estimate
from design.identification.estimators.fit import fit
from design.identification.estimators.nearest_continuous import Nearest, nearest_continuous
from design.identification.findings import Finding, Kind, Severity, most_severe_first, refuse_if_needed
from design.identification.models.inverse_hold import NoContinuousModelError, invert_hold
from design.identification.models.model import ContinuousModel, DiscreteModel
from design.identification.models.structures import OutputError, Structure, parse_structure
from design.identification.records.experiment import UNNAMED, Experiment, Names

DEFAULT_STRUCTURE = OutputError(1, 3, 1)
"""The paper's structure, of eq. (15)."""
ESTIMATION_SHARE = 2.0 / 3.0
"""Share of a record that is fitted if no other data are given for the validation."""


@dataclass(frozen=True, eq=False)
class Identification:
    """A model that was identified, and what is known about it."""

    estimate: Estimate
    continuous: ContinuousModel | None
    """The continuous model: fitted, or by inverting the hold. None where the sampled model has none."""
    nearest: Nearest | None
    """Where ``continuous`` is None, a continuous model that comes close."""
    contains_delay_samples: int
    """Periods of the rig's transport delay that the model contains."""
    properties: Properties
    validation: tuple[Comparison, ...]
    """The model beside data that were not fitted."""
    residuals: ResidualAnalysis
    findings: tuple[Finding, ...]

    @property
    def structure(self) -> Structure:
        """The structure of the model."""
        return self.estimate.structure

    @property
    def discrete(self) -> DiscreteModel:
        """The sampled model, from the held input to the sampled output."""
        return self.estimate.discrete

    @property
    def fit_percent(self) -> float:
        """Fit of the free-running simulation on the validation data, in per cent."""
        return overall_fit(self.validation)

    @property
    def estimation_fit_percent(self) -> float:
        """Fit of the free-running simulation on the data that were fitted, in per cent."""
        return overall_fit([compare(self.discrete, experiment) for experiment in self.estimate.experiments])

    @property
    def dead_time_s(self) -> float:
        """All dead time in the model in s, the periods of ``contains_delay_samples`` included."""
        if self.continuous is not None:
            return self.continuous.dead_time_s
        return max(self.discrete.nk - 1, 0) * self.discrete.sample_time_s

    @property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against the model, in words. Notes are not among it."""
        return tuple(str(finding) for finding in self.findings if finding.severity is Severity.WARN)

    @property
    def doubtful(self) -> bool:
        """True if something speaks against the model."""
        return bool(self.warnings)

    def frequency_response(self, period_samples: int | None = None) -> FrequencyResponse:
        """Measure the response without a model, from the data that were fitted. Raises DesignError."""
        return frequency_response(self.estimate.experiments, period_samples=period_samples)


def identify(
    u: ArrayLike,
    y: ArrayLike,
    sample_time_s: float,
    *,
    structure: Structure | str = DEFAULT_STRUCTURE,
    weights: ArrayLike | None = None,
    validation: Sequence[Experiment] | None = None,
    drift: bool = False,
    transport_delay_samples: int = 0,
    remove_transport_delay: bool = True,
    expected: Expectations = NOTHING_KNOWN,
    name: str = "record",
    names: Names = UNNAMED,
) -> Identification:
    """Identify a model from one record. See :func:`identify_experiments`.

    ``u`` and ``y`` (N,) are sampled every ``sample_time_s``; u[k] is held from sample k to sample k + 1.
    NaN is a missing sample. A sample of ``weights`` 0 does not count.
    """
    record = Experiment(
        np.asarray(u),
        np.asarray(y),
        sample_time_s,
        weights=np.zeros(0) if weights is None else np.asarray(weights),
        name=name,
        names=names,
        transport_delay_samples=transport_delay_samples,
    )
    return identify_experiments(
        [record],
        structure=structure,
        validation=validation,
        drift=drift,
        remove_transport_delay=remove_transport_delay,
        expected=expected,
    )


def identify_experiments(
    experiments: Sequence[Experiment],
    *,
    structure: Structure | str = DEFAULT_STRUCTURE,
    validation: Sequence[Experiment] | None = None,
    drift: bool = False,
    remove_transport_delay: bool = True,
    expected: Expectations = NOTHING_KNOWN,
) -> Identification:
    """Identify one model from experiments of one sample time.

    Each experiment has an offset and an initial state of its own.

    Without ``validation``, the last third of each record is kept from the fit and used for it. With
    ``remove_transport_delay``, the inputs are moved by each record's ``transport_delay_samples``, so that
    the model does not contain the rig's delay. Samples at an end stop of ``expected.travel`` are left out.
    Raises RecordRefusedError with all findings if a record allows no model, and DesignError for arguments
    that do not fit together.
    """
    chosen = parse_structure(structure) if isinstance(structure, str) else structure
    _check_records(experiments, validation)
    fitted, others = _prepared(experiments, validation, remove_transport_delay)
    found: list[Finding] = []
    for experiment in fitted:
        found += check_record(experiment, chosen, expected)
    for experiment in others:
        found += check_validation(experiment, expected)
    refuse_if_needed(found)
    fitted, others = ([without_stops(e, expected) for e in side] for side in (fitted, others))
    estimate = fit(fitted, chosen, drift=drift)
    compared = tuple(compare(estimate.discrete, experiment, drift=drift) for experiment in others)
    analysis = analyse_residuals(estimate.experiments, estimate.residuals)
    known = properties(estimate)
    found += check_model(estimate, compared, analysis, known, expected, drift)
    refuse_if_needed(found)
    continuous, nearest, doubt = _continuous(estimate)
    return Identification(
        estimate=estimate,
        continuous=continuous,
        nearest=nearest,
        contains_delay_samples=0 if remove_transport_delay else experiments[0].transport_delay_samples,
        properties=known,
        validation=compared,
        residuals=analysis,
        findings=most_severe_first([*found, *doubt]),
    )


def _are_the_same(first: Experiment, second: Experiment) -> bool:
    """Return True if both hold the same samples."""
    pairs = ((first.u, second.u), (first.y, second.y))
    return first is second or all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


def _check_records(experiments: Sequence[Experiment], validation: Sequence[Experiment] | None) -> None:
    if not experiments:
        raise DesignError("no experiment to identify a model from")
    delays = {experiment.transport_delay_samples for experiment in [*experiments, *(validation or ())]}
    if len(delays) > 1:
        raise DesignError(
            f"the records have transport delays of {', '.join(map(str, sorted(delays)))} samples; identify "
            "records of one rig together"
        )
    if any(_are_the_same(fitted, other) for fitted in experiments for other in validation or ()):
        raise DesignError("estimation and validation data are the same; give another record, or none")


def _prepared(
    experiments: Sequence[Experiment], validation: Sequence[Experiment] | None, remove_transport_delay: bool
) -> tuple[list[Experiment], list[Experiment]]:
    """Return the records to fit and records to validate with, moved to the actuator if that is asked for."""

    def moved(experiment: Experiment) -> Experiment:
        return experiment.at_the_actuator() if remove_transport_delay else experiment

    if validation is not None:
        return [moved(e) for e in experiments], [moved(e) for e in validation]
    fitted, others = [], []
    for experiment in map(moved, experiments):
        cut = round(ESTIMATION_SHARE * len(experiment))
        fitted.append(experiment.part(0, cut))
        others.append(experiment.part(cut, len(experiment), f"{experiment.name}, last third"))
    return fitted, others


def _continuous(estimate: Estimate) -> tuple[ContinuousModel | None, Nearest | None, list[Finding]]:
    if estimate.continuous is not None:
        return estimate.continuous, None, []
    try:
        return invert_hold(estimate.discrete), None, []
    except NoContinuousModelError as reason:
        nearest: Nearest | None
        try:
            nearest = nearest_continuous(estimate.discrete)
        except DesignError:
            nearest = None
        close = "" if nearest is None else f" (the nearest one follows it to {nearest.fit_percent:.3g} %)"
        finding = Finding(
            Kind.NO_CONTINUOUS_MODEL,
            Severity.WARN,
            estimate.experiments[0].name,
            str(estimate.structure),
            0.0 if nearest is None else nearest.fit_percent,
            100.0,
            "%",
            f"the sampled model has no continuous counterpart{close}: {reason}",
            "choose a continuous structure",
        )
        return None, nearest, [finding]
