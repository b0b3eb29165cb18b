"""The options that choose a plant, shared by ``firmware-sim`` and ``hil run``."""

from __future__ import annotations

import argparse

import pytest

from firmware_sim.plant_options import (
    add_plant_options,
    check_plant_options,
    given_plant_options,
    named_plants,
    plant_arguments,
)
from hil.core.errors import DocumentError


def options(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_plant_options(parser)
    return parser.parse_args(arguments)


@pytest.mark.parametrize(
    "given",
    [
        [],
        ["--linear"],
        ["--seed", "7", "--scenario", "fig14", "--event", "payload:1@1", "--event", "leak:vertical,1,1e-8@2"],
        ["--arm", "my arm.toml"],
        ["--fault", "lose:sample,5@2", "--fault", "hang:adc@vertical>0.05/0.5", "--seed", "1"],
        ["--plant", "vertical=my plant.json", "--plant", "rotation=a=b.json"],
    ],
)
def test_options_are_the_same_after_conversion_to_arguments(given: list[str]) -> None:
    assert options(*plant_arguments(options(*given))) == options(*given)


@pytest.mark.parametrize(
    ("given", "names"),
    [
        ([], []),
        (["--seed", "7", "--scenario", "fig13"], []),
        (["--arm", "a.toml", "--event", "payload:1@1"], ["--arm", "--event"]),
        (["--fault", "unplug@1"], ["--fault"]),
        (["--linear", "--plant", "vertical=paper"], ["--linear", "--plant"]),
    ],
)
def test_options_of_a_simulation_are_listed(given: list[str], names: list[str]) -> None:
    assert given_plant_options(options(*given)) == names


def test_the_file_of_each_axis_is_split_off() -> None:
    assert named_plants(["vertical=plant.json", "rotation=a=b.json"]) == {
        "vertical": "plant.json",
        "rotation": "a=b.json",
    }


@pytest.mark.parametrize("text", ["plant.json", "=plant.json", "vertical=", ""])
def test_a_plant_without_axis_or_file_is_rejected(text: str) -> None:
    with pytest.raises(DocumentError, match=f"--plant {text!r}: not AXIS=FILE, such as vertical=plant.json"):
        check_plant_options(options("--plant", text))


def test_an_axis_given_twice_is_rejected() -> None:
    with pytest.raises(DocumentError, match=r"--plant vertical: given twice, 'a\.json' and 'b\.json'"):
        check_plant_options(options("--plant", "vertical=a.json", "--plant", "vertical=b.json"))


def test_a_fault_that_cannot_be_read_is_refused_before_anything_runs() -> None:
    with pytest.raises(DocumentError, match=r"--fault 'hang:third@1': board is 'third'"):
        check_plant_options(options("--fault", "hang:third@1"))
