"""Plant files of ``--plant``: which are found, and hints for mistyped names."""

from __future__ import annotations

import pytest
from support.shipped_rig import SHIPPED_RIG

from firmware_sim.plant_files import read_axis_plants
from hil.core.errors import DocumentError


def test_a_shipped_plant_is_found_by_its_name() -> None:
    assert read_axis_plants(SHIPPED_RIG, {"vertical": "paper"})["vertical"].model.den[0] == 1.0


@pytest.mark.parametrize(
    ("axis", "name", "hint"),
    [("vertial", "paper", r"did you mean vertical\?"), ("vertical", "verticl", r"did you mean vertical\?")],
)
def test_a_mistyped_axis_or_plant_gets_a_hint(axis: str, name: str, hint: str) -> None:
    with pytest.raises(DocumentError, match=hint):
        read_axis_plants(SHIPPED_RIG, {axis: name})
