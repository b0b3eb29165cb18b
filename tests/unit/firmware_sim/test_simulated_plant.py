"""The plant that the options choose, and the texts with which a recording can repeat it."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from support.arm_files import SHIPPED_TEXT
from support.constants import CENTRED, PERIOD_NS
from support.shipped_rig import RIG_TEXT, SHIPPED_RIG

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.event_text import parse_event
from firmware_sim.faults.fault_text import fault_text
from firmware_sim.faulty_rig import FaultyRig
from firmware_sim.plant_options import add_plant_options
from firmware_sim.plants.linear_model import LinearModel
from firmware_sim.plants.linear_plant import LinearPlant
from firmware_sim.plants.plant import Plant
from firmware_sim.simulated_plant import (
    build_boards,
    build_plant,
    faults_not_begun,
    planned_events,
    planned_faults,
    plant_texts,
    refuse_host_faults,
)
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import DocumentError
from hil.core.rig import read_rig


def options(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_plant_options(parser)
    return parser.parse_args(arguments)


def arm(*arguments: str) -> Arm:
    plant, _ = build_plant(SHIPPED_RIG, options(*arguments))
    assert isinstance(plant, Arm)
    return plant


def test_events_of_the_command_line_happen_at_their_time() -> None:
    subject = arm("--event", "payload:2@0.5", "--event", "broken-wire:rotation@0.5")
    subject.advance(499_999_999, CENTRED)
    assert subject.view().payload_kg == 0.0
    subject.advance(1, CENTRED)
    assert subject.view().payload_kg == 2.0
    assert subject.potentiometer_v()[2] == 0.0


def test_events_of_the_command_line_add_to_those_of_the_scenario() -> None:
    subject = arm("--scenario", "fig14", "--event", "payload:1@1")
    subject.advance(500_000_000, CENTRED)
    assert subject.view().payload_kg == 3.0
    subject.advance(500_000_000, CENTRED)
    assert subject.view().payload_kg == 1.0


def test_planned_events_are_in_order_of_time_and_can_be_parsed() -> None:
    texts = ["leak:vertical,1,1e-08@2.5", "stuck-spool:rotation,false@2", "friction:horizontal,1.5@3"]
    planned = planned_events(
        options("--scenario", "fig14", *(part for t in texts for part in ("--event", t)))
    )
    assert planned == {
        "payload:3@0": 0.0,
        "supply-pressure:400@0": 0.0,
        "stuck-spool:rotation,false@2": 2.0,
        "leak:vertical,1,1e-08@2.5": 2.5,
        "friction:horizontal,1.5@3": 3.0,
    }
    assert {text: parse_event(text).at_s for text in planned} == planned
    assert planned_events(options("--linear")) == {}


def test_the_description_of_the_plant_names_scenario_and_events() -> None:
    _, text = build_plant(SHIPPED_RIG, options("--scenario", "fig13", "--event", "payload:1@1"))
    assert text.startswith("the pneumatic arm; Fig. 13: ")
    assert text.endswith("; payload:1@1")


@pytest.mark.parametrize("given", [["--scenario", "fig13"], ["--event", "payload:1@1"]])
def test_scenario_and_events_are_rejected_with_linear(given: list[str]) -> None:
    with pytest.raises(DocumentError, match=f"{given[0]} is for the pneumatic arm"):
        build_plant(SHIPPED_RIG, options("--linear", *given))
    assert isinstance(build_plant(SHIPPED_RIG, options("--linear"))[0], LinearPlant)


def test_the_recorded_texts_build_the_same_plant_again(tmp_path: Path) -> None:
    given = ["--seed", "5", "--scenario", "fig14", "--event", "payload:1@0.1", "--event", "temperature:0@0.2"]
    texts = plant_texts(SHIPPED_RIG, options(*given))
    assert texts["arm.toml"] == SHIPPED_TEXT
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    plant = json.loads(texts["plant.json"])
    events = [argument for event in plant["events"].split() for argument in ("--event", event)]
    again = ["--seed", plant["seed"], "--arm", str(tmp_path / "arm.toml"), *events]
    again += ["--scenario", str(tmp_path / "scenario.toml")]
    readings = []
    for subject in (arm(*given), arm(*again), arm()):
        subject.advance(300_000_000, CENTRED)
        readings.append(tuple(subject.potentiometer_v()))
    assert readings[0] == readings[1] != readings[2]


def test_the_recorded_texts_of_a_linear_plant_have_no_arm() -> None:
    texts = plant_texts(SHIPPED_RIG, options("--linear", "--seed", "3"))
    assert json.loads(texts.pop("plant.json")) == {"model": "linear, eq. (15)", "seed": "3"}
    assert texts == {}


def test_an_impossible_arm_file_is_rejected_before_the_run_starts(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(SHIPPED_TEXT.replace("bore_m = 0.010", "bore_m = -0.010"))
    with pytest.raises(
        DocumentError, match=r"mine\.toml: axes\.horizontal\.cylinder\.bore_m is -0\.01, but must be "
    ):
        plant_texts(SHIPPED_RIG, options("--arm", str(path)))


def test_an_axis_that_the_arm_does_not_have_is_rejected() -> None:
    rig = read_rig(RIG_TEXT.replace("axes.rotation", "axes.elbow"), "rig.toml")
    for build in (build_plant, plant_texts):
        with pytest.raises(
            DocumentError, match=r"rig file: axes\.elbow: the simulated arm has no axis of this name"
        ):
            build(rig, options())
    assert isinstance(build_plant(rig, options("--linear"))[0], LinearPlant)


def test_the_arm_is_wired_to_the_channels_of_the_rig_file() -> None:
    text = RIG_TEXT
    for part, channels in (("potentiometer", "312"), ("valve", "231")):
        for axis, channel in zip(("vertical", "horizontal", "rotation"), channels, strict=True):
            text = re.sub(rf"(axes\.{axis}\.{part}\].*\nchannel = )\d", rf"\g<1>{channel}", text)
    rig = read_rig(text, "rig.toml")
    assert [axis.valve.channel for axis in rig.axes.values()] == [2, 3, 1]
    crossed, straight = build_plant(rig, options())[0], arm()
    assert isinstance(crossed, Arm)
    crossed.advance(300_000_000, (4.6, 5.6, 5.3))
    straight.advance(300_000_000, (5.6, 5.3, 4.6))
    assert crossed.view() == straight.view()
    first, second, third = straight.potentiometer_v()
    assert list(crossed.potentiometer_v()) == [second, third, first]


def test_an_axis_that_is_not_in_the_rig_file_rests_and_its_channel_reads_0_v() -> None:
    text = RIG_TEXT[: RIG_TEXT.index("[axes.horizontal]")]
    rig = read_rig(text.replace("channel = 1", "channel = 2"), "rig.toml")
    alone = build_plant(rig, options())[0]
    assert isinstance(alone, Arm)
    before = alone.view()
    alone.advance(300_000_000, (9.0, 5.6, 9.0))
    after = alone.view()
    assert after.axes[0].position > before.axes[0].position + 0.01
    assert [axis.position for axis in after.axes[1:]] == pytest.approx(
        [axis.position for axis in before.axes[1:]], abs=1e-3
    )
    assert alone.potentiometer_v()[0] == alone.potentiometer_v()[2] == 0.0


PLANT = """{
  "format": "hil-plant", "version": 1, "name": "mine", "input_unit": "V", "output_unit": "m",
  "num": [0.8], "den": [0.2, 1.0], "dead_time_s": 0.005
}"""
MODEL = LinearModel((0.8,), (0.2, 1.0), 0.005)
MOVE_V = (5.4, 5.3, 4.7)
ON_EVERY_AXIS = ["--plant", "vertical=paper", "--plant", "horizontal=paper", "--plant", "rotation=rotation"]


@pytest.fixture
def plant_json(tmp_path: Path) -> str:
    path = tmp_path / "plant.json"
    path.write_text(PLANT)
    return str(path)


def readings(plant: Plant, periods: int = 40) -> list[list[float]]:
    found = []
    for _ in range(periods):
        plant.advance(PERIOD_NS, MOVE_V)
        found.append(list(plant.potentiometer_v()))
    return found


def test_a_plant_file_replaces_one_axis_of_the_arm_and_events_act_on_the_others(plant_json: str) -> None:
    plant, text = build_plant(
        SHIPPED_RIG, options("--plant", f"vertical={plant_json}", "--event", "broken-wire:rotation@0.2")
    )
    assert text == "the pneumatic arm; broken-wire:rotation@0.2; the linear model 'mine' for vertical"
    model = LinearPlant(SHIPPED_RIG, {"vertical": MODEL})
    # The arm's own vertical axis rests, so the other axes move as on an arm whose vertical valve is at rest.
    still = arm("--event", "broken-wire:rotation@0.2")
    for mixed in readings(plant):
        model.advance(PERIOD_NS, MOVE_V)
        still.advance(PERIOD_NS, (5.0, *MOVE_V[1:]))
        assert mixed == [model.potentiometer_v()[0], *list(still.potentiometer_v())[1:]]
    assert mixed[2] == 0.0
    assert mixed[0] > 5.5


def test_with_linear_the_other_axes_have_equation_15(plant_json: str) -> None:
    plant, text = build_plant(SHIPPED_RIG, options("--linear", "--plant", f"vertical={plant_json}"))
    assert text == (
        "the linear model, eq. (15), for horizontal, rotation; the linear model 'mine' for vertical"
    )
    mixed = readings(plant)
    own = readings(LinearPlant(SHIPPED_RIG, {"vertical": MODEL}))
    eq_15 = readings(LinearPlant(SHIPPED_RIG))
    assert mixed == [[mine[0], *others[1:]] for mine, others in zip(own, eq_15, strict=True)]


def test_without_an_axis_left_there_is_no_arm(plant_json: str) -> None:
    rig = read_rig(RIG_TEXT[: RIG_TEXT.index("[axes.horizontal]")], "rig.toml")
    given = options("--plant", f"vertical={plant_json}")
    assert isinstance(build_plant(rig, given)[0], LinearPlant)
    texts = plant_texts(rig, given)
    assert json.loads(texts.pop("plant.json")) == {"model": "linear", "seed": "0", "plants": "vertical"}
    assert texts == {"plants/vertical.json": PLANT}


def test_an_axis_of_any_name_can_have_a_plant_file(plant_json: str) -> None:
    rig = read_rig(RIG_TEXT.replace("axes.vertical", "axes.elbow"), "rig.toml")
    plant, _ = build_plant(rig, options("--plant", f"elbow={plant_json}"))
    assert readings(plant)[-1][0] > 5.5


def test_a_plant_that_design_ships_is_found_by_its_name() -> None:
    plant, text = build_plant(SHIPPED_RIG, options("--plant", "vertical=paper"))
    assert text == "the pneumatic arm; the linear model 'paper' for vertical"
    eq_15 = readings(LinearPlant(SHIPPED_RIG))
    assert [mixed[0] for mixed in readings(plant)] == pytest.approx([linear[0] for linear in eq_15], rel=1e-6)


def test_without_design_its_plants_are_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("firmware_sim.plant_files.find_spec", lambda _name: None)
    with pytest.raises(
        DocumentError, match=r"--plant vertical=paper: no file paper, and no plants are installed"
    ):
        build_plant(SHIPPED_RIG, options("--plant", "vertical=paper"))


def test_the_recorded_texts_of_a_plant_file_build_the_same_plant_again(
    plant_json: str, tmp_path: Path
) -> None:
    given = ["--seed", "3", "--plant", f"vertical={plant_json}", "--event", "payload:1@0.1"]
    texts = plant_texts(SHIPPED_RIG, options(*given))
    facts = json.loads(texts["plant.json"])
    assert facts == {"model": "pneumatic arm", "seed": "3", "events": "payload:1@0.1", "plants": "vertical"}
    (tmp_path / "recorded.json").write_text(texts["plants/vertical.json"])
    (tmp_path / "arm.toml").write_text(texts["arm.toml"])
    again = ["--seed", facts["seed"], "--arm", str(tmp_path / "arm.toml"), "--event", facts["events"]]
    again += ["--plant", f"{facts['plants']}={tmp_path}/recorded.json"]
    first, second = (build_plant(SHIPPED_RIG, options(*arguments))[0] for arguments in (given, again))
    assert readings(first) == readings(second)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            ["--plant", "elbow=paper"],
            "--plant elbow=paper: no such axis; the rig has vertical, horizontal, rotation",
        ),
        (
            ["--plant", "vertical=absent.json"],
            "--plant vertical=absent.json: no file absent.json, and not one of the ",
        ),
        (["--plant", "rotation=paper"], "output_unit: m, but axis rotation is in rad"),
        (
            ["--plant", "vertical=paper", "--event", "friction:vertical,2@1"],
            "axis vertical is a linear model",
        ),
        (
            [*ON_EVERY_AXIS, "--scenario", "fig14"],
            "event 'payload:3@0' (of --event or --scenario) acts on the pneumatic arm, but --plant puts a ",
        ),
        (
            [*ON_EVERY_AXIS, "--arm", "arm.toml"],
            "--arm arm.toml: --plant puts a linear model on every axis",
        ),
    ],
)
@pytest.mark.parametrize("build", [build_plant, plant_texts])
def test_a_plant_file_that_does_not_fit_is_rejected(
    build: Callable[..., object], given: list[str], message: str
) -> None:
    with pytest.raises(DocumentError) as caught:
        build(SHIPPED_RIG, options(*given))
    assert message in str(caught.value)


def test_a_scenario_may_not_act_on_a_linear_axis(tmp_path: Path) -> None:
    path = tmp_path / "leak.toml"
    path.write_text(
        'title = "leak"\nduration_s = 1.0\n[[events]]\nat_s = 0.5\nchange = "leak"\naxis = "vertical"\n'
        "chamber = 1\nconductance_m3_s_pa = 1e-9\n"
    )
    build_plant(SHIPPED_RIG, options("--plant", "horizontal=paper", "--scenario", str(path)))
    with pytest.raises(DocumentError, match=r"event 'leak:vertical,1,1e-09@0\.5' .* --plant puts"):
        build_plant(SHIPPED_RIG, options("--plant", "vertical=paper", "--scenario", str(path)))


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        (["--linear"], "every axis has a linear model"),
        (["--plant", "vertical=paper"], "vertical has a linear model"),
    ],
)
@pytest.mark.parametrize("event", ["leak:vertical,1,1e-08", "broken-wire:vertical", "stuck-spool:vertical"])
def test_a_fault_of_the_arm_may_not_act_on_a_linear_axis(
    tmp_path: Path, given: list[str], problem: str, event: str
) -> None:
    said = (
        f"fault '{event}.*' .*acts on the pneumatic arm, but {problem}: simulate the arm, or use .* Omit the"
    )
    with pytest.raises(DocumentError, match=said):
        plant_texts(SHIPPED_RIG, options(*given, "--fault", f"{event}@running"))
    scenario = tmp_path / "wire.toml"
    scenario.write_text(
        'title = "wire"\nduration_s = 1.0\n[[faults]]\nfault = "arm"\nwhen = "running"\n'
        'event = { change = "broken wire", axis = "vertical", at_s = 0.0 }\n'
    )
    with pytest.raises(DocumentError, match="broken-wire:vertical"):
        build_plant(SHIPPED_RIG, options("--plant", "vertical=paper", "--scenario", str(scenario)))


def test_a_fault_of_the_whole_arm_needs_one_axis_of_it() -> None:
    fault = ["--fault", "supply-pressure:300@1"]
    with pytest.raises(DocumentError, match="every axis has a linear model"):
        plant_texts(SHIPPED_RIG, options("--linear", *fault))
    given = options("--plant", "vertical=paper", *fault, "--fault", "leak:rotation,1,1e-9@1")
    plant, _ = build_plant(SHIPPED_RIG, given)
    assert isinstance(build_boards(SHIPPED_RIG, plant, given), FaultyRig)


FAULTY_SCENARIO = """
title = "faults"
duration_s = 3.0
[[faults]]
fault = "hang"
board = "adc"
at_s = 2.0
"""


def test_faults_of_the_command_line_follow_those_of_the_scenario(tmp_path: Path) -> None:
    (tmp_path / "faulty.toml").write_text(FAULTY_SCENARIO)
    given = options(
        "--scenario", str(tmp_path / "faulty.toml"), "--fault", "unplug@running", "--fault", "reset:dac@1"
    )
    assert [fault_text(fault) for fault in planned_faults(given)] == [
        "hang:adc@2",
        "unplug@running",
        "reset:dac@1",
    ]
    assert planned_events(given) == {"reset:dac@1": 1.0, "hang:adc@2": 2.0}
    facts = json.loads(plant_texts(SHIPPED_RIG, given)["plant.json"])
    assert facts["faults"] == "hang:adc@2 unplug@running reset:dac@1"


@pytest.mark.parametrize(("given", "kind"), [([], SimulatedRig), (["--fault", "unplug@1"], FaultyRig)])
def test_only_a_rig_with_faults_is_wrapped(given: list[str], kind: type) -> None:
    chosen = options("--linear", *given)
    assert type(build_boards(SHIPPED_RIG, LinearPlant(SHIPPED_RIG), chosen)) is kind


@pytest.mark.parametrize("fault", ["stall:0.1@1", "step-clock:5@1"])
def test_faults_of_the_host_are_refused_in_real_time(fault: str) -> None:
    refuse_host_faults(options("--fault", "unplug@1"))
    with pytest.raises(
        DocumentError, match=f"fault '{fault}' acts on the gateway's host in simulated time only"
    ):
        refuse_host_faults(options("--fault", fault))


@pytest.mark.parametrize("build", [build_plant, plant_texts])
@pytest.mark.parametrize(
    ("given", "section"),
    [
        (("--event", "emergency-stop:pressed@1"), "emergency_stop"),
        (("--event", "enable-switch:released@1"), "enable"),
        (("--fault", "emergency-stop:pressed@running"), "emergency_stop"),
    ],
)
def test_a_contact_that_the_gateway_does_not_see_is_refused(
    build: Callable[..., object], given: tuple[str, str], section: str
) -> None:
    with pytest.raises(DocumentError, match=rf"the rig file has no \[{section}\], so the gateway would not"):
        build(SHIPPED_RIG, options(*given))


def test_a_fault_whose_condition_was_not_met_did_not_begin() -> None:
    given = options("--fault", "hang:adc@vertical>5", "--fault", "unplug@armed+1", "--fault", "unplug@1")
    never, late, after_end = faults_not_begun(given, [])
    assert after_end == ("unplug@1 did not begin: the run ended before 1 s had passed since the first sample")
    assert never == "hang:adc@vertical>5 did not begin: its condition never came"
    assert late.endswith("its condition never came, or came less than 1 s before the end of the run")
    assert faults_not_begun(given, ["unplug@armed+1"]) == [never, after_end]
