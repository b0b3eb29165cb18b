"""Draw line charts as SVG text: axes, ticks, curves, marks, areas, limits, bands and a legend.

This module knows no control engineering. It writes SVG directly because importing a plotting library takes
longer than a whole design. One SVG document holds panels, one above the other, with one legend. Every panel
states its scales in data attributes; the script of the report and the tests read values off the curves by
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from html import escape

import numpy as np

from design.output.scales import Array, Axis, Scale, make_scale

WIDTH, LEFT, RIGHT, TOP, BETWEEN, BOTTOM = 560, 62, 14, 12, 16, 40
"""Width of a drawing, its margins and the distance between panels, in pixels."""
PANEL_WIDTH = WIDTH - LEFT - RIGHT
LEGEND_ROW = 18
CHARACTER = 6.4
"""Mean width of a character of the legend, in pixels."""

_MAX_PIXEL = 1e4
"""Pixels beyond this are clipped: they lie outside every panel, and browsers lose precision there."""
_MARK = 5.0
"""Half the width of a cross, and the radius of a circle, in pixels."""
_TINT = 0.2
"""Opacity of a filled area."""
_TEXT, _SOFT_TEXT = "#333", "#66707a"
_GRID, _MINOR_GRID, _LIMIT_LINE, _FRAME, _BAND = "#e4e7eb", "#f2f4f6", "#9aa3ad", "#8a939c", "#dff0e4"


@dataclass(frozen=True)
class Style:
    """Colour, dash pattern and width in pixels of a curve. The dash pattern distinguishes curves in print."""

    colour: str
    dash: str = ""
    width: float = 1.6


@dataclass(frozen=True)
class Curve:
    """Values y over x, both (k,); a value that is not finite leaves a gap."""

    label: str
    x: Array
    y: Array
    style: Style
    holds: bool = False
    """Draw stairs: y[i] from x[i] to x[i + 1]."""


class Shape(StrEnum):
    """How a mark is drawn."""

    DOT = "dot"
    CROSS = "cross"
    CIRCLE = "circle"
    STEM = "stem"
    """A dot with a vertical line to 0, for values over whole numbers."""


@dataclass(frozen=True)
class Marks:
    """Single points y over x, both (k,). A point that is not finite is left out."""

    label: str
    x: Array
    y: Array
    style: Style
    shape: Shape = Shape.DOT


@dataclass(frozen=True)
class Area:
    """A closed outline through the points x, y, both (k,), which is filled with a light tint."""

    label: str
    x: Array
    y: Array
    style: Style


def area_between(label: str, x: Array, low: Array, high: Array, style: Style) -> Area:
    """Return the area between two curves over x (k,), without the points that are not finite."""
    known = np.isfinite(low) & np.isfinite(high)
    x, low, high = x[known], low[known], high[known]
    return Area(label, np.concatenate([x, x[::-1]]), np.concatenate([low, high[::-1]]), style)


@dataclass(frozen=True)
class Limit:
    """A straight line at ``value`` of the y axis, or of the x axis if ``of_x``, with a label at its end."""

    value: float
    label: str
    of_x: bool = False


@dataclass(frozen=True)
class Band:
    """A shaded range of y with a label."""

    low: float
    high: float
    label: str


@dataclass(frozen=True)
class Panel:
    """One pair of axes with what is drawn in it; ``height`` is in pixels.

    An end of an axis that is left open is taken from curves, marks and areas.
    """

    x: Axis
    y: Axis
    curves: tuple[Curve, ...]
    limits: tuple[Limit, ...] = ()
    bands: tuple[Band, ...] = ()
    height: int = 230
    marks: tuple[Marks, ...] = ()
    areas: tuple[Area, ...] = ()

    @property
    def drawn(self) -> tuple[Curve | Marks | Area, ...]:
        """Everything that has x and y, in the order of the legend."""
        return (*self.curves, *self.marks, *self.areas)


def draw(panels: Sequence[Panel], name: str) -> str:
    """Draw the panels as one SVG document; ``name`` is its accessible name and makes its ids unique."""
    legend, legend_height = _legend(panels)
    height = TOP + legend_height + sum(p.height for p in panels) + BETWEEN * (len(panels) - 1) + BOTTOM
    key = "".join(c if c.isalnum() else "-" for c in name.lower())
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" role="img" '
        f'aria-label="{escape(name)}" font-family="system-ui, sans-serif" font-size="11.5">',
        legend,
    ]
    top = float(TOP + legend_height)
    for number, panel in enumerate(panels):
        is_last = number == len(panels) - 1
        has_x_labels = is_last or panel.x != panels[number + 1].x
        parts.append(_PlacedPanel(panel, top, f"{key}-{number}", has_x_labels).draw())
        top += panel.height + BETWEEN
    parts.append("</svg>")
    return "\n".join(parts)


class _PlacedPanel:
    """One panel at its place in the drawing, with its scales."""

    def __init__(self, panel: Panel, top: float, key: str, has_x_labels: bool) -> None:
        self._panel, self._top, self._key, self._has_x_labels = panel, top, key, has_x_labels
        self._bottom, self._right = top + panel.height, float(LEFT + PANEL_WIDTH)
        self._x = make_scale(panel.x, (d.x for d in panel.drawn), LEFT, PANEL_WIDTH, margin=0.0)
        levels = [np.array([limit.value]) for limit in panel.limits if not limit.of_x]
        data = (*(d.y for d in panel.drawn), *levels)
        self._y = make_scale(panel.y, data, self._bottom, -panel.height, margin=0.08)
        self._frame = f'x="{LEFT}" y="{top:g}" width="{PANEL_WIDTH}" height="{panel.height}"'

    def draw(self) -> str:
        """Return the panel as an SVG group; what comes later in the list covers what comes before."""
        parts = [
            self._group_start(),
            f'<clipPath id="{self._key}"><rect {self._frame}/></clipPath>',
            f'<rect {self._frame} fill="#fff"/>',
            *self._x_grid(),
            *self._y_grid(),
            f'<g clip-path="url(#{self._key})" fill="none">',
            *(self._band(band) for band in self._panel.bands),
            *(_area(area, self._x, self._y) for area in self._panel.areas),
            *(self._limit_line(limit) for limit in self._panel.limits),
            *(_marks(marks, self._x, self._y) for marks in self._panel.marks),
            *(_curve(curve, self._x, self._y) for curve in self._panel.curves),
            "</g>",
            *(self._band_label(band) for band in self._panel.bands),
            *(self._limit_label(limit) for limit in self._panel.limits),
            f'<rect {self._frame} fill="none" stroke="{_FRAME}"/>',
            *self._axis_labels(),
            "</g>",
        ]
        return "\n".join(parts)

    def _group_start(self) -> str:
        x, y = self._x, self._y
        names = f"{escape(self._panel.x.label)}|{escape(self._panel.y.label)}"
        return (
            f'<g class="panel" data-box="{LEFT} {self._top:g} {PANEL_WIDTH} {self._panel.height}" '
            f'data-x="{x.low:.10g} {x.high:.10g} {int(x.logarithmic)}" '
            f'data-y="{y.low:.10g} {y.high:.10g} {int(y.logarithmic)}" data-names="{names}">'
        )

    def _x_grid(self) -> list[str]:
        parts = []
        for tick in self._x.ticks():
            x = float(self._x.pixels(tick.value))
            parts.append(_line(x, self._top, x, self._bottom, _GRID if tick.label else _MINOR_GRID))
            if tick.label and self._has_x_labels:
                parts.append(_text(x, self._bottom + 15, tick.label, "middle"))
        return parts

    def _y_grid(self) -> list[str]:
        parts = []
        for tick in self._y.ticks():
            y = float(self._y.pixels(tick.value))
            parts.append(_line(LEFT, y, self._right, y, _GRID if tick.label else _MINOR_GRID))
            if tick.label:
                parts.append(_text(LEFT - 6, y + 4, tick.label, "end"))
        return parts

    def _band(self, band: Band) -> str:
        upper, lower = float(self._y.pixels(band.high)), float(self._y.pixels(band.low))
        return (
            f'<rect x="{LEFT}" y="{upper:.1f}" width="{PANEL_WIDTH}" height="{lower - upper:.1f}" '
            f'fill="{_BAND}"/>'
        )

    def _band_label(self, band: Band) -> str:
        return _text(self._right - 4, float(self._y.pixels(band.low)) + 13, band.label, "end", _SOFT_TEXT)

    def _limit_line(self, limit: Limit) -> str:
        at, dash = self._limit_pixel(limit), ' stroke-dasharray="2 3"'
        if limit.of_x:
            return _line(at, self._top, at, self._bottom, _LIMIT_LINE, dash)
        return _line(LEFT, at, self._right, at, _LIMIT_LINE, dash)

    def _limit_label(self, limit: Limit) -> str:
        at = self._limit_pixel(limit)
        if limit.of_x:
            return _text(at - 4, self._bottom - 6, limit.label, "end", _SOFT_TEXT)
        has_room_above = at - self._top > 14
        return _text(self._right - 4, at - 4 if has_room_above else at + 13, limit.label, "end", _SOFT_TEXT)

    def _limit_pixel(self, limit: Limit) -> float:
        return float((self._x if limit.of_x else self._y).pixels(limit.value))

    def _axis_labels(self) -> list[str]:
        middle = self._top + self._panel.height / 2
        parts = [
            f'<text transform="translate(15 {middle:g}) rotate(-90)" text-anchor="middle" fill="{_TEXT}">'
            f"{escape(self._panel.y.label)}</text>"
        ]
        if self._has_x_labels:
            parts.append(_text(LEFT + PANEL_WIDTH / 2, self._bottom + 32, self._panel.x.label, "middle"))
        return parts


def _curve(curve: Curve, x_scale: Scale, y_scale: Scale) -> str:
    x, y = x_scale.pixels(curve.x), y_scale.pixels(curve.y)
    if curve.holds:
        x, y = np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
    y = np.where(np.isinf(y), np.nan, np.clip(y, -_MAX_PIXEL, _MAX_PIXEL))
    finite = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    unbroken = np.split(finite, np.flatnonzero(np.diff(finite) > 1) + 1)
    path = "".join(
        "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x[run].tolist(), y[run].tolist(), strict=True))
        for run in unbroken
        if len(run)
    )
    return (
        f'<path data-label="{escape(curve.label)}" d="{path}" stroke="{curve.style.colour}" '
        f'stroke-width="{curve.style.width}" stroke-linejoin="round"{_dash(curve.style)}/>'
    )


def _area(area: Area, x_scale: Scale, y_scale: Scale) -> str:
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in _pixels(area, x_scale, y_scale))
    return (
        f'<polygon points="{points}" fill="{area.style.colour}" fill-opacity="{_TINT}" '
        f'stroke="{area.style.colour}" stroke-width="{area.style.width}" stroke-opacity="0.6"/>'
    )


def _marks(marks: Marks, x_scale: Scale, y_scale: Scale) -> str:
    zero = float(np.clip(y_scale.pixels(0.0), -_MAX_PIXEL, _MAX_PIXEL)) if not y_scale.logarithmic else 0.0
    return "".join(_mark(x, y, zero, marks.style, marks.shape) for x, y in _pixels(marks, x_scale, y_scale))


def _mark(x: float, y: float, zero: float, style: Style, shape: Shape) -> str:
    stroke = f' stroke="{style.colour}" stroke-width="{style.width}"'
    match shape:
        case Shape.DOT:
            return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{style.width}" fill="{style.colour}"/>'
        case Shape.CIRCLE:
            return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{_MARK}" fill="none"{stroke}/>'
        case Shape.CROSS:
            a, b = x - _MARK, x + _MARK
            up, down = y - _MARK, y + _MARK
            return (
                f'<line x1="{a:.1f}" y1="{up:.1f}" x2="{b:.1f}" y2="{down:.1f}"{stroke}/>'
                f'<line x1="{a:.1f}" y1="{down:.1f}" x2="{b:.1f}" y2="{up:.1f}"{stroke}/>'
            )
        case Shape.STEM:
            return (
                f'<line x1="{x:.1f}" y1="{zero:.1f}" x2="{x:.1f}" y2="{y:.1f}"{stroke}/>'
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.4" fill="{style.colour}"/>'
            )


def _pixels(drawn: Marks | Area, x_scale: Scale, y_scale: Scale) -> list[tuple[float, float]]:
    """Return the finite points as pixels; those far outside the panel are clipped."""
    x, y = x_scale.pixels(drawn.x), y_scale.pixels(drawn.y)
    known = np.isfinite(x) & np.isfinite(y)
    x, y = (np.clip(values[known], -_MAX_PIXEL, _MAX_PIXEL) for values in (x, y))
    return list(zip(x.tolist(), y.tolist(), strict=True))


def _legend(panels: Sequence[Panel]) -> tuple[str, int]:
    """Draw every label once, in rows, and return the drawing with its height in pixels."""
    labelled = {drawn.label: drawn for panel in panels for drawn in panel.drawn if drawn.label}
    parts, x, row = [], float(LEFT), 0
    for label, drawn in labelled.items():
        length = 30 + CHARACTER * len(label) + 14
        if x + length > WIDTH and x > LEFT:
            x, row = float(LEFT), row + 1
        y = TOP + LEGEND_ROW * row + 4
        parts.append(_legend_key(drawn, x, float(y)))
        parts.append(_text(x + 30, y + 4, label, "start"))
        x += length
    return "\n".join(parts), LEGEND_ROW * (row + 1) if labelled else 0


def _legend_key(drawn: Curve | Marks | Area, x: float, y: float) -> str:
    style = drawn.style
    match drawn:
        case Marks():
            return _mark(x + 12, y, y + 6, style, drawn.shape)
        case Area():
            return (
                f'<rect x="{x:.1f}" y="{y - 5:.1f}" width="24" height="10" fill="{style.colour}" '
                f'fill-opacity="{_TINT}" stroke="{style.colour}" stroke-width="{style.width}"/>'
            )
        case Curve():
            return _line(
                x, y, x + 24, y, style.colour, f'{_dash(style)} stroke-width="{max(style.width, 1.6)}"'
            )


def _dash(style: Style) -> str:
    return f' stroke-dasharray="{style.dash}"' if style.dash else ""


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, more: str = "") -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}"{more}/>'


def _text(x: float, y: float, text: str, anchor: str, colour: str = _TEXT) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{escape(text)}</text>'
