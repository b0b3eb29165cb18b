"""The search for parameters, and the poles in logarithms that it works on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from design.identification.estimators.levenberg_marquardt import minimise
from design.identification.estimators.pole_sections import PoleSections, from_poles, regrouped

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Point:
    """A candidate."""

    theta: Array
    residual: Array

    @property
    def cost(self) -> float:
        return float(self.residual @ self.residual)


class Rosenbrock:
    """The curved valley (10 (y - x²), 1 - x), which is not admissible for x < -1.5."""

    max_step, residuals, scale = 5.0, 2, 1.0

    def __init__(
        self, lower: tuple[float, float] = (-9.0, -9.0), upper: tuple[float, float] = (9.0, 9.0)
    ) -> None:
        self.lower, self.upper = np.array(lower), np.array(upper)

    def trial(self, theta: Array) -> Point | None:
        x, y = theta
        return None if x < -1.5 else Point(theta, np.array([10.0 * (y - x * x), 1.0 - x]))

    def linearised(self, trial: Point) -> tuple[Array, Array]:
        return np.array([[20.0 * trial.theta[0], -10.0], [1.0, 0.0]]), trial.residual


def test_a_curved_valley() -> None:
    outcome = minimise(Rosenbrock(), np.array([-1.2, 1.0]))
    assert outcome is not None
    assert outcome.converged
    np.testing.assert_allclose(outcome.theta, [1.0, 1.0], atol=1e-6)
    assert not outcome.at_bound.any()


def test_a_bound_holds() -> None:
    outcome = minimise(Rosenbrock(upper=(0.5, 9.0)), np.array([-1.2, 1.0]))
    assert outcome is not None
    assert outcome.converged
    np.testing.assert_allclose(outcome.theta, [0.5, 0.25], atol=1e-4)
    assert outcome.at_bound.tolist() == [True, False]


def test_a_start_that_is_not_admissible() -> None:
    assert minimise(Rosenbrock(), np.array([-2.0, 1.0])) is None


def test_a_search_ends() -> None:
    outcome = minimise(Rosenbrock(), np.array([-1.2, 1.0]), max_rounds=2)
    assert outcome is not None
    assert not outcome.converged
    assert outcome.rounds == 2


@pytest.mark.parametrize("log_zeta", [-8.0, -0.5, -1e-6, 0.0, 1e-6, 0.7, 5.0])
def test_the_slopes_of_pole_sections(log_zeta: float) -> None:
    sections = PoleSections(1, 2, 0.1)
    theta = np.array([0.3, 1.0, -0.5, 2.0, log_zeta])
    f, slopes = sections.f_and_slopes(theta)
    step = 1e-6
    numeric = [(sections.f(theta + d) - sections.f(theta - d)) / (2.0 * step) for d in step * np.eye(5)]
    np.testing.assert_allclose(slopes, np.array(numeric).T, atol=1e-8)
    poles = np.concatenate([np.roots(section) for section in sections.continuous(theta)])
    np.testing.assert_allclose(np.poly(np.exp(0.1 * poles)).real, f, atol=1e-12)


def test_sections_from_poles_and_back() -> None:
    sections = PoleSections.of_order(5, 0.1)
    poles = np.array([-0.5, -3.0, -4.0, -1.0 + 2.0j, -1.0 - 2.0j])
    theta = from_poles(poles, sections)
    assert theta is not None
    back = np.concatenate([np.roots(section) for section in sections.continuous(theta)])
    np.testing.assert_allclose(np.sort_complex(back), np.sort_complex(poles), atol=1e-9)
    assert from_poles(poles[1:], sections) is None


def test_real_poles_are_regrouped_by_size() -> None:
    """The poles 1 and 9 in one section and 1 alone cannot become a pair; 1 and 1 in one section can."""
    sections = PoleSections.of_order(3, 0.1)
    theta = np.array([np.log(9.0), 0.0, 0.0])
    assert regrouped(sections, theta)[0] == pytest.approx(0.0, abs=1e-6)
