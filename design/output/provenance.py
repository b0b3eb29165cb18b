"""State where a designed controller comes from: its plant, weight, margins, searches and program versions."""

from __future__ import annotations

import math
import platform
from importlib.metadata import version
from typing import Any

import msgspec

from design.closed_loop.comparison import Candidate, Measures
from design.models.plant import Plant
from design.synthesis.procedure import Design

_PACKAGES = ("pneumatic-hil", "numpy", "scipy")
"""Packages whose version can change a result."""
_PLANT_KEYS = (
    "name",
    "num",
    "den",
    "dead_time_s",
    "contains_delay_samples",
    "output_unit",
    "input_unit",
    "warnings",
)
"""Keys of a plant document that a controller file repeats."""


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that a result depends on."""
    return {"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}}


def origin(design: Design, candidate: Candidate, measures: Measures) -> dict[str, Any]:
    """Return the provenance of one candidate as plain JSON values, for its controller file."""
    weight = design.weight
    result: dict[str, Any] = {
        "method": candidate.method,
        "plant": _plant(design.plant),
        "loop": design.loop_description,
        "weight": {"num": weight.weight.num.tolist(), "den": weight.weight.den.tolist(), **weight.parameters},
        "continuous": {
            "num": candidate.controller.num.ravel().tolist(),
            "den": candidate.controller.den.ravel().tolist(),
        },
        "parameters": dict(candidate.parameters),
        "margins": {
            "eps_opt": design.problem.eps_opt,
            "eps_continuous": _finite(measures.eps_continuous),
            "eps_sampled": measures.eps_sampled,
            "gain_margin": _finite(measures.gain_margin),
            "phase_margin_rad": measures.phase_margin_rad,
        },
        "versions": versions(),
    }
    if candidate is design.designed:
        result |= _search_origin(design)
    return result


def _plant(plant: Plant) -> dict[str, Any]:
    return {key: getattr(plant, key) for key in _PLANT_KEYS}


def _search_origin(design: Design) -> dict[str, Any]:
    """Return what only the designed controller has: design file, readings and searches."""
    weight, controller = design.weight.search, design.synthesis.search
    return {
        "design_file": msgspec.to_builtins(design.design_file),
        "specifications": [
            msgspec.to_builtins(reading) | {"value": _finite(reading.value)}
            for reading in design.designed_readings
        ],
        "searches": {
            "weight": {"searcher": weight.searcher, "seed": weight.seed},
            "controller": {
                "searcher": controller.searcher,
                "seed": controller.seed,
                "evaluations": controller.evaluations,
            },
        },
    }


def _finite(value: float) -> float | None:
    """Return the value, or None for infinity and NaN, which JSON cannot express."""
    return value if math.isfinite(value) else None
