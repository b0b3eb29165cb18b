"""The design file: its defaults, its checks, and the objects that are made from it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from design.closed_loop.specifications import PAPER, QUANTITIES, Specification
from design.errors import DesignError
from design.models.sampling import Sampling
from design.search.differential_evolution import DifferentialEvolution
from design.search.genetic_algorithm import GeneticAlgorithm
from design.synthesis.design_file import (
    ControllerStructure,
    DesignFile,
    example_text,
    read_design,
)
from design.synthesis.structures import (
    STRUCTURES,
    FreeTransferFunction,
    IntegralWeight,
    LeadLag,
    ProportionalIntegralDerivative,
)
from hil.core.errors import DocumentError


def test_the_example_states_the_defaults_and_no_others() -> None:
    example, empty = read_design(example_text(), "design.toml"), DesignFile()
    assert example.loop == empty.loop
    assert example.specifications == empty.specifications
    assert example.search == empty.search
    assert example.further_plants == empty.further_plants
    assert example.weight_structure() == empty.weight_structure()
    assert example.controller_structure() == empty.controller_structure()
    assert example.axis_unit is empty.axis_unit is None


def test_every_line_that_the_example_comments_out_is_valid() -> None:
    """Each is uncommented alone; ``orders`` is left out, since only the structure "free" may have it."""
    lines = example_text().splitlines()
    tried = 0
    for i, line in enumerate(lines):
        key = re.match(r"# (\w+) = ", line)
        if key is None or key[1] == "orders":
            continue
        text = "\n".join([*lines[:i], line.removeprefix("# "), *lines[i + 1 :]])
        assert key[1] in str(tomllib.loads(text))
        read_design(text, "design.toml")
        tried += 1
    assert tried == 7


def test_the_defaults_are_the_papers_in_the_loop_of_the_rig() -> None:
    empty = read_design("", "design.toml")
    assert empty.specifications.requested() == PAPER
    assert empty.sampling == empty.rig_sampling == Sampling(0.0112, 1)
    assert empty.weight_structure() == IntegralWeight()
    assert empty.controller_structure() == ProportionalIntegralDerivative()
    assert (empty.search.weight_evaluations, empty.search.controller_evaluations) == (2000, 6000)


def test_a_specification_that_is_left_out_has_no_limit() -> None:
    design = read_design("[specifications]\novershoot = 0.1\nphase_margin_deg = 60\n", "d.toml")
    assert design.specifications.requested() == (
        Specification("overshoot", 0.1),
        Specification("phase_margin_deg", 60.0),
    )


def test_every_quantity_can_be_specified() -> None:
    lines = [
        f"{name} = {{ limit = 0.75, {'up_to_rad_s' if name == 'gain_db' else 'step'} = 0.5 }}"
        if quantity.takes
        else f"{name} = 0.75"
        for name, quantity in QUANTITIES.items()
    ]
    requested = read_design("\n".join(["[specifications]", *lines]), "d.toml").specifications.requested()
    assert {s.quantity for s in requested} == set(QUANTITIES)
    assert all(s.limit == 0.75 and s.at == (0.5 if s.kind.takes else 1.0) for s in requested)


def test_a_continuous_design_keeps_the_sampling_of_the_rig_for_comparison() -> None:
    design = read_design('[loop]\ndesign = "continuous"\nperiod_s = 0.005\ndelay_samples = 2\n', "d.toml")
    assert design.sampling is None
    assert design.rig_sampling == Sampling(0.005, 2)


def test_structures_search_ranges_and_codings() -> None:
    design = read_design(
        '[controller]\nstructure = "lead-lag"\n'
        '[controller.search_ranges]\nk = { low = -5, high = 5, coding = "linear" }\n'
        '[weight]\nstructure = "pi"\n',
        "d.toml",
    )
    structure = design.controller_structure()
    assert isinstance(structure, LeadLag)
    k, t1, _ = structure.parameters
    assert (k.low, k.high, k.coding) == (-5.0, 5.0, "linear")
    assert t1 == STRUCTURES["lead-lag"].parameters[1]
    assert design.weight_structure() == STRUCTURES["pi"]


def test_the_structure_free_is_made_from_its_orders() -> None:
    text = '[controller]\nstructure = "free"\norders = { num = 2, den = 1, integrators = 1 }\n'
    structure = read_design(text, "d.toml").controller_structure()
    assert structure == FreeTransferFunction(2, 1, 1)


def test_a_users_own_class_is_found_in_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "my_structures.py").write_text(
        "from design.synthesis.structures import Proportional\n"
        "class Mine(Proportional):\n    '''Mine.'''\nnumber = 3\n"
    )
    monkeypatch.chdir(tmp_path)
    mine = read_design('[controller]\nstructure = "my_structures:Mine"\n', "d.toml").controller_structure()
    assert type(mine).__name__ == "Mine"
    with pytest.raises(DocumentError, match=r"my_structures:number.*lacks parameters"):
        read_design('[controller]\nstructure = "my_structures:number"\n', "d.toml").controller_structure()
    with pytest.raises(DocumentError, match="no attribute 'Other'"):
        read_design('[controller]\nstructure = "my_structures:Other"\n', "d.toml").controller_structure()


OWN = """
from dataclasses import dataclass
import numpy as np
from design.search.bounds import Parameter
from design.models.controller import one_degree_of_freedom
from design.synthesis.structures import Proportional, TustinLaw

@dataclass(frozen=True)
class Mine(TustinLaw):
    parameters: tuple = (Parameter("k", 0.01, 100.0), Parameter("t", 0.01, 1.0))
    def controller(self, values):
        k, t = values.T
        return one_degree_of_freedom(k[:, None], np.stack([t, np.ones_like(t)], axis=-1))

class Raises(Mine):
    def controller(self, values):
        raise KeyError("gain")

class NotFinite(Mine):
    def controller(self, values):
        return one_degree_of_freedom(np.log(values[:, :1] - 1.0), np.ones((1, 1)))

class WrongShape(Mine):
    def controller(self, values):
        return one_degree_of_freedom(values[:, 0], np.ones((1, 1)))

class Improper(Mine):
    def controller(self, values):
        return one_degree_of_freedom(values, np.ones((1, 1)))

class NoLaw(Mine):
    def law(self, values, period_s):
        return None
"""


@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_users_own_class_is_checked_before_it_is_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_file.py").write_text(OWN)
    (tmp_path / "broken.py").write_text("def (")
    monkeypatch.chdir(tmp_path)

    def structure(name: str) -> object:
        return read_design(f'[controller]\nstructure = "{name}"\n', "d.toml").controller_structure()

    assert type(structure("own_file.py:Mine")).__name__ == "Mine"
    for name, message in {
        "own_file.py:Raises": "KeyError: 'gain'",
        "own_file.py:NotFinite": r"num is not finite at k 0\.",
        "own_file.py:WrongShape": r"num has shape \(5,\) for 5 candidates, not \(5, n \+ 1\)",
        "own_file.py:Improper": "an improper controller cannot run",
        "own_file.py:NoLaw": "law: returns NoneType, not a law",
        "nowhere.py:Mine": "nowhere.py: no such file",
        "broken.py:Mine": "SyntaxError",
        "no_such_module:Mine": "No module named 'no_such_module'",
        "free": "it needs orders",
    }.items():
        with pytest.raises(DocumentError, match=message):
            DesignFile(controller=ControllerStructure(structure=name)).controller_structure()


def test_searchers_have_the_seed_and_the_papers_populations() -> None:
    default = read_design("[search]\nseed = 7\n", "d.toml").controller_searcher(4)
    assert isinstance(default, DifferentialEvolution)
    assert default.seed == 7
    genetic = read_design('[search]\nsearcher = "genetic algorithm"\n', "d.toml")
    for searcher, chromosomes, generations in (
        (genetic.weight_searcher(2), 100, 20),
        (genetic.controller_searcher(4), 200, 30),
    ):
        assert isinstance(searcher, GeneticAlgorithm)
        count = 0
        while searcher.stop_reason() is None:
            points = searcher.ask()
            assert len(points) == chromosomes
            searcher.update(points[:, 0])
            count += 1
        assert count == generations


def test_with_seed_changes_only_the_seed() -> None:
    changed = DesignFile().with_seed(9)
    assert changed.search.seed == 9
    assert changed.with_seed(1) == DesignFile()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[specification]\n", r"unknown key specification; did you mean specifications\?"),
        (
            "[specifications]\novershot = 0.1\n",
            r"specifications: unknown key overshot; did you mean overshoot\?",
        ),
        ("[specifications]\n", "specifications: none is given"),
        (
            "[specifications]\novershoot = -0.1\n",
            r"specifications.overshoot is -0.1, but must be at least 0.0",
        ),
        ("[loop]\nperiod_s = 0\n", r"loop.period_s is 0, but must be more than 0.0"),
        ("[loop]\ndelay_samples = -1\n", r"loop.delay_samples is -1, but must be at least 0"),
        ('[loop]\ndesign = "digital"\n', "loop.design is 'digital', but must be 'continuous' or 'sampled'"),
        ("[weight]\ngamma_factor = 1.0\n", "weight.gamma_factor is 1.0, but must be more than 1.0"),
        ('[weight]\nstructure = "pi"\nb = 0.1\n', r'weight.b: only the structure "integral" has it'),
        (
            "[weight.search_ranges]\nkw = { low = 2.0, high = 1.0 }\n",
            "weight.search_ranges.kw: low 2 is not below high 1",
        ),
        (
            "[weight.search_ranges]\nkw = { low = 0.0, high = 1.0 }\n",
            'weight.search_ranges.kw: low 0 is not over 0, .* coding = "linear"',
        ),
        (
            "[weight.box]\nkw = { low = 1.0, high = 2.0 }\n",
            "weight.box: this key is now weight.search_ranges; rename it",
        ),
        (
            "[controller]\nbox = { kp = { low = 1.0, high = 2.0 } }\n",
            "controller.box: this key is now controller.search_ranges; rename it",
        ),
        ('[controller]\nstructure = "free"\n', "controller.orders"),
        ("[controller]\norders = { num = 1, den = 1 }\n", "controller.orders"),
        ("[search]\nseed = -1\n", "search.seed is -1, but must be at least 0"),
        (
            '[search]\nsearcher = "guess"\n',
            "search.searcher is 'guess', but must be 'differential evolution' or 'genetic algorithm'",
        ),
        ("[search\n", "not valid TOML"),
    ],
)
def test_a_wrong_document_is_refused_with_file_and_key(text: str, message: str) -> None:
    with pytest.raises(DocumentError, match=f"^d.toml.*{message}"):
        read_design(text, "d.toml")


def test_an_unknown_parameter_or_structure_is_refused_with_those_that_exist() -> None:
    with pytest.raises(DesignError, match=r"no parameter kq; it has kp, ki, kd, tau_d"):
        read_design(
            "[controller.search_ranges]\nkq = { low = 1.0, high = 2.0 }\n", "d"
        ).controller_structure()
    with pytest.raises(DocumentError, match=r"'pidd': not one of p, pi, pd, pid, .*free"):
        read_design('[controller]\nstructure = "pidd"\n', "d").controller_structure()


@pytest.mark.parametrize("key", ["overshoot", "error"])
def test_a_share_in_per_cent_is_refused_with_the_share_that_is_meant(key: str) -> None:
    complaint = rf"specifications\.{key} is 5, limit 1: .*; for 5 %, write 0\.05"
    with pytest.raises(DocumentError, match=complaint):
        read_design(f"[specifications]\n{key} = 5\n", "d.toml")
    assert getattr(read_design(f"[specifications]\n{key} = 1.0\n", "d.toml").specifications, key) == 1.0


def test_a_mistyped_structure_gets_a_hint() -> None:
    with pytest.raises(DocumentError, match=r"did you mean lead-lag\? Name a class"):
        DesignFile().with_structure("leadlag").controller_structure()
