"""Small identified models that several tests look at. Each is made once in a test run."""

from __future__ import annotations

from functools import cache

import numpy as np

from design.identification.identify import Identification, identify
from design.identification.models.model import DiscreteModel
from design.identification.records.experiment import Experiment

SAMPLE_TIME_S = 0.0112
TRUE = DiscreteModel(
    b=np.array([4e-4, 3e-4]), f=np.array([1.0, -1.93, 0.935]), nk=1, sample_time_s=SAMPLE_TIME_S
)


def record(samples: int = 1200, seed: int = 3, noise: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Return input and output (samples,) of an experiment on TRUE with a random binary input."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.choice([-0.4, 0.4], size=-(-samples // 6)), 6)[:samples]
    y = TRUE.simulate(u) + noise * random.standard_normal(samples)
    return u, y


@cache
def identified(structure: str = "OE(2,2,1)", name: str = "record") -> Identification:
    """Return a model of TRUE from one record, validated with another."""
    u, y = record()
    other = Experiment(*record(900, seed=4), SAMPLE_TIME_S, name=f"{name}, second")
    return identify(u, y, SAMPLE_TIME_S, structure=structure, validation=[other], name=name)


@cache
def doubtful(name: str = "record") -> Identification:
    """Return a model with warnings: the output drifts, and nothing was estimated for it."""
    u, y = record()
    return identify(
        u, y + 0.08 * np.linspace(0.0, 1.0, len(y)) ** 2, SAMPLE_TIME_S, structure="OE(2,2,1)", name=name
    )


@cache
def with_small_correlation(structure: str = "OE(2,2,1)") -> Identification:
    """Return a good model whose residuals are correlated with the input: a delay of half a sample is lost."""
    u, y = record(6000, noise=1e-4)
    y = 0.5 * (y + np.concatenate([[0.0], y[:-1]]))
    return identify(u, y, SAMPLE_TIME_S, structure=structure)
