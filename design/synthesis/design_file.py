"""The design file: everything a design is asked for, one TOML document with a default for every key.

Lives here: the document, its checks, and the objects of this package that it stands for. The defaults are
the paper's (Sec. IV), designed in the sampled loop of the shipped rig. No designing.
"""

from __future__ import annotations

from importlib import resources
from string import Template
from typing import Annotated, Literal

import msgspec

from design.closed_loop.specifications import PAPER, Specification
from design.models.sampling import Sampling
from design.search.bounds import Parameter, with_bounds
from design.search.differential_evolution import DifferentialEvolution
from design.search.genetic_algorithm import GeneticAlgorithm
from design.search.searcher import Searcher
from design.synthesis.own_structures import own_structure
from design.synthesis.structures import (
    STRUCTURES,
    FreeTransferFunction,
    IntegralWeight,
    Structure,
)
from hil.core.documents import Document, from_toml
from hil.core.errors import DocumentError

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0.0)]

WEIGHT_STRUCTURES = ("integral", "p", "pi", "lead-lag", "pi-lead")
DIFFERENTIAL_EVOLUTION, GENETIC_ALGORITHM = "differential evolution", "genetic algorithm"


class Loop(Document, frozen=True):
    """The loop that the controller is for. ``delay_samples`` is 1 for valves that act at the next SYNC."""

    design: Literal["sampled", "continuous"] = "sampled"
    period_s: Positive = 0.0112
    delay_samples: Annotated[int, msgspec.Meta(ge=0, le=20)] = 1


class GainBelow(Document, frozen=True):
    """Open-loop gain of at least ``limit`` dB at every frequency up to ``up_to_rad_s``."""

    limit: float
    up_to_rad_s: Positive


class EffortForStep(Document, frozen=True):
    """At most ``limit`` volts after a setpoint step of ``step``, in the axis' unit."""

    limit: Positive
    step: Positive


class Specifications(Document, frozen=True):
    """Eq. (9) and others, by the names of ``specifications.QUANTITIES``; what is None is not asked for."""

    overshoot: NonNegative | None = None
    settling_s: Positive | None = None
    error: NonNegative | None = None
    bandwidth_rad_s: Positive | None = None
    gain_db: GainBelow | None = None
    rise_s: Positive | None = None
    closed_bandwidth_rad_s: Positive | None = None
    gain_margin_db: Positive | None = None
    phase_margin_deg: Positive | None = None
    effort_v: EffortForStep | None = None
    disturbance_peak: Positive | None = None

    def asked_for(self) -> tuple[Specification, ...]:
        """The specifications that are given, in the order of this class."""
        asked = []
        for quantity in self.__struct_fields__:
            match getattr(self, quantity):
                case None:
                    pass
                case GainBelow(limit=limit, up_to_rad_s=at) | EffortForStep(limit=limit, step=at):
                    asked.append(Specification(quantity, limit, at))
                case limit:
                    asked.append(Specification(quantity, limit))
        return tuple(asked)


PAPER_SPECIFICATIONS = msgspec.convert(
    {s.quantity: {"limit": s.limit, "up_to_rad_s": s.at} if s.kind.takes else s.limit for s in PAPER},
    Specifications,
)
"""The paper's specifications as a table of a design file; their limits stand in ``specifications.PAPER``."""


class Box(Document, frozen=True):
    """Where a parameter is searched, and whether the search sees it or its logarithm."""

    low: float
    high: float
    coding: Literal["logarithmic", "linear"] = "logarithmic"


class Weight(Document, frozen=True):
    """W1, eq. (3), and how far the conventional controller stays from the optimum: γ = factor γ_opt."""

    structure: Literal["integral", "p", "pi", "lead-lag", "pi-lead"] = "integral"
    b: Positive | None = None
    """Of the structure "integral", eq. (3): fixed, small; 0.001 if not given."""
    gamma_factor: Annotated[float, msgspec.Meta(gt=1.0, le=10.0)] = 1.1
    box: dict[str, Box] = msgspec.field(default_factory=dict)


class FreeOrders(Document, frozen=True):
    """Orders of the structure "free"."""

    num: Annotated[int, msgspec.Meta(ge=0, le=8)]
    den: Annotated[int, msgspec.Meta(ge=0, le=8)]
    integrators: Annotated[int, msgspec.Meta(ge=0, le=2)] = 0


class ControllerStructure(Document, frozen=True):
    """K(p): a shipped structure, "free" with ``orders``, or a class of one's own, "file.py:Class"."""

    structure: str = "pid"
    orders: FreeOrders | None = None
    must_meet_specifications: bool = False
    """Whether the designed loop must meet the specifications too, not only the loop that selects W1."""
    box: dict[str, Box] = msgspec.field(default_factory=dict)


class Search(Document, frozen=True):
    """The searcher, its seed, and how many candidates it may judge."""

    searcher: Literal["differential evolution", "genetic algorithm"] = "differential evolution"
    seed: Annotated[int, msgspec.Meta(ge=0)] = 1
    weight_evaluations: Annotated[int, msgspec.Meta(ge=100, le=10_000_000)] = 2000
    controller_evaluations: Annotated[int, msgspec.Meta(ge=100, le=10_000_000)] = 6000


class FurtherPlants(Document, frozen=True):
    """Plants identified under other conditions: checked by the ν-gap, or designed against all at once."""

    files: list[str] = msgspec.field(default_factory=list)
    """Shipped plants, or plant files relative to the design file."""
    worst_case: bool = False


class DesignFile(Document, frozen=True):
    """The whole design file."""

    axis_unit: Literal["m", "rad"] | None = None
    """Refuse plants in another unit; None takes the plant's."""
    loop: Loop = Loop()
    specifications: Specifications = PAPER_SPECIFICATIONS
    weight: Weight = Weight()
    controller: ControllerStructure = ControllerStructure()
    search: Search = Search()
    further_plants: FurtherPlants = FurtherPlants()

    @property
    def rig_sampling(self) -> Sampling:
        """How the rig's loop samples, whichever loop is designed for."""
        return Sampling(self.loop.period_s, self.loop.delay_samples)

    @property
    def sampling(self) -> Sampling | None:
        """Of the loop that is designed for; None for the continuous one."""
        return self.rig_sampling if self.loop.design == "sampled" else None

    def with_seed(self, seed: int) -> DesignFile:
        """The same with another seed."""
        return msgspec.structs.replace(self, search=msgspec.structs.replace(self.search, seed=seed))

    def weight_structure(self) -> Structure:
        """W1's structure with its boxes. Raises DesignError."""
        if self.weight.structure == "integral":
            structure: Structure = IntegralWeight(self.weight.b or 0.001)
        else:
            structure = STRUCTURES[self.weight.structure]
        return with_bounds(structure, _parameters(self.weight.box))

    def controller_structure(self) -> Structure:
        """K's structure with its boxes. Raises DesignError or DocumentError."""
        name, orders = self.controller.structure, self.controller.orders
        if name == "free" and orders is not None:
            structure: Structure = FreeTransferFunction(orders.num, orders.den, orders.integrators)
        elif name in STRUCTURES:
            structure = STRUCTURES[name]
        elif ":" in name:
            structure = own_structure(name, self.loop.period_s)
        elif name == "free":
            raise DocumentError(
                'controller structure "free": its orders go into a design file, controller.orders'
            )
        else:
            raise DocumentError(
                f"controller structure {name!r}: not one of {', '.join([*STRUCTURES, 'free'])}; "
                'a class of your own is named "file.py:Class" or "module:Class"'
            )
        return with_bounds(structure, _parameters(self.controller.box))

    def weight_searcher(self, dimensions: int) -> Searcher:
        """For eqs. (8), (9); the genetic algorithm with the paper's 100 chromosomes."""
        return self._searcher(dimensions, self.search.weight_evaluations, 100)

    def controller_searcher(self, dimensions: int) -> Searcher:
        """For eqs. (13), (14); the genetic algorithm with the paper's 200 chromosomes."""
        return self._searcher(dimensions, self.search.controller_evaluations, 200)

    def _searcher(self, dimensions: int, evaluations: int, chromosomes: int) -> Searcher:
        seed = self.search.seed
        if self.search.searcher == GENETIC_ALGORITHM:
            generations = max(evaluations // chromosomes, 1)
            return GeneticAlgorithm(dimensions, seed=seed, population=chromosomes, generations=generations)
        return DifferentialEvolution(dimensions, seed=seed, evaluations=evaluations)


def read_design(text: str, source: str) -> DesignFile:
    """Read and cross-check the text of a design file. Raises DocumentError naming file, key and limit."""
    design = from_toml(text, DesignFile, source)
    if not design.specifications.asked_for():
        raise DocumentError(
            f"{source}: specifications: none is given; the weight of largest margin then does nothing at all"
        )
    if design.weight.b is not None and design.weight.structure != "integral":
        raise DocumentError(f'{source}: weight.b: only the structure "integral" has it')
    if (design.controller.structure == "free") != (design.controller.orders is not None):
        raise DocumentError(
            f'{source}: controller.orders: the structure "free" takes orders, such as '
            "{ num = 2, den = 1, integrators = 1 }, and no other does"
        )
    for table, boxes in (("weight", design.weight.box), ("controller", design.controller.box)):
        for name, box in boxes.items():
            where = f"{source}: {table}.box.{name}"
            if not box.low < box.high:
                raise DocumentError(f"{where}: low {box.low} is not under high {box.high}")
            if box.coding == "logarithmic" and box.low <= 0.0:
                raise DocumentError(f'{where}: low {box.low} is not over 0; use coding = "linear"')
    return design


def example_text() -> str:
    """Return the commented example, which ``hil design --init`` writes; every value in it is the default.

    The limits of the paper are filled in from ``specifications.PAPER``.
    """
    text = resources.files("design.synthesis").joinpath("design.toml").read_text("utf-8")
    limits = {s.quantity: s.limit for s in PAPER}
    (gain,) = (s for s in PAPER if s.quantity == "gain_db")
    return Template(text).substitute(limits, gain_up_to_rad_s=gain.at)


def _parameters(boxes: dict[str, Box]) -> dict[str, Parameter]:
    return {name: Parameter(name, box.low, box.high, box.coding) for name, box in boxes.items()}
