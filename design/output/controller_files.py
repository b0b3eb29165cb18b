"""Write the controllers of a finished design as controller files, the documents that the gateway runs.

Every file is read back by the gateway's own reader before it is returned. A candidate whose loop is unstable
on the rig gets no file.
"""

from __future__ import annotations

from design.closed_loop.comparison import Candidate, Measures
from design.output.provenance import origin
from design.synthesis.procedure import Design
from design.synthesis.recommendation import is_unstable_on_rig
from hil.core.controller_file import ControllerFile, read_controller
from hil.core.documents import to_json

DESIGNED_FILE = "controller.json"
"""File name of the designed controller."""


def controller_files(design: Design) -> dict[str, str]:
    """Return JSON texts by file name: ``controller.json`` and a file for each controller compared with it."""
    texts = {}
    for candidate, measures in zip(design.candidates, design.measures, strict=True):
        if is_unstable_on_rig(measures):
            continue
        name = DESIGNED_FILE if candidate is design.designed else f"{candidate.name.lower()}.json"
        text = to_json(_document(design, candidate, measures))
        read_controller(text, name)
        texts[name] = text
    return texts


def _document(design: Design, candidate: Candidate, measures: Measures) -> ControllerFile:
    plant = design.plant
    return ControllerFile(
        format="hil-controller",
        version=1,
        name=f"{plant.name}: {candidate.name}",
        description=candidate.method,
        sample_time_s=design.problem.rig_sampling.period_s,
        input_unit=plant.output_unit,
        output_unit=plant.input_unit,
        law=candidate.law,
        origin=origin(design, candidate, measures),
    )
