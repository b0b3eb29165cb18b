"""Records of known systems for the tests of identification: inputs, noise of any colour, random plants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from design.identification.estimators.pole_sections import PoleSections
from design.identification.models.held_discretisation import hold
from design.identification.models.inverse_hold import invert_hold
from design.identification.models.model import ContinuousModel, DiscreteModel, as_polynomial
from design.identification.records.experiment import Experiment

Array = NDArray[np.float64]
PERIOD_S = 0.0112
SAMPLES = 5357
"""60 s."""
PAPER_DEN = np.polymul([1.0, 0.4231], [1.0, 16.97, 167.9])
PAPER = hold(ContinuousModel(np.array([0.00173, 0.47947, 43.5167]), PAPER_DEN), PERIOD_S)
"""Eq. (15) with the term in s² that its print leaves out: the image of an OE(1,3,1) model."""
COLOURS = {
    "white": ([1.0], [1.0]),
    "slow": ([1.0], [1.0, -0.9]),
    "fast": ([1.0, -0.8], [1.0]),
    "resonant": ([1.0], [1.0, -1.6, 0.9]),
}
"""Numerator and denominator of noise filters in powers of 1/z."""


def prbs(samples: int, hold_samples: int, random: np.random.Generator, amplitude: float = 0.4) -> Array:
    """Plus or minus the amplitude at random, held for some samples."""
    values = random.choice([-amplitude, amplitude], samples // hold_samples + 1)
    return np.repeat(values, hold_samples)[:samples]


def noise(samples: int, colour: str, std: float, random: np.random.Generator) -> Array:
    """Noise of a colour with this standard deviation."""
    settling = 500
    values = lfilter(*COLOURS[colour], random.standard_normal(samples + settling))[settling:]
    return np.asarray(values * (std / values.std()))


def paper_record(
    seed: int, noise_share: float = 0.01, samples: int = SAMPLES, **arguments: object
) -> Experiment:
    """60 s of the paper's plant under a PRBS held for 12 samples, with white noise on the output."""
    random = np.random.default_rng(seed)
    u = prbs(samples, 12, random)
    y = PAPER.simulate(u)
    y = y + noise_share * y.std() * random.standard_normal(samples)
    return Experiment(u, y, PERIOD_S, **arguments)  # type: ignore[arg-type]


def clean_fit(model: DiscreteModel, seed: int) -> float:
    """Fit of a model to the paper's plant, without noise and from rest, on an input that was not used."""
    u = prbs(SAMPLES, 12, np.random.default_rng(1_000_000 + seed))
    y = PAPER.simulate(u)
    return 100.0 * (1.0 - float(np.linalg.norm(y - model.simulate(u)) / np.linalg.norm(y - y.mean())))


@dataclass(frozen=True)
class RandomPlant:
    """A stable sampled plant whose modes lie between 1/200 and half the sampling frequency."""

    model: DiscreteModel
    continuous: ContinuousModel


def random_plant(random: np.random.Generator, order: int, delay: int = 0) -> RandomPlant:
    """Draw a plant of this order, with a sample time of 1 s, all of whose modes matter for the output."""
    sections = PoleSections.of_order(order, 1.0)
    while True:
        theta = [np.log(10.0 ** random.uniform(-2.0, 0.0))] * sections.real
        for _ in range(sections.pairs):
            theta += [np.log(10.0 ** random.uniform(-1.5, 0.2)), np.log(10.0 ** random.uniform(-1.3, 0.3))]
        den = as_polynomial(sections.continuous(np.array(theta)))
        num = np.ones(1)
        for _ in range(random.integers(0, order)):
            num = np.polymul(
                num, [1.0, random.choice([1.0, 1.0, 1.0, -1.0]) * 10.0 ** random.uniform(-2.0, 0.5)]
            )
        continuous = ContinuousModel(num * den[-1] / num[-1], den, float(delay))
        model = hold(continuous, 1.0)
        if hankel_ratio(model) > 2e-3:
            return RandomPlant(model, invert_hold(model))


def hankel_ratio(model: DiscreteModel) -> float:
    """Smallest Hankel singular value of a sampled model as a share of the largest."""
    response = model.simulate(np.eye(1, 600 + model.nk)[0])[model.nk :]
    start, shift = np.meshgrid(np.arange(0, 300, 4), np.arange(0, 300, 4))
    singular = np.linalg.svd(response[start + shift], compute_uv=False)
    return float(singular[model.order - 1] / singular[0])
