"""One entrance to all estimators."""

from __future__ import annotations

from collections.abc import Sequence

from design.errors import DesignError
from design.identification.estimators.box_jenkins import fit_box_jenkins
from design.identification.estimators.continuous_fit import fit_continuous
from design.identification.estimators.equation_error import fit_equation_error
from design.identification.estimators.estimate import Estimate
from design.identification.estimators.output_error import fit_output_error
from design.identification.models.structures import (
    Armax,
    Arx,
    BoxJenkins,
    ContinuousPoles,
    OutputError,
    Structure,
)
from design.identification.records.experiment import Experiment


def fit(experiments: Sequence[Experiment], structure: Structure, *, drift: bool = False) -> Estimate:
    """Fit a model to one or more experiments, each with an offset and an initial state of its own.

    ``drift`` also estimates a slope of each output. Raises DesignError where the experiments have different
    sample times, or where the data cannot determine the model.
    """
    if not experiments:
        raise DesignError("no experiment to fit a model to")
    period = experiments[0].sample_time_s
    for experiment in experiments:
        if abs(experiment.sample_time_s / period - 1.0) > 1e-6:
            raise DesignError(
                f"{experiment.name}: sample time {experiment.sample_time_s:g} s, but {experiments[0].name} "
                f"has {period:g} s; one fit needs experiments of one sample time"
            )
    match structure:
        case OutputError():
            return fit_output_error(experiments, structure, drift=drift)
        case Arx() | Armax():
            return fit_equation_error(experiments, structure, drift=drift)
        case BoxJenkins():
            return fit_box_jenkins(experiments, structure, drift=drift)
        case ContinuousPoles():
            return fit_continuous(experiments, structure, drift=drift)
