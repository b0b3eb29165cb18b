"""The shipped layouts for Foxglove and PlotJuggler name topics and fields that a recording has."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from importlib.resources import files
from typing import Any

import pytest
from support.shipped_rig import SHIPPED_RIG

from hil.core.life_cycle import LifeCycleState
from hil.recording import schemas
from hil.recording.schemas import layout_of

LAYOUTS = files("hil.shipped") / "layouts"
AXES = [(name, axis.unit) for name, axis in SHIPPED_RIG.axes.items()]
FIELDS = {
    channel.topic: {field.name for field in layout_of(channel.type.definition, "").fields}
    for channel in schemas.channels(AXES, "kernel")
    if channel.topic.startswith(schemas.AXIS_TOPIC) or channel.topic == schemas.CYCLE_TOPIC
}


@pytest.fixture
def foxglove() -> dict[str, Any]:
    content: dict[str, Any] = json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))
    return content


@pytest.fixture
def plotjuggler() -> ElementTree.Element:
    return ElementTree.fromstring((LAYOUTS / "plotjuggler.xml").read_text(encoding="utf-8"))


def panels_in(layout: dict[str, Any] | str) -> Iterator[str]:
    if isinstance(layout, str):
        yield layout
    else:
        yield from panels_in(layout["first"])
        yield from panels_in(layout["second"])


def test_foxglove_shows_every_panel_once(foxglove: dict[str, Any]) -> None:
    assert sorted(panels_in(foxglove["layout"])) == sorted(foxglove["configById"])


def test_every_path_of_foxglove_exists(foxglove: dict[str, Any]) -> None:
    named = [
        path["value"].split(".")
        for panel in foxglove["configById"].values()
        for path in panel.get("paths", ())
    ]
    assert {topic for topic, _ in named} == set(FIELDS)
    assert [(topic, field) for topic, field in named if field not in FIELDS[topic]] == []
    assert foxglove["configById"]["Indicator!state"]["path"] == f"{schemas.CYCLE_TOPIC}.state"
    assert foxglove["configById"]["RosOut!log"]["topicToRender"] == schemas.LOG_TOPIC


def test_foxglove_names_every_panel_but_the_log(foxglove: dict[str, Any]) -> None:
    # Foxglove ignores a key ``title``; without this one, all plots have the same heading.
    panels = {name: panel.get("foxglovePanelTitle") for name, panel in foxglove["configById"].items()}
    assert panels.pop("RosOut!log") is None
    assert None not in panels.values() and len(set(panels.values())) == len(panels)


def test_foxglove_names_every_state_of_the_life_cycle(foxglove: dict[str, Any]) -> None:
    rules = foxglove["configById"]["Indicator!state"]["rules"]
    assert {rule["rawValue"]: rule["label"] for rule in rules} == {
        str(state.value): state.name.lower() for state in LifeCycleState
    }


def test_every_curve_of_plotjuggler_exists(plotjuggler: ElementTree.Element) -> None:
    named = [curve.attrib["name"].rpartition("/") for curve in plotjuggler.iter("curve")]
    assert {topic for topic, _, _ in named} == set(FIELDS)
    assert [(topic, field) for topic, _, field in named if field not in FIELDS[topic]] == []


def test_both_show_setpoint_position_error_and_valve_of_every_axis(
    foxglove: dict[str, Any], plotjuggler: ElementTree.Element
) -> None:
    signals = {
        f"/axis/{name}.{field}"
        for name, _ in AXES
        for field in ("setpoint", "position", "error", "command_v")
    }
    shown = {path["value"] for panel in foxglove["configById"].values() for path in panel.get("paths", ())}
    assert signals <= shown
    curves = {".".join(curve.attrib["name"].rsplit("/", 1)) for curve in plotjuggler.iter("curve")}
    assert signals <= curves
