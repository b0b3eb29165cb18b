"""The shipped layouts for Foxglove and PlotJuggler name topics and fields that a recording has."""

from __future__ import annotations

import colorsys
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


def paths_of(panel: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the series of a plot or of state transitions. Other panels have none."""
    paths: list[dict[str, Any]] = panel.get("paths", [])
    return paths


def lightness(color: str) -> float:
    """Return the lightness of ``#rrggbb``, between 0 and 1."""
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return colorsys.rgb_to_hls(red / 255, green / 255, blue / 255)[1]


def test_foxglove_has_every_type_of_panel(foxglove: dict[str, Any]) -> None:
    # As Foxglove Studio 1.48 registers them. Its panel Log has the type RosOut.
    types = {panel.split("!")[0] for panel in foxglove["configById"]}
    assert types == {"Plot", "StateTransitions", "Indicator", "RosOut"}


def test_every_path_of_foxglove_exists(foxglove: dict[str, Any]) -> None:
    panels = foxglove["configById"].values()
    values = [path["value"] for panel in panels for path in paths_of(panel)]
    values += [panel["path"] for panel in panels if "path" in panel]
    named = [value.split(".") for value in values]
    assert {topic for topic, _ in named} == set(FIELDS)
    assert [(topic, field) for topic, field in named if field not in FIELDS[topic]] == []
    assert foxglove["configById"]["Indicator!state"]["path"] == f"{schemas.CYCLE_TOPIC}.state"
    assert foxglove["configById"]["RosOut!log"]["topicToRender"] == schemas.LOG_TOPIC
    # The only ROS 2 type that Foxglove's panel of the log shows.
    assert schemas.LOG.name == "rcl_interfaces/msg/Log"


def test_foxglove_finds_the_time_of_every_value(foxglove: dict[str, Any]) -> None:
    # A path whose time is the header's stamp has no point if the message has no header.
    methods = {
        path["value"]: path["timestampMethod"]
        for panel in foxglove["configById"].values()
        for path in paths_of(panel)
    }
    assert methods == {
        value: "headerStamp" if "header.stamp.sec" in FIELDS[value.split(".")[0]] else "receiveTime"
        for value in methods
    }


def test_every_plot_of_foxglove_says_what_it_shows(foxglove: dict[str, Any]) -> None:
    # A legend would cover the curves, so the title names them.
    plots = {name: panel for name, panel in foxglove["configById"].items() if name.startswith("Plot!")}
    assert len(plots) == 3 * len(AXES)
    for name, panel in plots.items():
        axis, signal = name.removeprefix("Plot!").split("-")
        title = panel["foxglovePanelTitle"]
        assert title.startswith(axis)
        assert f"({'V' if signal == 'valve' else dict(AXES)[axis]})" in title
        assert panel["legendDisplay"] == "none"
        if len(panel["paths"]) > 1:
            assert [path["label"] for path in panel["paths"] if path["label"] not in title] == []


def test_foxglove_draws_no_curve_black(foxglove: dict[str, Any]) -> None:
    # Foxglove Studio draws the points of a curve darker than its colour: it takes 0.3 off the lightness.
    colors = [
        path["color"]
        for name, panel in foxglove["configById"].items()
        if name.startswith("Plot!")
        for path in paths_of(panel)
    ]
    assert colors and min(map(lightness, colors)) > 0.5


def test_foxglove_names_every_panel_but_the_log(foxglove: dict[str, Any]) -> None:
    # Only plots had a key ``title`` of their own; Foxglove Studio 1.48 reads it in old layouts alone.
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
