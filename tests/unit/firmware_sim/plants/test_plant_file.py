"""The plant document as the simulation reads it."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

import pytest
from support.shipped_rig import SHIPPED_RIG

from design.models.plant import read_plant
from firmware_sim.plants.linear_model import EQUATION_15, LinearModel
from firmware_sim.plants.plant_file import check_plant_fits, read_plant_file
from hil.core.errors import DocumentError

PLANT: dict[str, Any] = {
    "format": "hil-plant",
    "version": 1,
    "name": "mine",
    "input_unit": "V",
    "output_unit": "m",
    "num": [0.5],
    "den": [1.0, 2.0],
}


def text(**changes: object) -> str:
    return json.dumps({key: value for key, value in {**PLANT, **changes}.items() if value is not None})


def test_a_document_gives_its_model() -> None:
    assert read_plant_file(text(), "plant.json").model == LinearModel((0.5,), (1.0, 2.0))
    assert read_plant_file(text(dead_time_s=0.0056), "plant.json").model == LinearModel(
        (0.5,), (1.0, 2.0), 0.0056
    )


@pytest.mark.parametrize(
    ("periods", "dead_time_s", "own_s"),
    [(0, 0.0168, 0.0168), (1, 0.0168, 0.0056), (1, 0.0112, 0.0), (3, 0.0336, 0.0)],
)
def test_the_rigs_transport_delay_is_not_simulated_twice(
    periods: int, dead_time_s: float, own_s: float
) -> None:
    """The simulated boards delay a command themselves, so the plant has only the rest of its dead time."""
    document = text(sample_time_s=0.0112, dead_time_s=dead_time_s, contains_delay_samples=periods)
    assert read_plant_file(document, "plant.json").model.dead_time_s == own_s


def test_keys_that_a_simulation_does_not_need_are_ignored() -> None:
    document = text(description="of the arm", sample_time_s=0.0112, origin={"fit": 98.1}, covariance=[[1.0]])
    assert read_plant_file(document, "plant.json").name == "mine"


@pytest.mark.parametrize("name", ["paper", "vertical", "horizontal", "rotation", "rotation-loaded"])
def test_every_shipped_plant_is_read_as_design_reads_it(name: str) -> None:
    document = (files("design.models") / f"plants/{name}.json").read_text()
    ours, designs = read_plant_file(document, name), read_plant(document, name)
    assert (ours.model.num, ours.model.den) == (tuple(designs.num), tuple(designs.den))
    assert ours.output_unit == designs.output_unit


def test_the_shipped_paper_plant_is_equation_15() -> None:
    document = (files("design.models") / "plants/paper.json").read_text()
    model = read_plant_file(document, "paper").model
    assert model.num == pytest.approx(EQUATION_15.num, rel=1e-6)
    assert model.den == pytest.approx(EQUATION_15.den, rel=1e-6)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ("{", "plant.json: not valid JSON"),
        ("[]", "plant.json: the document is a list, but must be a table"),
        (
            text(format="hil-controller"),
            "plant.json: this is a controller file, not a plant file; `hil run --controller",
        ),
        (text(version=3), "plant.json: version is 3, but must be "),
        (text(input_unit="bar"), "plant.json: input_unit is 'bar', but must be 'V'"),
        (text(output_unit="mm"), "plant.json: output_unit is 'mm', but must be 'm' or 'rad'"),
        (text(num=None), "num"),
        (text(num="1"), "plant.json: num is '1', but must be a list"),
        (text(num=[]), "plant.json: num has 0 entries, but must have at least 1"),
        (text(den=[1.0, float("nan")]), "plant.json: den[1]: nan is not a finite number"),
        (text(den=[0.0]), "plant.json: den: all coefficients are 0"),
        (text(num=[0.0]), "plant.json: num: all coefficients are 0: the valve would not move the axis"),
        (text(num=[1.0, 0.0, 0.0]), "plant.json: num has degree 2 and den has degree 1"),
        (text(den=[1.0] * 3000), "plant.json: den has 3000 entries, but must have at most "),
        (text(den=[1.0] * 60), "plant.json: den: degree 59 exceeds the limit of 20"),
        (
            text(contains_delay_samples=1, dead_time_s=0.0112),
            "contains_delay_samples: 1 periods, but sample_time_s, the length of a period, is missing",
        ),
        (
            text(contains_delay_samples=1, dead_time_s=0.0111, sample_time_s=0.0112),
            "plant.json: contains_delay_samples: 1 periods of 0.0112 s are longer than dead_time_s, 0.0111 s",
        ),
        (text(dead_time_s=-0.1), "plant.json: dead_time_s is -0.1, but must be at least 0.0"),
        (text(dead_time_s=1e9), "plant.json: dead_time_s is 1000000000.0, but must be at most 10.0"),
    ],
)
def test_an_invalid_document_is_rejected_with_file_and_key(document: str, message: str) -> None:
    with pytest.raises(DocumentError) as caught:
        read_plant_file(document, "plant.json")
    assert str(caught.value).startswith("plant.json: ")
    assert message in str(caught.value)


def test_a_plant_in_another_unit_is_rejected_with_both_units() -> None:
    plant = read_plant_file(text(output_unit="rad"), "plant.json")
    check_plant_fits(plant, "plant.json", "rotation", SHIPPED_RIG.axes["rotation"].unit)
    with pytest.raises(DocumentError) as caught:
        check_plant_fits(plant, "plant.json", "vertical", "m")
    assert str(caught.value) == (
        "plant.json: output_unit: rad, but axis vertical is in m (rig file: axes.vertical.unit); choose a "
        "plant that was identified in m"
    )
