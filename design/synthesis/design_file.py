"""The design file: all requirements of a design, as one TOML document with a default for every key.

This module reads and checks the document and turns it into structures, specifications and searchers. The
defaults are the paper's (Sec. IV), designed in the sampled loop of the shipped rig. ``hil design --init``
writes the commented example, ``design.toml``.
"""

from __future__ import annotations

import tomllib
from importlib import resources
from string import Template
from typing import Annotated, Literal

import msgspec

from design.closed_loop.specifications import PAPER, Specification
from design.models.sampling import Sampling
from design.search.bounds import with_bounds
from design.search.differential_evolution import DifferentialEvolution
from design.search.genetic_algorithm import GeneticAlgorithm
from design.search.searcher import Searcher
from design.synthesis.own_structures import own_structure
from design.synthesis.search_ranges import SearchRange, check_search_ranges, search_parameters
from design.synthesis.structures import (
    STRUCTURES,
    FreeTransferFunction,
    IntegralWeight,
    Structure,
)
from hil.core.documents import Document, from_toml
from hil.core.errors import DocumentError
from hil.core.suggestions import did_you_mean

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0.0)]

GENETIC_ALGORITHM = "genetic algorithm"
WEIGHT_CHROMOSOMES, CONTROLLER_CHROMOSOMES = 100, 200
"""Population of the genetic algorithm in the paper's search for the weight and for the controller."""

_RENAMED_KEYS = {
    ("weight", "box"): "weight.search_ranges",
    ("controller", "box"): "controller.search_ranges",
}
"""Keys of earlier versions, and their names today."""


class LoopOptions(Document, frozen=True):
    """The loop that the controller is designed for."""

    design: Literal["sampled", "continuous"] = "sampled"
    """Loop of the design: sampled, with hold, period and delay, or continuous, as in the paper."""
    period_s: Positive = 0.0112
    """Period of the rig's loop in seconds."""
    delay_samples: Annotated[int, msgspec.Meta(ge=0, le=20)] = 1
    """Samples between a measurement and its effect on the valve; 1 for valves that act at the next SYNC."""


class GainBelow(Document, frozen=True):
    """Smallest open-loop gain, ``limit`` in dB, at every frequency up to ``up_to_rad_s``."""

    limit: float
    up_to_rad_s: Positive


class EffortForStep(Document, frozen=True):
    """Largest manipulated variable, ``limit`` in V, after a setpoint step of ``step`` in the axis' unit."""

    limit: Positive
    step: Positive


class Specifications(Document, frozen=True):
    """Specifications of eq. (9) and others, named as in ``specifications.QUANTITIES``; None: no limit."""

    overshoot: NonNegative | None = None
    """Share of the step, not per cent."""
    settling_s: Positive | None = None
    error: NonNegative | None = None
    """Share of the step, not per cent."""
    bandwidth_rad_s: Positive | None = None
    gain_db: GainBelow | None = None
    rise_s: Positive | None = None
    closed_bandwidth_rad_s: Positive | None = None
    gain_margin_db: Positive | None = None
    phase_margin_deg: Positive | None = None
    effort_v: EffortForStep | None = None
    disturbance_peak: Positive | None = None

    def requested(self) -> tuple[Specification, ...]:
        """Return the specifications that have a limit, in the order of this class."""
        requested = []
        for quantity in self.__struct_fields__:
            match getattr(self, quantity):
                case None:
                    pass
                case GainBelow(limit=limit, up_to_rad_s=at) | EffortForStep(limit=limit, step=at):
                    requested.append(Specification(quantity, limit, at))
                case limit:
                    requested.append(Specification(quantity, limit))
        return tuple(requested)


PAPER_SPECIFICATIONS = msgspec.convert(
    {s.quantity: {"limit": s.limit, "up_to_rad_s": s.at} if s.kind.takes else s.limit for s in PAPER},
    Specifications,
)
"""The paper's specifications as a table of a design file; their limits stand in ``specifications.PAPER``."""


class Weight(Document, frozen=True):
    """The weight W1 and the conventional controller that is made with it."""

    structure: Literal["integral", "p", "pi", "lead-lag", "pi-lead"] = "integral"
    b: Positive | None = None
    """Fixed parameter b of the structure "integral", eq. (3), in rad/s; None means 0.001."""
    gamma_factor: Annotated[float, msgspec.Meta(gt=1.0, le=10.0)] = 1.1
    """Ratio γ/γ_opt for which the conventional controller is designed."""
    search_ranges: dict[str, SearchRange] = msgspec.field(default_factory=dict)
    """Search ranges by parameter name, where they differ from the structure's own."""


class FreeOrders(Document, frozen=True):
    """Orders of the structure "free": degree of num, degree of den without integrators, and integrators."""

    num: Annotated[int, msgspec.Meta(ge=0, le=8)]
    den: Annotated[int, msgspec.Meta(ge=0, le=8)]
    integrators: Annotated[int, msgspec.Meta(ge=0, le=2)] = 0


class ControllerStructure(Document, frozen=True):
    """The structure K(p) of the controller."""

    structure: str = "pid"
    """A shipped structure, "free" (which needs ``orders``), or a user's own class, "file.py:Class"."""
    orders: FreeOrders | None = None
    must_meet_specifications: bool = False
    """Require the specifications of the designed loop too, not only of the loop that selects W1."""
    search_ranges: dict[str, SearchRange] = msgspec.field(default_factory=dict)
    """Search ranges by parameter name, where they differ from the structure's own."""


class Search(Document, frozen=True):
    """The searcher, its seed, and the largest number of candidates that it may evaluate."""

    searcher: Literal["differential evolution", "genetic algorithm"] = "differential evolution"
    seed: Annotated[int, msgspec.Meta(ge=0)] = 1
    weight_evaluations: Annotated[int, msgspec.Meta(ge=100, le=10_000_000)] = 2000
    controller_evaluations: Annotated[int, msgspec.Meta(ge=100, le=10_000_000)] = 6000


class FurtherPlants(Document, frozen=True):
    """Plants identified under other conditions."""

    files: list[str] = msgspec.field(default_factory=list)
    """Shipped plants, or plant files relative to the design file."""
    worst_case: bool = False
    """Design against all plants at once; if false, the plants are only checked by the ν-gap."""


class DesignFile(Document, frozen=True):
    """The whole design file."""

    axis_unit: Literal["m", "rad"] | None = None
    """Unit that every plant must have; None accepts the unit of the plant."""
    loop: LoopOptions = LoopOptions()
    specifications: Specifications = PAPER_SPECIFICATIONS
    weight: Weight = Weight()
    controller: ControllerStructure = ControllerStructure()
    search: Search = Search()
    further_plants: FurtherPlants = FurtherPlants()

    @property
    def rig_sampling(self) -> Sampling:
        """Sampling of the rig's loop, whichever loop the controller is designed in."""
        return Sampling(self.loop.period_s, self.loop.delay_samples)

    @property
    def sampling(self) -> Sampling | None:
        """Sampling of the loop that the controller is designed in; None for the continuous loop."""
        return self.rig_sampling if self.loop.design == "sampled" else None

    def with_seed(self, seed: int) -> DesignFile:
        """Return the design file with another seed for every search."""
        return msgspec.structs.replace(self, search=msgspec.structs.replace(self.search, seed=seed))

    def with_structure(self, name: str) -> DesignFile:
        """Return the design file with another controller structure, in that structure's own search ranges."""
        controller = ControllerStructure(
            structure=name, must_meet_specifications=self.controller.must_meet_specifications
        )
        return msgspec.structs.replace(self, controller=controller)

    def weight_structure(self) -> Structure:
        """Return the structure of W1 with its search ranges. Raises DesignError for an unknown parameter."""
        if self.weight.structure == "integral":
            structure: Structure = IntegralWeight(self.weight.b or 0.001)
        else:
            structure = STRUCTURES[self.weight.structure]
        return with_bounds(structure, search_parameters(self.weight.search_ranges))

    def controller_structure(self) -> Structure:
        """Return the controller's structure with its search ranges. Raises DesignError or DocumentError."""
        return with_bounds(self._bare_structure(), search_parameters(self.controller.search_ranges))

    def weight_searcher(self, dimensions: int) -> Searcher:
        """Make the searcher for the weight, eqs. (8) and (9)."""
        return self._searcher(dimensions, self.search.weight_evaluations, WEIGHT_CHROMOSOMES)

    def controller_searcher(self, dimensions: int) -> Searcher:
        """Make the searcher for the controller, eqs. (13) and (14)."""
        return self._searcher(dimensions, self.search.controller_evaluations, CONTROLLER_CHROMOSOMES)

    def _bare_structure(self) -> Structure:
        name, orders = self.controller.structure, self.controller.orders
        if name == "free" and orders is not None:
            return FreeTransferFunction(orders.num, orders.den, orders.integrators)
        if name == "free":
            raise DocumentError(
                'controller structure "free": it needs orders; write controller.orders into a design file'
            )
        if name in STRUCTURES:
            return STRUCTURES[name]
        if ":" in name:
            return own_structure(name, self.loop.period_s)
        raise DocumentError(
            f"controller structure {name!r}: not one of {', '.join([*STRUCTURES, 'free'])}"
            f"{did_you_mean(name, [*STRUCTURES, 'free']) or '.'} Name a class of your own as "
            '"file.py:Class" or "module:Class"'
        )

    def _searcher(self, dimensions: int, evaluations: int, chromosomes: int) -> Searcher:
        seed = self.search.seed
        if self.search.searcher == GENETIC_ALGORITHM:
            generations = max(evaluations // chromosomes, 1)
            return GeneticAlgorithm(dimensions, seed=seed, population=chromosomes, generations=generations)
        return DifferentialEvolution(dimensions, seed=seed, evaluations=evaluations)


def _refuse_percentages(specifications: Specifications, source: str) -> None:
    """Raise DocumentError for a share of the step over 1, which is a percentage by mistake."""
    for key in ("overshoot", "error"):
        value = getattr(specifications, key)
        if value is not None and value > 1.0:
            raise DocumentError(
                f"{source}: specifications.{key} is {value:g}, limit 1: it is a share of the step, not per "
                f"cent; for {value:g} %, write {0.01 * value:g}"
            )


def read_design(text: str, source: str) -> DesignFile:
    """Read and check the text of a design file; ``source`` names it in errors.

    Raises DocumentError with file, key, value and limit.
    """
    try:
        design = from_toml(text, DesignFile, source)
    except DocumentError:
        _refuse_renamed_keys(text, source)
        raise
    if not design.specifications.requested():
        raise DocumentError(
            f"{source}: specifications: none is given; without one, the weight of largest margin leaves the "
            "plant alone. Give at least one limit, such as bandwidth_rad_s"
        )
    _refuse_percentages(design.specifications, source)
    if design.weight.b is not None and design.weight.structure != "integral":
        raise DocumentError(
            f'{source}: weight.b: only the structure "integral" has it, and weight.structure is '
            f'"{design.weight.structure}"; remove the key'
        )
    if (design.controller.structure == "free") != (design.controller.orders is not None):
        raise DocumentError(
            f'{source}: controller.orders: the structure "free" needs orders, such as '
            "{ num = 2, den = 1, integrators = 1 }; every other structure must not have them"
        )
    check_search_ranges("weight", design.weight.search_ranges, source)
    check_search_ranges("controller", design.controller.search_ranges, source)
    return design


def example_text() -> str:
    """Return the commented example that ``hil design --init`` writes; every value in it is the default.

    The limits of the paper are filled in from ``specifications.PAPER``.
    """
    template = Template(resources.files("design.synthesis").joinpath("design.toml").read_text("utf-8"))
    (gain,) = (s for s in PAPER if s.quantity == "gain_db")
    return template.substitute({s.quantity: s.limit for s in PAPER}, gain_up_to_rad_s=gain.at)


def _refuse_renamed_keys(text: str, source: str) -> None:
    """Raise DocumentError with the new name if a refused document has a key of an earlier version."""
    try:
        document = tomllib.loads(text)
    except ValueError:
        return
    for (table, key), new_name in _RENAMED_KEYS.items():
        if isinstance(document.get(table), dict) and key in document[table]:
            raise DocumentError(f"{source}: {table}.{key}: this key is now {new_name}; rename it") from None
