"""From a plant to a controller: identification, and H-infinity loop shaping with fixed structures.

``hil`` never imports this package. The names below are the public API. Each is imported when it is first
used; scipy, control and matplotlib are imported by the functions that need them.

=========================  ==================================================================================
``identify``               identify a model from arrays u and y; :class:`Identification`
``identify_experiments``   the same from several records, each an :class:`Experiment`;
                           :class:`RecordRefusedError` if a record allows no model
``read_record``            read such a record from a recording or a table; :class:`Record`
``load_plant``             read a plant file, or a shipped plant by its name; :class:`Plant`
``paper_plant``            the paper's plant, eq. (15)
``load_design``            read a design file; :class:`DesignFile` is the default without one
``design_controller``      select the weight, eqs. (8), (9), and the controller, eqs. (13), (14);
                           :class:`Design`
``write_design``           write report, figures and controller files of a design
``loop_margins``           margins of a sampled loop, from a plant and a controller file;
                           :class:`LoopMargins`
``Sampling``               sample time and delay of a loop
``plant_to_control``       a plant as a model of python-control
``plant_from_control``     a model of python-control as a plant
``model_to_control``       an identified model as a model of python-control
``controller_to_control``  a controller file, as the gateway runs it, as a model of python-control
``DesignError``            a design that is not possible as requested
=========================  ==================================================================================

>>> import design
>>> from pathlib import Path
>>> plant = design.paper_plant()
>>> result = design.design_controller(design.DesignFile(), plant)
>>> result.eps > 0.56
True
>>> written = design.write_design(result, Path("designs/paper"))
>>> written.controller
PosixPath('designs/paper/controller.json')

The folders: ``mathematics``, ``models``, ``identification``, ``robustness``, ``closed_loop``, ``search`` and
``synthesis`` compute and do no I/O. ``paper`` reproduces the paper, ``output`` writes results, ``inputs``
reads files.

Conventions: feedback is negative. Polynomials are arrays (..., n + 1) of coefficients in falling powers, and
the leading axes are candidates. A sampled loop is computed in the bilinear plane (``models.sampling``), in
which Tustin's rule leaves the coefficients of a controller as they are, and all norms are those of the
sampled loop.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from design.errors import DesignError
    from design.identification.findings import RecordRefusedError
    from design.identification.identify import Identification, identify, identify_experiments
    from design.identification.records.experiment import Experiment
    from design.inputs import load_design, load_plant
    from design.margin_summary import LoopMargins, loop_margins
    from design.models.plant import Plant, paper_plant
    from design.models.sampling import Sampling
    from design.output.results import write_design
    from design.python_control import (
        controller_to_control,
        model_to_control,
        plant_from_control,
        plant_to_control,
    )
    from design.records import Record, read_record
    from design.synthesis.design_file import DesignFile
    from design.synthesis.procedure import Design, design_controller

_HOMES = {
    "Design": "design.synthesis.procedure",
    "DesignError": "design.errors",
    "DesignFile": "design.synthesis.design_file",
    "Experiment": "design.identification.records.experiment",
    "Identification": "design.identification.identify",
    "LoopMargins": "design.margin_summary",
    "Plant": "design.models.plant",
    "Record": "design.records",
    "RecordRefusedError": "design.identification.findings",
    "Sampling": "design.models.sampling",
    "controller_to_control": "design.python_control",
    "design_controller": "design.synthesis.procedure",
    "identify": "design.identification.identify",
    "identify_experiments": "design.identification.identify",
    "load_design": "design.inputs",
    "load_plant": "design.inputs",
    "loop_margins": "design.margin_summary",
    "model_to_control": "design.python_control",
    "paper_plant": "design.models.plant",
    "plant_from_control": "design.python_control",
    "plant_to_control": "design.python_control",
    "read_record": "design.records",
    "write_design": "design.output.results",
}
"""Module of each public name."""

__all__ = [
    "Design",
    "DesignError",
    "DesignFile",
    "Experiment",
    "Identification",
    "LoopMargins",
    "Plant",
    "Record",
    "RecordRefusedError",
    "Sampling",
    "controller_to_control",
    "design_controller",
    "identify",
    "identify_experiments",
    "load_design",
    "load_plant",
    "loop_margins",
    "model_to_control",
    "paper_plant",
    "plant_from_control",
    "plant_to_control",
    "read_record",
    "write_design",
]


def __getattr__(name: str) -> object:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'design' has no attribute {name!r}; it has {', '.join(__all__)}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
