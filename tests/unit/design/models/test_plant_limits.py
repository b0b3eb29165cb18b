"""Plants that are hard or impossible to control, and what is said about them."""

from __future__ import annotations

import numpy as np
import pytest
from support.paper_loop import PERIOD_S, W1

from design.closed_loop.specifications import Specification
from design.errors import DesignError, InfeasibleError, NotStabilisedError
from design.models.plant import Plant, paper_plant
from design.models.plant_limits import hidden_unstable_mode, performance_limits
from design.models.sampling import Sampling
from design.robustness.central_controller import central_controllers, optimal_margins
from design.robustness.loop_shaping import shaped
from design.synthesis.design_file import read_design
from design.synthesis.fixed_structure import synthesise
from design.synthesis.procedure import design_controller
from design.synthesis.recommendation import recommend
from design.synthesis.structures import STRUCTURES
from design.synthesis.weight_selection import select_weight


def plant(num: list[float], den: list[float]) -> Plant:
    return Plant(format="hil-plant", version=1, name="p", input_unit="V", output_unit="m", num=num, den=den)


def limits(num: list[float], den: list[float], delay_s: float = 0.0, wanted_rad_s: float = 0.0) -> str:
    return "; ".join(performance_limits(np.array(num), np.array(den), delay_s, wanted_rad_s))


def test_only_hidden_unstable_modes_are_refused() -> None:
    assert hidden_unstable_mode(np.array([1.0, 1.0]), np.array([1.0, 3.0, 2.0])) is None
    assert hidden_unstable_mode(np.array([1.0, -1.001]), np.array([1.0, 2.0, -3.0])) is None
    assert hidden_unstable_mode(np.array([1.0]), np.array([1.0, 0.0, 0.0])) is None
    assert hidden_unstable_mode(np.array([1.0, -1.0]), np.array([1.0, 2.0, -3.0])) == pytest.approx(1.0)


def test_an_easy_plant_has_no_limits() -> None:
    G = paper_plant().transfer_function()
    assert performance_limits(G.num, G.den, 0.0168, 4.0) == []


@pytest.mark.parametrize(
    ("num", "den", "said"),
    [
        (
            [-1.0, 0.2],
            [1.0, 3.0, 2.0],
            "zero at s = 0.2 (it first moves in the wrong direction) allows no crossover",
        ),
        ([1.0], [1.0, -2.0], "unstable pole at s = 2 needs a crossover over about 4 rad/s"),
        ([1.0, -1.001], [1.0, 2.0, -3.0], "s = 1 is nearly cancelled by its zero at 1.001"),
        ([1.0], [1.0, 0.0, 0.0], "2 integrators make a step overshoot"),
        ([1.0, 0.0], [1.0, 3.0, 2.0], "gain is 0 at s = 0"),
    ],
)
def test_what_makes_a_plant_hard_is_named(num: list[float], den: list[float], said: str) -> None:
    assert said in limits(num, den)


def test_a_delay_is_named_only_if_it_matters() -> None:
    assert limits([1.0], [1.0, 1.0], 0.02, 4.0) == ""
    assert "allow no crossover over 50 rad/s" in limits([1.0], [1.0, 1.0], 0.02, 60.0)
    assert "allow no crossover over 50 rad/s" in limits([1.0], [1.0, -30.0], 0.02)


def test_an_error_names_the_limits_of_the_plant_beside_the_specifications() -> None:
    slow_zero = plant([-1.0, 0.2], [1.0, 3.0, 2.0])
    with pytest.raises(InfeasibleError, match=r"at a search bound: .*a; (.|\n)*zero at s = 0.2"):
        select_weight(slow_zero, evaluations=300)
    with pytest.raises(InfeasibleError, match=r"2 integrators make a step overshoot"):
        select_weight(plant([1.0], [1.0, 0.0, 0.0]), evaluations=300)
    with pytest.raises(NotStabilisedError, match=r"delay, 0.0168 s, allow no crossover over 59.5 rad/s"):
        fast = plant([100.0], [1.0, 50.0, -50000.0])
        synthesise(fast, W1, STRUCTURES["pi"], sampling=Sampling(PERIOD_S, 1), evaluations=300)


@pytest.mark.parametrize(("num", "den"), [([1.0, -1.0], [1.0, 2.0, -3.0]), ([1.0, 0.0], [1.0, 3.0, 0.0])])
def test_a_hidden_unstable_mode_is_not_blamed_on_the_specifications(
    num: list[float], den: list[float]
) -> None:
    """The plant need not come from a file."""
    hidden = plant(num, den)
    for design in (
        lambda: select_weight(hidden, specifications=[Specification("overshoot", 10.0)]),
        lambda: synthesise(hidden, W1, STRUCTURES["pid"]),
    ):
        with pytest.raises(DesignError, match=r"plant p: .*(cancelled by a zero|share the root s = 0)"):
            design()
    Gs = shaped(hidden.transfer_function(), W1)
    assert optimal_margins(Gs)[0] == pytest.approx(0.0, abs=1e-6)
    central_controllers(Gs)


def test_a_margin_that_no_controller_exceeds_is_not_blamed_on_the_structure() -> None:
    short = "[search]\ncontroller_evaluations = 3000\n"
    design = design_controller(read_design(short, "d.toml"), plant([-1.0, 2.0], [1.0, 3.0, 2.0]))
    assert design.problem.eps_opt > 0.25 > design.eps > 0.9 * design.problem.eps_opt
    (objection,) = (text for text in recommend(design).objections if "0.25" in text)
    assert "no controller has more than" in objection
    assert "structure" not in objection
