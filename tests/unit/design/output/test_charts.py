"""Charts: the values can be read back off the drawing, on every scale."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.drawn_curves import drawn_curves

from design.output.charts import Area, Band, Curve, Limit, Marks, Panel, Shape, Style, area_between, draw
from design.output.scales import Axis

LINE = Style("#000")
Values = NDArray[np.float64]


def make_panel(x: Values, y: Values, x_axis: Axis | None = None, y_axis: Axis | None = None) -> Panel:
    return Panel(x_axis or Axis("x"), y_axis or Axis("y"), (Curve("c", x, y, LINE),))


@given(
    st.floats(-1e6, 1e6),
    st.floats(1e-6, 1e6),
    st.booleans(),
    st.booleans(),
)
def test_values_can_be_read_back(
    low: float, span: float, x_is_logarithmic: bool, y_is_logarithmic: bool
) -> None:
    """Coordinates are rounded to a tenth of a pixel, which limits the accuracy."""
    x = np.linspace(1.0, 100.0, 50)
    y = np.linspace(low, low + span, 50)
    if y_is_logarithmic:
        y = np.exp(np.linspace(0.0, min(span, 50.0), 50))
    x_axis, y_axis = Axis("x", logarithmic=x_is_logarithmic), Axis("y", logarithmic=y_is_logarithmic)
    (curve,) = drawn_curves(draw([make_panel(x, y, x_axis, y_axis)], "name"))[0]["c"]
    if y_is_logarithmic:
        np.testing.assert_allclose(np.log(curve[:, 1]), np.log(y), atol=4e-4 * max(np.log(y[-1]), 0.3))
    else:
        np.testing.assert_allclose(curve[:, 1], y, atol=4e-4 * span)
    if x_is_logarithmic:
        np.testing.assert_allclose(np.log(curve[:, 0]), np.log(x), atol=1e-3)
    else:
        np.testing.assert_allclose(curve[:, 0], x, atol=0.02)


def test_a_value_that_is_not_finite_leaves_a_gap() -> None:
    y = np.array([1.0, 2.0, np.nan, 3.0, np.inf, 4.0, 5.0])
    runs = drawn_curves(draw([make_panel(np.arange(7.0), y)], "gaps"))[0]["c"]
    assert [len(run) for run in runs] == [2, 1, 2]


def test_a_curve_that_holds_is_drawn_as_stairs() -> None:
    stairs = Panel(Axis("x"), Axis("y"), (Curve("c", np.arange(3.0), np.array([1.0, 3.0, 2.0]), LINE, True),))
    (run,) = drawn_curves(draw([stairs], "held"))[0]["c"]
    np.testing.assert_allclose(run, [[0.0, 1.0], [1.0, 1.0], [1.0, 3.0], [2.0, 3.0], [2.0, 2.0]], atol=0.01)


@pytest.mark.parametrize(
    ("axis", "labels"),
    [
        (Axis("a", low=0.0, high=1.0), ["0", "0.2", "0.4", "0.6", "0.8", "1"]),
        (Axis("a", low=-360.0, high=0.0, tick=90.0), ["−360", "−270", "−180", "−90", "0"]),
        (Axis("a", logarithmic=True, low=0.01, high=100.0), ["0.01", "0.1", "1", "10", "100"]),
        (Axis("a", logarithmic=True, low=1e-6, high=1e-4), ["10⁻⁶", "10⁻⁵", "10⁻⁴"]),
        (Axis("a", logarithmic=True, low=1.0, high=10.0), ["1", "2", "5", "10"]),
    ],
)
def test_ticks_have_round_labels(axis: Axis, labels: list[str]) -> None:
    x = np.array([1.0, 2.0])
    svg = draw([Panel(axis, Axis("y"), (Curve("c", x, x, LINE),))], "ticks")
    texts = [element.text for element in ET.fromstring(svg).iter() if element.tag.endswith("text")]
    shown = [text for text in texts if text in labels]
    assert shown[: len(labels)] == labels


def test_constant_and_empty_curves_have_a_scale() -> None:
    for y in (np.zeros(3), np.full(3, np.nan), np.full(3, 7.0)):
        for logarithmic in (False, True):
            ET.fromstring(
                draw([make_panel(np.arange(1.0, 4.0), y, y_axis=Axis("y", logarithmic=logarithmic))], "flat")
            )


def test_text_is_escaped_and_every_label_is_once_in_the_legend() -> None:
    x = np.array([0.0, 1.0])
    marked_up = Curve("<b>&", x, x, LINE)
    two = [
        Panel(Axis("<x>"), Axis("y"), (marked_up,), (Limit(0.5, "<limit>"),), (Band(0.2, 0.4, "<band>"),)),
        Panel(Axis("<x>"), Axis("y"), (marked_up,)),
    ]
    root = ET.fromstring(draw(two, "a <name>"))
    texts = [element.text for element in root.iter() if element.tag.endswith("text")]
    assert texts.count("<b>&") == 1
    assert {"<limit>", "<band>", "<x>"} <= set(texts)
    assert root.get("aria-label") == "a <name>"


def test_ids_differ_between_the_figures_of_a_page() -> None:
    x = np.array([0.0, 1.0])
    first, second = draw([make_panel(x, x), make_panel(x, x)], "Fig 1"), draw([make_panel(x, x)], "Fig 2")
    ids = [
        element.get("id")
        for svg in (first, second)
        for element in ET.fromstring(svg).iter()
        if element.get("id")
    ]
    assert len(ids) == len(set(ids)) == 3


SVG = "{http://www.w3.org/2000/svg}"


def elements(svg: str, tag: str) -> list[ET.Element]:
    return [element for element in ET.fromstring(svg).iter() if element.tag == f"{SVG}{tag}"]


@pytest.mark.parametrize("shape", [Shape.DOT, Shape.CIRCLE, Shape.STEM])
def test_every_finite_point_has_a_mark(shape: Shape) -> None:
    """The legend has one mark more."""
    y = np.array([1.0, np.nan, 2.0, np.inf, 3.0])
    panel = Panel(Axis("x"), Axis("y"), (), marks=(Marks("points", np.arange(5.0), y, LINE, shape),))
    assert len(elements(draw([panel], "marks"), "circle")) == 4


def test_a_cross_has_two_lines() -> None:
    marks = Marks("", np.array([1.0]), np.array([2.0]), Style("#123456"), Shape.CROSS)
    svg = draw([Panel(Axis("x"), Axis("y"), (), marks=(marks,))], "cross")
    assert len([line for line in elements(svg, "line") if line.get("stroke") == "#123456"]) == 2


def test_marks_stand_where_their_values_are() -> None:
    x_axis, y_axis = Axis("x", low=0.0, high=4.0), Axis("y", low=-1.0, high=1.0)
    marks = Marks("", np.array([0.0, 4.0]), np.array([-1.0, 1.0]), LINE, Shape.CIRCLE)
    svg = draw([Panel(x_axis, y_axis, (), marks=(marks,))], "marks")
    (group,) = [g for g in elements(svg, "g") if g.get("class") == "panel"]
    left, top, width, height = map(float, (group.get("data-box") or "").split())
    places = [(float(c.get("cx") or 0), float(c.get("cy") or 0)) for c in elements(svg, "circle")]
    assert places == [(left, top + height), (left + width, top)]


def test_a_stem_reaches_from_0_to_its_value() -> None:
    marks = Marks("", np.array([1.0]), np.array([0.5]), Style("#123456"), Shape.STEM)
    svg = draw(
        [Panel(Axis("x", low=0.0, high=2.0), Axis("y", low=-1.0, high=1.0), (), marks=(marks,), height=200)],
        "s",
    )
    (stem,) = [line for line in elements(svg, "line") if line.get("stroke") == "#123456"]
    assert float(stem.get("y1") or 0) - float(stem.get("y2") or 0) == pytest.approx(50.0)


def test_marks_and_areas_set_the_scale_of_an_open_axis() -> None:
    marks = Marks("m", np.array([0.0, 10.0]), np.array([5.0, 5.0]), LINE)
    area = Area("a", np.array([0.0, 10.0, 5.0]), np.array([0.0, 0.0, 9.0]), LINE)
    svg = draw([Panel(Axis("x"), Axis("y"), (), marks=(marks,), areas=(area,))], "scale")
    (group,) = [g for g in elements(svg, "g") if g.get("class") == "panel"]
    low, high, _ = map(float, (group.get("data-y") or "").split())
    assert low < 0.0
    assert high > 9.0
    assert len(elements(svg, "polygon")) == 1


def test_an_area_between_curves_leaves_out_what_is_not_finite() -> None:
    low, high = np.array([0.0, np.nan, 1.0]), np.array([2.0, 3.0, 4.0])
    area = area_between("a", np.arange(3.0), low, high, LINE)
    assert area.x.tolist() == [0.0, 2.0, 2.0, 0.0]
    assert area.y.tolist() == [0.0, 1.0, 4.0, 2.0]
