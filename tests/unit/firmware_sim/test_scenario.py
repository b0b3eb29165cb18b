"""Scenario files: the shipped ones, and what is wrong with others."""

from __future__ import annotations

from pathlib import Path

import pytest

from firmware_sim.arm.events import Payload, SupplyPressure
from firmware_sim.scenario import check_axes, find_scenario, read_scenario
from hil.core.errors import DocumentError

AXES = ("vertical", "horizontal", "rotation")


@pytest.mark.parametrize("name", ["fig13", "fig14", "fig15"])
def test_the_shipped_scenarios_fit_the_shipped_rig(name: str) -> None:
    path = find_scenario(name)
    scenario = read_scenario(path.read_text(encoding="utf-8"), name)
    check_axes(scenario, AXES, name)
    assert set(scenario.setpoints) == set(AXES)
    assert scenario.figure_axes
    assert path.with_suffix(".png").exists()


def test_fig14_loads_the_arm_and_lowers_the_supply() -> None:
    scenario = read_scenario(find_scenario("fig14").read_text(encoding="utf-8"), "fig14")
    assert scenario.events == [Payload(at_s=0.0, mass_kg=3.0), SupplyPressure(at_s=0.0, gauge_kpa=400.0)]


def test_a_scenario_is_a_file_if_no_shipped_one_has_the_name(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('title = "mine"\nduration_s = 1.0\n')
    assert find_scenario(str(path)) == path
    with pytest.raises(DocumentError, match="not one of the shipped fig13, fig14, fig15"):
        find_scenario("fig99")


@pytest.mark.parametrize(
    "table", ['[setpoints]\nelbow = "step:0@0"', '[controllers]\nelbow = "ppid"', 'figure_axes = ["elbow"]']
)
def test_a_scenario_for_an_axis_that_the_rig_does_not_have_is_rejected(table: str) -> None:
    scenario = read_scenario(f'title = "mine"\nduration_s = 1.0\n{table}\n', "mine.toml")
    with pytest.raises(DocumentError, match=r"mine\.toml: \w+: no axis 'elbow'; the rig has vertical, "):
        check_axes(scenario, AXES, "mine.toml")


def test_mistyped_names_get_a_hint() -> None:
    with pytest.raises(DocumentError, match=r"did you mean fig14\?"):
        find_scenario("fig41")
    with pytest.raises(DocumentError, match=r"did you mean fig13\?"):
        find_scenario("fg13")
    scenario = read_scenario('title = "mine"\nduration_s = 1.0\n[controllers]\nverticl = "ppid"\n', "m.toml")
    with pytest.raises(DocumentError, match=r"did you mean vertical\?"):
        check_axes(scenario, AXES, "m.toml")
