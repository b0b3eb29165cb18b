"""Draws the histogram of a duration as SVG text, with a logarithmic count so that rare values show."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.views.duration_counts import DurationCounts

BINS = 60
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 520, 190, 44, 10, 10, 34
"""Size of the drawing and its margins, in pixels."""
MIN_SPAN_US = 20.0
"""Smallest range of the horizontal axis, in microseconds."""


def histogram(name: str, durations: DurationCounts) -> dict[str, Any]:
    """Return name, drawing and caption of the histogram of durations."""
    if len(durations) == 0:
        return {"name": name, "svg": "", "caption": "The run has no such value."}
    low, high = durations.min_ns * 1e-3, durations.max_ns * 1e-3
    counts, edges = durations.histogram(BINS, (low, max(high, low + MIN_SPAN_US)))
    p50, p99 = (value * 1e-3 for value in durations.quantiles_ns([0.5, 0.99]))
    caption = f"{len(durations)} values, p50 {p50:.0f} µs, p99 {p99:.0f} µs, largest {high:.0f} µs"
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
