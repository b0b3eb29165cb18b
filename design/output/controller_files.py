"""Controller files of a finished design: the documents that cross to the daemon.

Each is read back by the daemon's own reader before it is handed out. What would be unstable there is no file.
"""

from __future__ import annotations

import math
from typing import Any

import msgspec

from design.closed_loop.comparison import Candidate, Measures
from design.output.report import loop_text, versions
from design.synthesis.procedure import Design
from hil.core.controller_file import ControllerFile, read_controller
from hil.core.documents import to_json

DESIGNED = "controller"


def controller_files(design: Design) -> dict[str, str]:
    """JSON texts by file name: controller.json is the designed one, the others bear their names."""
    texts = {}
    for index, (candidate, measures) in enumerate(zip(design.candidates, design.measures, strict=True)):
        if runs_unstable(measures):
            continue
        name = f"{DESIGNED if index == 0 else candidate.name.lower()}.json"
        text = to_json(_document(design, candidate, measures))
        read_controller(text, name)
        texts[name] = text
    return texts


def runs_unstable(measures: Measures) -> bool:
    """Whether the daemon's loop with this controller is unstable, as the plant's model has it."""
    return not measures.eps_sampled > 0.0


def _document(design: Design, candidate: Candidate, measures: Measures) -> ControllerFile:
    plant, problem = design.plant, design.problem
    return ControllerFile(
        format="hil-controller",
        version=1,
        name=f"{plant.name}: {candidate.name}",
        description=candidate.method,
        sample_time_s=problem.rig_sampling.period_s,
        input_unit=plant.output_unit,
        output_unit=plant.input_unit,
        law=candidate.law,
        origin=_origin(design, candidate, measures),
    )


def _origin(design: Design, candidate: Candidate, measures: Measures) -> dict[str, Any]:
    weight, search = design.weight, design.synthesis.search
    origin: dict[str, Any] = {
        "method": candidate.method,
        "plant": {
            key: getattr(design.plant, key)
            for key in (
                "name",
                "num",
                "den",
                "dead_time_s",
                "contains_delay_samples",
                "output_unit",
                "input_unit",
            )
        },
        "loop": loop_text(design),
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
        origin["design_file"] = msgspec.to_builtins(design.design_file)
        origin["specifications"] = [
            msgspec.to_builtins(reading) | {"value": _finite(reading.value)}
            for reading in design.designed_readings
        ]
        origin["searches"] = {
            "weight": {"searcher": weight.search.searcher, "seed": weight.search.seed},
            "controller": {
                "searcher": search.searcher,
                "seed": search.seed,
                "evaluations": search.evaluations,
            },
        }
    return origin


def _finite(value: float) -> float | None:
    """JSON has no infinity."""
    return value if math.isfinite(value) else None
