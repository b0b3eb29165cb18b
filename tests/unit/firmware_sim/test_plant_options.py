"""The options that choose a plant, shared by ``firmware-sim`` and ``hil run``."""

from __future__ import annotations

import argparse
import json
import re
from importlib.resources import files
from pathlib import Path

import pytest
from support.arm_files import SHIPPED_TEXT
from support.constants import CENTRED

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.event_text import parse_event
from firmware_sim.plant_options import (
    add_plant_options,
    build_plant,
    planned_events,
    plant_arguments,
    plant_texts,
)
from firmware_sim.plants.linear_plant import LinearPlant
from hil.core.errors import DocumentError
from hil.core.rig import read_rig

RIG_TEXT = (files("hil.shipped") / "rig.toml").read_text()
RIG = read_rig(RIG_TEXT, "rig.toml")


def options(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_plant_options(parser)
    return parser.parse_args(arguments)


def arm(*arguments: str) -> Arm:
    plant, _ = build_plant(RIG, options(*arguments))
    assert isinstance(plant, Arm)
    return plant


def test_events_happen_at_their_time_without_a_scenario() -> None:
    subject = arm("--event", "payload:2@0.5", "--event", "broken-wire:rotation@0.5")
    subject.advance(499_999_999, CENTRED)
    assert subject.view().payload_kg == 0.0
    subject.advance(1, CENTRED)
    assert subject.view().payload_kg == 2.0
    assert subject.potentiometer_v()[2] == 0.0


def test_events_come_on_top_of_the_scenarios() -> None:
    subject = arm("--scenario", "fig14", "--event", "payload:1@1")
    subject.advance(500_000_000, CENTRED)
    assert subject.view().payload_kg == 3.0
    subject.advance(500_000_000, CENTRED)
    assert subject.view().payload_kg == 1.0


def test_what_is_planned_is_told_in_its_order_and_reads_back() -> None:
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


def test_the_plant_in_words_has_its_scenario_and_its_events() -> None:
    _, words = build_plant(RIG, options("--scenario", "fig13", "--event", "payload:1@1"))
    assert words.startswith("the pneumatic arm; Fig. 13: ")
    assert words.endswith("; payload:1@1")


@pytest.mark.parametrize(
    "given",
    [
        [],
        ["--linear"],
        ["--seed", "7", "--scenario", "fig14", "--event", "payload:1@1", "--event", "leak:vertical,1,1e-8@2"],
        ["--arm", "my arm.toml"],
    ],
)
def test_options_survive_the_way_to_a_process_of_the_boards(given: list[str]) -> None:
    assert options(*plant_arguments(options(*given))) == options(*given)


@pytest.mark.parametrize("given", [["--scenario", "fig13"], ["--event", "payload:1@1"]])
def test_the_linear_plant_takes_nothing_that_happens_to_an_arm(given: list[str]) -> None:
    with pytest.raises(DocumentError, match=f"{given[0]} is for the pneumatic arm"):
        build_plant(RIG, options("--linear", *given))
    assert isinstance(build_plant(RIG, options("--linear"))[0], LinearPlant)


def test_what_is_simulated_as_texts_builds_the_same_plant_again(tmp_path: Path) -> None:
    given = ["--seed", "5", "--scenario", "fig14", "--event", "payload:1@0.1", "--event", "temperature:0@0.2"]
    texts = plant_texts(RIG, options(*given))
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


def test_the_linear_plants_texts_have_no_arm() -> None:
    texts = plant_texts(RIG, options("--linear", "--seed", "3"))
    assert json.loads(texts.pop("plant.json")) == {"model": "linear, eq. (15)", "seed": "3"}
    assert texts == {}


def test_an_arm_file_that_cannot_be_is_refused_before_anything_is_started(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(SHIPPED_TEXT.replace("bore_m = 0.010", "bore_m = -0.010"))
    with pytest.raises(DocumentError, match=r"mine\.toml: axes\.horizontal\.cylinder\.bore_m: -0\.01: "):
        plant_texts(RIG, options("--arm", str(path)))


def test_an_axis_that_the_arm_has_not_is_refused() -> None:
    rig = read_rig(RIG_TEXT.replace("axes.rotation", "axes.elbow"), "rig.toml")
    for build in (build_plant, plant_texts):
        with pytest.raises(DocumentError, match=r"rig: axes\.elbow: the simulated arm has no such axis"):
            build(rig, options())
    assert isinstance(build_plant(rig, options("--linear"))[0], LinearPlant)


def test_the_arm_hangs_on_the_channels_of_the_rig_file() -> None:
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


def test_an_axis_that_the_rig_leaves_out_rests_and_its_channel_reads_0_v() -> None:
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
