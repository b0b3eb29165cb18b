"""The plant document of an identified model: what ``hil identify`` writes and ``hil design`` reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from design.errors import DesignError
from design.identification.identify import Identification
from design.identification.models.model import DiscreteModel
from design.mathematics.polynomials import Array
from design.models.plant import Covariance, Plant
from design.models.plant import DiscreteModel as DiscreteDocument


def identified_plant(
    identification: Identification,
    *,
    name: str,
    output_unit: Literal["m", "rad"],
    description: str = "",
    conditions: Mapping[str, bool | int | float | str] | None = None,
    recording: str | None = None,
) -> Plant:
    """Return the model as a plant document, with covariance, fit, conditions and warnings.

    A sampled model without a continuous counterpart is written as the nearest model that has one, and the
    warnings say so. Raises DesignError if there is none.
    """
    model = identification.continuous
    if model is None and identification.nearest is not None:
        model = identification.nearest.model
    if model is None:
        raise DesignError(
            f"{name}: the {identification.structure} model has no continuous counterpart, and none comes "
            "close; identify with a continuous structure"
        )
    parameters = identification.estimate.parameters
    return Plant(
        format="hil-plant",
        version=1,
        name=name,
        description=description or f"identified as {identification.structure}",
        input_unit="V",
        output_unit=output_unit,
        sample_time_s=identification.discrete.sample_time_s,
        num=_plain(model.num),
        den=_plain(model.den),
        dead_time_s=float(model.dead_time_s),
        contains_delay_samples=identification.contains_delay_samples,
        discrete=_discrete(identification.discrete),
        covariance=Covariance(
            parameters=list(parameters.names), matrix=[_plain(row) for row in parameters.covariance]
        ),
        fit={
            comparison.experiment.name: round(comparison.fit_percent, 4)
            for comparison in identification.validation
        },
        conditions=dict(conditions or {}),
        recording=recording,
        warnings=list(identification.warnings),
        origin={"structure": str(identification.structure), "by": "hil identify"},
    )


def _discrete(model: DiscreteModel) -> DiscreteDocument:
    """Return a sampled model in falling powers of z, the delay as poles at 0."""
    num, den = list(model.b), list(model.f)
    length = max(model.nk + len(num), len(den))
    num = [0.0] * model.nk + num + [0.0] * (length - model.nk - len(num))
    den += [0.0] * (length - len(den))
    first = next(place for place, value in enumerate(num) if value != 0.0)
    return DiscreteDocument(
        num=_plain(np.array(num[first:])), den=_plain(np.array(den)), sample_time_s=model.sample_time_s
    )


def _plain(values: Array) -> list[float]:
    return [float(value) for value in values]
