"""Draws the histogram of a duration as SVG text, with a logarithmic count so that rare values show."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

BINS = 60
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 520, 190, 44, 10, 10, 34
"""Size of the drawing and its margins, in pixels."""
MIN_SPAN_US = 20.0
"""Smallest range of the horizontal axis, in microseconds."""


def histogram(name: str, values_us: npt.NDArray[np.floating[Any]]) -> dict[str, Any]:
    """Return name, drawing and caption of the histogram of durations in microseconds."""
    if len(values_us) == 0:
        return {"name": name, "svg": "", "caption": "The run has no such value."}
    low, high = float(values_us.min()), float(values_us.max())
    high = max(high, low + MIN_SPAN_US)
    counts, edges = np.histogram(values_us, BINS, (low, high))
    p50, p99 = np.percentile(values_us, [50.0, 99.0])
    caption = f"{len(values_us)} values, p50 {p50:.0f} µs, p99 {p99:.0f} µs, largest {values_us.max():.0f} µs"
    return {"name": name, "svg": _draw(name, counts, edges), "caption": caption}


def _draw(name: str, counts: npt.NDArray[np.int64], edges: npt.NDArray[np.floating[Any]]) -> str:
    decades = max(math.ceil(math.log10(int(counts.max()) + 1)), 1)
    width, height = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM
    bottom = TOP + height

    def y(count: float) -> float:
        return bottom - height * math.log10(max(count, 0.7) / 0.7) / math.log10(10.0**decades / 0.7)

    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="histogram of {name}" class="bars">']
    for decade in range(decades + 1):
        at = y(10.0**decade)
        parts.append(f'<line class="grid" x1="{LEFT}" y1="{at:.1f}" x2="{WIDTH - RIGHT}" y2="{at:.1f}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{at + 4:.1f}" text-anchor="end">{10**decade}</text>')
    step = width / len(counts)
    for place, count in enumerate(counts.tolist()):
        if count:
            at = y(count)
            parts.append(
                f'<rect x="{LEFT + place * step:.1f}" y="{at:.1f}" width="{max(step - 1, 1):.1f}" '
                f'height="{bottom - at:.1f}"><title>{edges[place]:.0f} to {edges[place + 1]:.0f} µs: {count}'
                "</title></rect>"
            )
    for part in (0.0, 0.25, 0.5, 0.75, 1.0):
        value = edges[0] + part * (edges[-1] - edges[0])
        anchor = {0.0: "start", 1.0: "end"}.get(part, "middle")
        parts.append(
            f'<text x="{LEFT + part * width:.1f}" y="{bottom + 14}" text-anchor="{anchor}">{value:.0f}</text>'
        )
    parts.append(
        f'<text x="{LEFT + width / 2}" y="{bottom + 29}" text-anchor="middle">{name} (µs)</text></svg>'
    )
    return "".join(parts)
