"""Read values back off a drawn chart, from its scales and paths alone."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
from numpy.typing import NDArray

Runs = list[NDArray[np.float64]]
"""Unbroken pieces of a curve, each an array (k, 2) of x and y."""


def drawn_curves(svg: str) -> list[dict[str, Runs]]:
    """Return the curves by their labels, for every panel from the top."""
    panels = []
    for panel in ET.fromstring(svg).iter("{http://www.w3.org/2000/svg}g"):
        if panel.get("class") != "panel":
            continue
        left, top, width, height = _numbers(panel, "data-box")
        x, y = _numbers(panel, "data-x"), _numbers(panel, "data-y")
        curves: dict[str, Runs] = {}
        for path in panel.iter("{http://www.w3.org/2000/svg}path"):
            runs = []
            for piece in (path.get("d") or "").split("M")[1:]:
                pixels = np.array([[float(n) for n in point.split()] for point in piece.split("L")])
                across = _value((pixels[:, 0] - left) / width, *x)
                up = _value((top + height - pixels[:, 1]) / height, *y)
                runs.append(np.stack([across, up], axis=1))
            curves[path.get("data-label") or ""] = runs
        panels.append(curves)
    return panels


def _numbers(panel: ET.Element, name: str) -> list[float]:
    return [float(number) for number in (panel.get(name) or "").split()]


def _value(share: NDArray[np.float64], low: float, high: float, is_log: float) -> NDArray[np.float64]:
    return np.asarray(low * (high / low) ** share if is_log else low + share * (high - low))
