"""A file of another kind is recognised, and the error says which command takes it."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import pytest

from design.models.plant import Plant, read_plant
from design.synthesis.design_file import DesignFile, example_text, read_design
from firmware_sim.arm.arm_file import ArmParameters, read_arm, shipped_arm_text
from firmware_sim.scenario import SHIPPED as SCENARIOS
from firmware_sim.scenario import Scenario, read_scenario
from hil.core.controller_file import ControllerFile, read_controller
from hil.core.document_kinds import FILE_KINDS, kind_with_keys
from hil.core.documents import to_json
from hil.core.errors import DocumentError
from hil.core.rig import Rig, read_rig

SHIPPED = files("hil.shipped")
PLANT = (files("design.models") / "plants/vertical.json").read_text("utf-8")
FILES: dict[str, tuple[str, Callable[[str, str], object], type]] = {
    "a rig file": ((SHIPPED / "rig.toml").read_text("utf-8"), read_rig, Rig),
    "a design file": (example_text(), read_design, DesignFile),
    "a scenario": ((SCENARIOS / "fig14.toml").read_text("utf-8"), read_scenario, Scenario),
    "an arm file": (shipped_arm_text(), read_arm, ArmParameters),
    "a controller file": (
        (SHIPPED / "controllers/hls.json").read_text("utf-8"),
        read_controller,
        ControllerFile,
    ),
    "a plant file": (PLANT, read_plant, Plant),
}


def refusal(read: Callable[[str, str], object], text: str) -> str:
    with pytest.raises(DocumentError) as caught:
        read(text, "my.file")
    return str(caught.value)


def test_every_kind_is_known_by_the_keys_of_its_type() -> None:
    assert [kind.name for kind in FILE_KINDS] == list(FILES)
    for name, (_, _, document) in FILES.items():
        kind = kind_with_keys(document.__struct_fields__)  # type: ignore[attr-defined]
        assert kind is not None and kind.name == name


@pytest.mark.parametrize("given", FILES)
@pytest.mark.parametrize("wanted", FILES)
def test_a_file_in_the_place_of_another(given: str, wanted: str) -> None:
    text, read = FILES[given][0], FILES[wanted][1]
    if given == wanted:
        read(text, "my.file")
        return
    command = next(kind.taken_by for kind in FILE_KINDS if kind.name == given)
    assert refusal(read, text) == f"my.file: this is {given}, not {wanted}; `{command}` takes it"


def test_a_plant_file_with_a_wrong_value_is_still_a_plant_file() -> None:
    assert refusal(read_plant, PLANT.replace('"V"', '"mV"')) == "my.file: input_unit is 'mV', but must be 'V'"


def test_the_right_kind_in_the_wrong_syntax() -> None:
    rig = to_json(read_rig(FILES["a rig file"][0], "r"))
    assert refusal(read_rig, rig) == "my.file: a rig file is written in TOML; this one is not"


@pytest.mark.parametrize("text", ["", "x = 1", "{}", '{"x": 1}', "[1, 2]", "nothing of the kind"])
def test_a_document_of_no_known_kind_is_reported_as_it_is(text: str) -> None:
    for _, read, _ in FILES.values():
        if text != "" or read not in (read_design,):
            assert "this is" not in refusal(read, text)


def test_a_rig_file_with_one_foreign_table_is_a_rig_file(tmp_path: Path) -> None:
    text = FILES["a rig file"][0] + "\n[specifications]\n"
    assert refusal(read_rig, text).startswith("my.file: unknown key specifications. Valid keys: loop, ")
