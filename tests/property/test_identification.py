"""Random records of known systems: the confidence regions hold, and the models predict new data.

Each record has a system of order 1 to 6, a dead time, an offset, an unknown initial state, noise of some
colour, and gaps. All records are drawn from fixed seeds, so that the counts below are the same on every run.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import binom, chi2

from design.identification.analysis.comparison import compare
from design.identification.analysis.uncertainty import propagate, properties
from design.identification.estimators.estimate import Estimate, Models
from design.identification.estimators.fit import fit
from design.identification.models.difference_basis import basis
from design.identification.models.held_discretisation import hold
from design.identification.models.model import ContinuousModel, DiscreteModel
from design.identification.models.structures import ContinuousPoles, OutputError, Structure
from design.identification.records.experiment import Experiment

pytestmark = pytest.mark.timeout(600)  # a count over many records, on a loaded machine

Array = NDArray[np.float64]

T = 0.01
SAMPLES = 2400
VALIDATION_SAMPLES = 1500
RECORDS = {"output error": 60, "continuous": 18}
"""Number of records for each structure, the same for every order from 1 to 6."""
FREQUENCIES_RAD_S = (1.0, 7.0, 25.0)
"""Frequencies at which the response is compared: below, among and above most poles."""
NOISE = 0.05
"""Standard deviation of the noise, as a share of that of the output."""
COLOURS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "white": ((1.0,), (1.0,)),
    "slow": ((1.0,), (1.0, -0.8)),
    "fast": ((1.0, -0.6), (1.0,)),
    "resonant": ((1.0, 0.3), (1.0, -1.4, 0.8)),
}
"""Numerator and denominator of the noise filters in powers of z^-1."""
RARE = 1e-4
"""Probability at which a count of records is called wrong."""


class Poles(NamedTuple):
    """Continuous poles (real) in rad/s; natural frequencies in rad/s and damping ratios of the pairs."""

    real: Array
    natural: Array
    damping: Array

    @property
    def den(self) -> Array:
        den = np.ones(1)
        for pole in self.real:
            den = np.convolve(den, [1.0, pole])
        for omega, zeta in zip(self.natural, self.damping, strict=True):
            den = np.convolve(den, [1.0, 2.0 * zeta * omega, omega * omega])
        return den


class Case(NamedTuple):
    """One record, and the deviation of the estimate from the system that the record is from."""

    estimate: Estimate
    true: DiscreteModel
    gain_distance: float
    """Squared distance of the true static gain from the estimate, in units of its variance."""
    response_distances: tuple[float, ...]
    """Squared distances of the true frequency response from the estimate, in units of its covariance."""
    true_fit_percent: float
    """Fit of the true system on validation data."""
    fit_percent: float


def draw_poles(random: np.random.Generator, order: int) -> Poles:
    """Draw stable poles whose speeds are a factor of at least 1.5 apart, from 2 to 60 rad/s."""
    pairs = order // 2 if order > 2 else int(random.integers(0, order // 2 + 1))
    sections = order - pairs
    edges = np.geomspace(2.0, 60.0, sections + 1)
    width = (edges[1] / edges[0]) ** 0.5 if sections > 2 else 3.0
    speeds = random.permutation(edges[:-1] * width ** random.uniform(0.1, 0.9, sections))
    return Poles(speeds[pairs:], speeds[:pairs], random.uniform(0.1, 0.6, pairs))


def excitation(random: np.random.Generator, samples: int) -> Array:
    """Draw plus and minus ones that change at most every few samples, about an offset."""
    kept = int(random.integers(2, 6))
    return np.repeat(random.choice([-1.0, 1.0], samples // kept + 1), kept)[:samples] + random.normal()


def record(random: np.random.Generator, model: DiscreteModel, colour: str) -> Experiment:
    """Draw a record with an unknown initial state, an offset, noise, lost outputs and a lost burst."""
    before = 200
    u = excitation(random, before + SAMPLES)
    y = model.simulate(u)[before:]
    num, den = COLOURS[colour]
    noise = lfilter(num, den, random.standard_normal(before + SAMPLES))[before:]
    y = y + NOISE * y.std() * noise / noise.std() + 3.0 * y.std() * random.normal()
    u = u[before:].copy()
    y[random.random(SAMPLES) < 0.02] = np.nan
    lost = int(random.integers(SAMPLES // 4, SAMPLES // 2))
    u[lost : lost + 50] = y[lost : lost + 50] = np.nan
    return Experiment(u, y, T)


def validation(random: np.random.Generator, model: DiscreteModel) -> Experiment:
    u = excitation(random, VALIDATION_SAMPLES)
    y = model.simulate(u)
    return Experiment(u, y + NOISE * y.std() * random.standard_normal(len(u)), T)


def squared_distance(values: Array, covariance: Array, true: Array) -> float:
    """Return (x - x0)' P^-1 (x - x0), with P scaled so that its digits are kept."""
    scale = np.sqrt(np.diag(covariance))
    deviation = (values - true) / scale
    return float(deviation @ np.linalg.solve(covariance / np.outer(scale, scale), deviation))


def response_distance(estimate: Estimate, model: DiscreteModel, omega_rad_s: float) -> float:
    """Return the squared distance of the true response, from the 2 by 2 covariance of the estimated one."""

    def parts(models: Models) -> Array:
        return np.array([models.discrete.at(omega_rad_s).real, models.discrete.at(omega_rad_s).imag])

    true = model.at(omega_rad_s)
    return squared_distance(*propagate(estimate.parameters, parts), np.array([true.real, true.imag]))


def identified(random: np.random.Generator, model: DiscreteModel, structure: Structure, colour: str) -> Case:
    """Fit one record of the model, and compare the estimate with it."""
    estimate = fit([record(random, model, colour)], structure)
    other = validation(random, model)
    gain = properties(estimate).gain
    assert gain is not None
    return Case(
        estimate,
        model,
        ((gain.value - model.gain) / gain.std) ** 2,
        tuple(response_distance(estimate, model, omega) for omega in FREQUENCIES_RAD_S),
        compare(model, other).fit_percent,
        compare(estimate.discrete, other).fit_percent,
    )


def output_error_case(index: int) -> Case:
    random, order = np.random.default_rng([1, index]), index % 6 + 1
    f = hold(ContinuousModel(np.ones(1), draw_poles(random, order).den), T).f
    nb, nk = (1 if order < 3 else int(random.integers(1, 3))), int(random.integers(1, 5))
    b = random.uniform(0.5, 2.0, nb) * random.choice([-1.0, 1.0])
    model = DiscreteModel(b * f.sum() / b.sum(), f, nk, T)
    return identified(random, model, OutputError(nb, order, nk), _colour(index))


def continuous_case(index: int) -> Case:
    random, order = np.random.default_rng([2, index]), index % 6 + 1
    poles = draw_poles(random, order)
    dead_samples = random.uniform(0.3, 3.7)
    gain = random.uniform(0.5, 2.0) * random.choice([-1.0, 1.0])
    model = ContinuousModel(gain * poles.den[-1:], poles.den, dead_samples * T)
    structure = ContinuousPoles(len(poles.real), len(poles.natural), max_dead_time_s=5.0 * T)
    return identified(random, hold(model, T), structure, _colour(index))


def _colour(index: int) -> str:
    return list(COLOURS)[index // 6 % len(COLOURS)]


@cache
def cases(kind: str) -> tuple[Case, ...]:
    make = {"output error": output_error_case, "continuous": continuous_case}[kind]
    return tuple(make(index) for index in range(RECORDS[kind]))


def assert_probable(inside: int, records: int, level: float) -> None:
    """Assert that so many of the records can lie inside regions of this confidence level."""
    fewest, most = binom.ppf([RARE, 1.0 - RARE], records, level)
    assert fewest <= inside <= most


KINDS = pytest.mark.parametrize("kind", ["output error", "continuous"])
LEVELS = pytest.mark.parametrize("level", [0.5, 0.9, 0.99])


@KINDS
@LEVELS
@pytest.mark.parametrize("index", range(len(FREQUENCIES_RAD_S)))
def test_region_of_the_response_contains_the_true_one_as_often_as_it_should(
    kind: str, level: float, index: int
) -> None:
    # At order 6, other sets of poles than the true ones often explain a record as well or better: the best
    # model then lies far from the true system, and its region does not contain it. The report says so.
    counted = [case for case in cases(kind) if kind == "continuous" or case.true.order < 6]
    inside = sum(case.response_distances[index] <= chi2.ppf(level, 2) for case in counted)
    assert_probable(inside, len(counted), level)


@KINDS
@LEVELS
def test_interval_of_the_gain_contains_the_true_one_as_often_as_it_should(kind: str, level: float) -> None:
    inside = sum(case.gain_distance <= chi2.ppf(level, 1) for case in cases(kind))
    assert_probable(inside, RECORDS[kind], level)


@LEVELS
def test_region_of_all_parameters_contains_the_true_ones_as_often_as_it_should(level: float) -> None:
    # From order 4 on, the parameters of F are determined so unequally that the region is no ellipsoid.
    small = [case for case in cases("output error") if case.true.order <= 3]
    inside = 0
    for case in small:
        found, true = case.estimate.parameters, case.true
        values = np.concatenate([basis(len(true.b)) @ true.b, basis(true.order) @ true.f[1:]])
        distance = squared_distance(found.values, found.covariance, values)
        inside += distance <= chi2.ppf(level, len(values))
    assert_probable(inside, len(small), level)


@KINDS
def test_model_predicts_new_data_nearly_as_well_as_the_true_system(kind: str) -> None:
    assert max(case.true_fit_percent - case.fit_percent for case in cases(kind)) < 1.0


@KINDS
def test_search_converges_for_every_order(kind: str) -> None:
    assert all(case.estimate.converged for case in cases(kind))
