"""The closed loop of a controller with the plant of its file, against scipy's sampling."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from scipy.signal import cont2discrete, tf2ss
from support.constants import PERIOD_S

from hil.core.closed_loop_poles import check_closed_loop, largest_pole
from hil.core.control_law import realise
from hil.core.controller_file import ControllerFile, Law, PidLaw, StateSpaceLaw, TransferFunctionLaw
from hil.core.errors import DocumentError
from hil.host.controller_files import SHIPPED_CONTROLLERS
from hil.shells.run_setup import load_controller

EQ_15 = {"num": [0.47947, 0.47947 * 90.76], "den": np.polymul([1.0, 0.4231], [1.0, 16.97, 167.9]).tolist()}
LAWS: list[Law] = [
    PidLaw(kp=11.6, ki=5.1, kd=0.25, tau_d=0.024),
    PidLaw(kp=3.0, ki=0.0),
    TransferFunctionLaw(num=[0.5, -0.3], den=[1.0, -1.2, 0.3]),
    StateSpaceLaw(A=[[0.9]], B=[[0.1, -0.2]], C=[[1.0]], D=[[0.3, -0.4]], inputs="r, y"),
]


def controller(law: Law, plant: Any) -> ControllerFile:
    return ControllerFile(
        format="hil-controller",
        version=1,
        name="test",
        description="",
        sample_time_s=PERIOD_S,
        input_unit="m",
        output_unit="V",
        law=law,
        origin={} if plant is None else {"plant": plant},
    )


def fine_modulus(law: Law, plant: dict[str, Any], delay: float) -> float:
    """Largest closed-loop pole over a period, from a simulation of the plant in 1/8 periods with scipy."""
    parts = 8
    A, B, C, _ = tf2ss(plant["num"], plant["den"])
    Af, Bf, *_ = cont2discrete((A, B, C, np.zeros((1, 1))), PERIOD_S / parts)
    steps = round(delay * parts)
    n, inputs = len(Af), -(-steps // parts)
    K = realise(law, PERIOD_S)
    bk, dk = K.B[:, [1]], K.D[:, [1]]
    size = n + inputs + len(K.A)

    def period(state: np.ndarray) -> np.ndarray:
        x, old, xk = state[:n], state[n : n + inputs], state[n + inputs :]
        y = C @ x
        u = (K.C @ xk + dk @ y)[0]
        given = [*old, u]  # the oldest first; given[-1] is the command of this period
        for k in range(parts):
            age = -((k - steps) // parts)
            x = Af @ x + Bf[:, 0] * given[len(given) - 1 - age]
        return np.concatenate([x, given[1:] if inputs else [], K.A @ xk + bk[:, 0] * y[0]])

    loop = np.column_stack([period(column) for column in np.eye(size)])
    return float(np.max(np.abs(np.linalg.eigvals(loop))))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("delay_periods", [0, 1])
@pytest.mark.parametrize(
    ("dead_time", "contained"), [(0.0, 0), (1.0, 1), (1.0, 0), (0.5, 0), (2.25, 0), (3.375, 1)]
)
def test_poles_are_those_of_a_simulation(
    law: Law, delay_periods: int, dead_time: float, contained: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = {**EQ_15, "dead_time_s": dead_time * PERIOD_S, "contains_delay_samples": contained}
    moduli: list[float] = []

    def keep(*arguments: Any) -> float:
        moduli.append(largest_pole(*arguments))
        return 0.5

    monkeypatch.setattr("hil.core.closed_loop_poles.largest_pole", keep)
    assert check_closed_loop(controller(law, plant), "file", delay_periods)
    expected = fine_modulus(law, plant, dead_time - contained + delay_periods)
    assert moduli == [pytest.approx(expected, rel=1e-8)]


@pytest.mark.parametrize("name", ["horizontal", "rotation"])
def test_shipped_controllers_stabilise_their_plants(name: str) -> None:
    assert check_closed_loop(load_controller(name), name, 1)


@pytest.mark.parametrize("name", [path.stem for path in SHIPPED_CONTROLLERS.glob("*.json")])
def test_no_shipped_controller_is_refused(name: str) -> None:
    check_closed_loop(load_controller(name), name, 1)


def test_positive_feedback_is_refused_with_the_modulus() -> None:
    file = json.loads((SHIPPED_CONTROLLERS / "horizontal.json").read_text())
    wrong = controller(PidLaw(kp=-11.6, ki=-5.1), file["origin"]["plant"])
    with pytest.raises(
        DocumentError, match=r"file: the closed loop .* its pole z = \S+ has the modulus 1\.0\d+, "
    ):
        check_closed_loop(wrong, "file", 1)


def test_a_loop_on_the_edge_of_stability_is_refused() -> None:
    with pytest.raises(DocumentError, match="the modulus 1, but must be below 1"):
        check_closed_loop(controller(PidLaw(kp=0.0, ki=0.0), {"num": [1.0], "den": [1.0, 0.0]}), "file", 0)


@pytest.mark.parametrize(
    "plant",
    [
        None,
        "eq. (15)",
        {},
        {"num": [1.0]},
        {"num": [1.0], "den": []},
        {"num": [1.0], "den": [0.0]},
        {"num": ["1"], "den": [1.0, 1.0]},
        {"num": [1.0, 2.0], "den": [1.0, 1.0]},
        {"num": [1.0], "den": [1.0] * 30},
        {"num": [1.0], "den": [1.0, float("nan")]},
        {"num": [1.0], "den": [1.0, 1.0], "dead_time_s": "1"},
        {"num": [1.0], "den": [1.0, 1.0], "dead_time_s": 1e9},
        {"num": [1.0], "den": [1.0, 1.0], "dead_time_s": float("nan")},
        {"num": [1.0], "den": [1.0, 1.0], "contains_delay_samples": 2},
        {"num": [1.0], "den": [1.0, 1.0], "contains_delay_samples": 0.5},
    ],
)
def test_a_file_without_a_plant_that_can_be_checked_is_not_refused(plant: Any) -> None:
    assert not check_closed_loop(controller(PidLaw(kp=-1e6, ki=0.0), plant), "file", 1)


def test_leading_zeros_of_a_polynomial_do_not_count() -> None:
    plant = {"num": [0.0, 0.0, 1.0], "den": [0.0, 1.0, 1.0]}
    assert check_closed_loop(controller(PidLaw(kp=1.0, ki=1.0), plant), "file", 1)
