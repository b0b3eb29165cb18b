"""Structures: their polynomials, the laws that the gateway runs, and a user's own class."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from support.paper_loop import PERIOD_S, W1

from design.errors import DesignError
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array
from design.models.controller import controller_of_law
from design.models.plant import paper_plant
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction
from design.robustness.central_controller import central_controllers
from design.robustness.loop_shaping import shaped
from design.robustness.margins import stability_margin
from design.search.bounds import Parameter
from design.synthesis.structures import (
    STRUCTURES,
    Controller,
    FreeTransferFunction,
    IntegralWeight,
    ProportionalIntegral,
    Structure,
    TustinLaw,
    one_degree_of_freedom,
    setpoint_parameters,
    structure_name,
    tustin_law,
)
from hil.core.controller_file import PidLaw, StateSpaceLaw, TransferFunctionLaw

SAMPLING = Sampling(PERIOD_S, 1)
G = paper_plant().transfer_function(SAMPLING)

EXPECTED = {
    "p": ([3.0], lambda s: 3.0),
    "pi": ([3.0, 2.0], lambda s: 3.0 + 2.0 / s),
    "pd": ([3.0, 0.5, 0.02], lambda s: 3.0 + 0.5 * s / (0.02 * s + 1.0)),
    "pid": ([3.0, 2.0, 0.5, 0.02], lambda s: 3.0 + 2.0 / s + 0.5 * s / (0.02 * s + 1.0)),
    "pid-2dof": ([3.0, 2.0, 0.5, 0.02, 0.7, 0.1], lambda s: 3.0 + 2.0 / s + 0.5 * s / (0.02 * s + 1.0)),
    "lead-lag": ([3.0, 0.2, 0.05], lambda s: 3.0 * (0.2 * s + 1.0) / (0.05 * s + 1.0)),
    "pi-lead": ([3.0, 2.0, 0.2, 0.05], lambda s: (3.0 + 2.0 / s) * (0.2 * s + 1.0) / (0.05 * s + 1.0)),
}


def value(H: TransferFunction, s: complex) -> complex:
    return complex(np.polyval(H.num[0], s) / np.polyval(np.broadcast_to(H.den, (1, H.den.shape[-1]))[0], s))


@pytest.mark.parametrize("name", STRUCTURES)
def test_polynomials_have_the_documented_transfer_function(name: str) -> None:
    values, formula = EXPECTED[name]
    K = STRUCTURES[name].controller(np.array([values]))
    assert value(K.feedback, 2.0j + 0.3) == pytest.approx(formula(2.0j + 0.3))
    assert len(values) == len(STRUCTURES[name].parameters)


@pytest.mark.parametrize("name", STRUCTURES)
def test_setpoint_parameters_are_found(name: str) -> None:
    assert setpoint_parameters(STRUCTURES[name]) == (("b", "c") if name == "pid-2dof" else ())


@pytest.mark.parametrize("name", STRUCTURES)
def test_the_law_has_the_margin_of_the_polynomials(name: str) -> None:
    values, _ = EXPECTED[name]
    structure = STRUCTURES[name]
    designed = structure.controller(np.array([values]))
    margin = stability_margin(G, designed.feedback, W1)[0]
    for law in (structure.law(values, PERIOD_S), tustin_law(designed, PERIOD_S)):
        running = controller_of_law(law, PERIOD_S)
        assert stability_margin(G, running.feedback, W1)[0] == pytest.approx(margin, rel=1e-12)
        s = 4.0j
        reference = value(TransferFunction(running.num_r, running.den), s)
        assert reference == pytest.approx(value(TransferFunction(designed.num_r, designed.den), s), rel=1e-11)


def test_every_structure_becomes_the_simplest_law_that_keeps_its_digits() -> None:
    kinds = {name: type(STRUCTURES[name].law(EXPECTED[name][0], PERIOD_S)) for name in STRUCTURES}
    assert kinds["pid"] is kinds["pid-2dof"] is kinds["p"] is PidLaw
    assert kinds["lead-lag"] is TransferFunctionLaw
    assert kinds["pi-lead"] is StateSpaceLaw, "two poles near z = 1 lose digits as a polynomial"


def test_a_law_with_slow_poles_keeps_its_margin() -> None:
    structure = STRUCTURES["pi-lead"]
    generator = np.random.default_rng(1)
    for values in 10.0 ** generator.uniform(-2.0, 2.0, (60, len(structure.parameters))):
        designed = structure.controller(values[None, :])
        running = controller_of_law(structure.law(values, 0.001), 0.001)
        margin = stability_margin(G, designed.feedback, W1)[0]
        assert stability_margin(G, running.feedback, W1)[0] == pytest.approx(margin, rel=1e-6, abs=1e-9)


def test_a_loop_shaping_controller_keeps_its_digits_as_a_law() -> None:
    K_inf, _ = central_controllers(shaped(G, W1))
    K = one_degree_of_freedom(poly.multiply(W1.num, K_inf.num), poly.multiply(W1.den, K_inf.den))
    law = tustin_law(K, PERIOD_S)
    assert isinstance(law, StateSpaceLaw)
    running = controller_of_law(law, PERIOD_S)
    designed = stability_margin(G, K.feedback, W1)[0]
    assert stability_margin(G, running.feedback, W1)[0] == pytest.approx(designed, rel=1e-10)
    assert value(running.feedback, 0.0) == pytest.approx(value(K.feedback, 0.0), rel=1e-9)


def test_free_transfer_function_has_coefficients_as_parameters() -> None:
    free = FreeTransferFunction(num_order=1, den_order=2, integrators=1)
    assert [parameter.name for parameter in free.parameters] == ["b1", "b0", "a1", "a0"]
    K = free.controller(np.array([[5.0, 4.0, 3.0, 2.0]]))
    s = 1.0j
    assert value(K.feedback, s) == pytest.approx((5.0 * s + 4.0) / (s * (s * s + 3.0 * s + 2.0)))
    with pytest.raises(DesignError, match="improper"):
        FreeTransferFunction(num_order=3, den_order=1)


def test_a_small_class_is_a_structure() -> None:
    @dataclass(frozen=True)
    class FilteredIntegral(TustinLaw):
        """ki/(s (tau s + 1))."""

        parameters: tuple[Parameter, ...] = (Parameter("ki", 0.1, 10.0), Parameter("tau", 0.01, 1.0))

        def controller(self, values: Array) -> Controller:
            ki, tau = values.T
            one = np.ones_like(ki)
            return one_degree_of_freedom(ki[:, None], np.stack([tau, one, 0.0 * one], axis=-1))

    mine = FilteredIntegral()
    assert isinstance(mine, Structure)
    running = controller_of_law(mine.law([2.0, 0.1], PERIOD_S), PERIOD_S)
    assert value(running.feedback, 3.0j) == pytest.approx(2.0 / (3.0j * (0.3j + 1.0)))


def test_the_integral_weight_is_equation_3() -> None:
    W = IntegralWeight().controller(np.array([[15.535, 6.83 / 15.535]])).feedback
    np.testing.assert_allclose(W.num[0], [15.535, 6.83])
    np.testing.assert_allclose(W.den[0], [1.0, 0.001])


def test_structures_are_named_as_in_a_design_file() -> None:
    assert [structure_name(structure) for structure in STRUCTURES.values()] == list(STRUCTURES)
    assert structure_name(FreeTransferFunction(num_order=1, den_order=1)) == "free"
    assert structure_name(IntegralWeight(b=0.01)) == "integral"

    class Mine(ProportionalIntegral):
        """A user's own class, named by the user."""

    assert structure_name(Mine()) == "Mine"
