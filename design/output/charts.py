"""Line charts as SVG text: axes, ticks, curves, limits, a legend. Knows no control engineering.

Written out directly because a plotting library takes longer to import than a whole design. One SVG is a
figure: panels one above the other with one legend. Every panel states its scales in data attributes, from
which the report's script reads values off the curves.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WIDTH, LEFT, RIGHT, TOP, BETWEEN, BOTTOM = 560, 62, 14, 12, 16, 40
LEGEND_ROW = 18
CHARACTER = 6.4
"""Mean width of a character of the legend, in pixels."""
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Style:
    """How a curve is drawn: a colour, and a dash pattern that tells it apart in print."""

    colour: str
    dash: str = ""
    width: float = 1.6


@dataclass(frozen=True)
class Curve:
    """y over x, both (k,); gaps where y is not finite. ``holds`` draws y[i] from x[i] to x[i + 1]."""

    label: str
    x: Array
    y: Array
    style: Style
    holds: bool = False


@dataclass(frozen=True)
class Limit:
    """A straight line at ``value`` with a label at its end, over a y axis or an x axis."""

    value: float
    label: str
    of_x: bool = False


@dataclass(frozen=True)
class Band:
    """Values of y between ``low`` and ``high``, shaded, with a label."""

    low: float
    high: float
    label: str


@dataclass(frozen=True)
class Axis:
    """A scale and its label; ends that are not given come from the curves."""

    label: str
    logarithmic: bool = False
    low: float | None = None
    high: float | None = None
    tick: float | None = None
    """Distance of ticks on a linear axis."""


@dataclass(frozen=True)
class Panel:
    """One system of axes."""

    x: Axis
    y: Axis
    curves: tuple[Curve, ...]
    limits: tuple[Limit, ...] = ()
    bands: tuple[Band, ...] = ()
    height: int = 230


@dataclass(frozen=True)
class _Scale:
    low: float
    high: float
    logarithmic: bool
    start: float
    length: float
    """In pixels; negative where values grow against them."""
    tick: float | None

    def pixels(self, values: Array | float) -> Array:
        with np.errstate(all="ignore"):
            position = self._of(np.asarray(values, dtype=float))
        low, high = float(self._of(np.asarray(self.low))), float(self._of(np.asarray(self.high)))
        return np.asarray(self.start + self.length * (position - low) / (high - low))

    def _of(self, values: Array) -> Array:
        return np.log10(values) if self.logarithmic else values

    def ticks(self) -> list[tuple[float, str]]:
        """Places and their labels; places between decades have none."""
        return _decades(self.low, self.high) if self.logarithmic else _round(self.low, self.high, self.tick)


def draw(panels: Sequence[Panel], name: str) -> str:
    """The panels as one SVG document; ``name`` is its accessible name and makes its ids unique."""
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
        parts.append(_panel(panel, top, f"{key}-{number}", is_last or panel.x != panels[number + 1].x))
        top += panel.height + BETWEEN
    parts.append("</svg>")
    return "\n".join(parts)


def _panel(panel: Panel, top: float, key: str, has_x_labels: bool) -> str:
    width, height = WIDTH - LEFT - RIGHT, panel.height
    xs = _scale(panel.x, (c.x for c in panel.curves), LEFT, width, margin=0.0)
    levels = [np.array([limit.value]) for limit in panel.limits if not limit.of_x]
    ys = _scale(panel.y, (*(c.y for c in panel.curves), *levels), top + height, -height, margin=0.08)
    frame = f'x="{LEFT}" y="{top:g}" width="{width}" height="{height}"'
    parts = [
        f'<g class="panel" data-box="{LEFT} {top:g} {width} {height}" '
        f'data-x="{xs.low:.10g} {xs.high:.10g} {int(xs.logarithmic)}" '
        f'data-y="{ys.low:.10g} {ys.high:.10g} {int(ys.logarithmic)}" '
        f'data-names="{escape(panel.x.label)}|{escape(panel.y.label)}">',
        f'<clipPath id="{key}"><rect {frame}/></clipPath>',
        f'<rect {frame} fill="#fff"/>',
    ]
    for value, label in xs.ticks():
        x = float(xs.pixels(value))
        parts.append(_line(x, top, x, top + height, "#e4e7eb" if label else "#f2f4f6"))
        if label and has_x_labels:
            parts.append(_text(x, top + height + 15, label, "middle"))
    for value, label in ys.ticks():
        y = float(ys.pixels(value))
        parts.append(_line(LEFT, y, LEFT + width, y, "#e4e7eb" if label else "#f2f4f6"))
        if label:
            parts.append(_text(LEFT - 6, y + 4, label, "end"))
    parts.append(f'<g clip-path="url(#{key})" fill="none">')
    for band in panel.bands:
        upper, lower = float(ys.pixels(band.high)), float(ys.pixels(band.low))
        parts.append(
            f'<rect x="{LEFT}" y="{upper:.1f}" width="{width}" height="{lower - upper:.1f}" fill="#dff0e4"/>'
        )
    for limit in panel.limits:
        at = float((xs if limit.of_x else ys).pixels(limit.value))
        x1, y1, x2, y2 = (at, top, at, top + height) if limit.of_x else (LEFT, at, LEFT + width, at)
        parts.append(_line(x1, y1, x2, y2, "#9aa3ad", ' stroke-dasharray="2 3"'))
    parts += [_curve(curve, xs, ys) for curve in panel.curves]
    parts.append("</g>")
    for band in panel.bands:
        parts.append(_text(LEFT + width - 4, float(ys.pixels(band.low)) + 13, band.label, "end", "#66707a"))
    for limit in panel.limits:
        at = float((xs if limit.of_x else ys).pixels(limit.value))
        if limit.of_x:
            parts.append(_text(at - 4, top + height - 6, limit.label, "end", "#66707a"))
        else:
            above = at - 4 if at - top > 14 else at + 13
            parts.append(_text(LEFT + width - 4, above, limit.label, "end", "#66707a"))
    parts.append(f'<rect {frame} fill="none" stroke="#8a939c"/>')
    middle = top + height / 2
    parts.append(
        f'<text transform="translate(15 {middle:g}) rotate(-90)" text-anchor="middle" fill="#333">'
        f"{escape(panel.y.label)}</text>"
    )
    if has_x_labels:
        parts.append(_text(LEFT + width / 2, top + height + 32, panel.x.label, "middle"))
    parts.append("</g>")
    return "\n".join(parts)


def _curve(curve: Curve, xs: _Scale, ys: _Scale) -> str:
    x, y = xs.pixels(curve.x), ys.pixels(curve.y)
    if curve.holds:
        x, y = np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
    # Far outside, where clipping hides it, browsers lose precision.
    y = np.where(np.isinf(y), np.nan, np.clip(y, -1e4, 1e4))
    drawn = np.isfinite(x) & np.isfinite(y)
    runs = np.split(np.flatnonzero(drawn), np.flatnonzero(np.diff(np.flatnonzero(drawn)) > 1) + 1)
    path = "".join(
        "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x[run].tolist(), y[run].tolist(), strict=True))
        for run in runs
        if len(run)
    )
    dash = f' stroke-dasharray="{curve.style.dash}"' if curve.style.dash else ""
    return (
        f'<path data-label="{escape(curve.label)}" d="{path}" stroke="{curve.style.colour}" '
        f'stroke-width="{curve.style.width}" stroke-linejoin="round"{dash}/>'
    )


def _legend(panels: Sequence[Panel]) -> tuple[str, int]:
    """The labels of all curves, each once, in rows; and the height of the rows."""
    styles = {curve.label: curve.style for panel in panels for curve in panel.curves if curve.label}
    parts, x, row = [], float(LEFT), 0
    for label, style in styles.items():
        length = 30 + CHARACTER * len(label) + 14
        if x + length > WIDTH and x > LEFT:
            x, row = float(LEFT), row + 1
        y = TOP + LEGEND_ROW * row + 4
        dash = f' stroke-dasharray="{style.dash}"' if style.dash else ""
        parts.append(_line(x, y, x + 24, y, style.colour, f'{dash} stroke-width="{max(style.width, 1.6)}"'))
        parts.append(_text(x + 30, y + 4, label, "start"))
        x += length
    return "\n".join(parts), LEGEND_ROW * (row + 1) if styles else 0


def _scale(axis: Axis, data: Iterable[Array], start: float, length: float, margin: float) -> _Scale:
    values = np.concatenate([np.asarray(values, dtype=float) for values in data])
    values = values[np.isfinite(values) & ((values > 0.0) if axis.logarithmic else True)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (1.0, 10.0)
    if axis.logarithmic:
        span = max(math.log10(high / low), 0.1)
        low, high = low / 10 ** (margin * span), high * 10 ** (margin * span)
    else:
        span = (high - low) or 1.0
        low, high = low - margin * span, high + margin * span
    low = low if axis.low is None else axis.low
    high = high if axis.high is None else axis.high
    if not low < high:
        high = low * 1.1 if low > 0.0 else low + 1.0
    return _Scale(low, high, axis.logarithmic, start, length, axis.tick)


def _round(low: float, high: float, tick: float | None) -> list[tuple[float, str]]:
    if tick is None:
        rough = (high - low) / 5.5
        unit = 10.0 ** math.floor(math.log10(rough))
        tick = next(m * unit for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * unit >= rough)
    while (high - low) / tick > 10:
        tick *= 2.0
    first = math.ceil(low / tick - 1e-9)
    last = math.floor(high / tick + 1e-9)
    return [(k * tick, f"{k * tick:.10g}".replace("-", "−")) for k in range(first, last + 1)]


def _decades(low: float, high: float) -> list[tuple[float, str]]:
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    every = max(1, -(-(last - first) // 8))
    labelled = (1, 2, 5) if math.log10(high / low) < 1.6 else (1,)
    multiples = range(1, 10) if last - first <= 6 else (1,)
    ticks = []
    for decade in range(first, last + 1):
        for m in multiples:
            value = m * 10.0**decade
            if low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
                has_label = m in labelled and decade % every == 0
                ticks.append((value, _power_of_ten(m, decade) if has_label else ""))
    return ticks


def _power_of_ten(m: int, decade: int) -> str:
    if -3 <= decade <= 3:
        return f"{m * 10.0**decade:g}"
    return ("" if m == 1 else f"{m}·") + "10" + str(decade).translate(_SUPERSCRIPTS)


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, more: str = "") -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}"{more}/>'


def _text(x: float, y: float, text: str, anchor: str, colour: str = "#333") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{escape(text)}</text>'
