"""Plant documents: what they contain, what is refused, and what a loop sees of them."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from typing import Any

import msgspec
import numpy as np
import pytest
import scipy.signal

from design.closed_loop.loops import ClosedLoops
from design.errors import DesignError
from design.models.controller import one_degree_of_freedom
from design.models.plant import Plant, check_plant_fits, paper_plant, read_plant
from design.models.plant_set import limit_notes, loop_models
from design.models.sampling import Sampling, to_z
from hil.core.documents import to_json
from hil.core.errors import DocumentError

PERIOD_S = 0.0112


def text(**changes: object) -> str:
    document = json.loads(to_json(paper_plant()))
    document.update(changes)
    return json.dumps(document)


def plant(**changes: Any) -> Plant:
    return msgspec.structs.replace(paper_plant(), **changes)


def test_the_paper_plant_is_equation_15() -> None:
    G = paper_plant().transfer_function()
    np.testing.assert_allclose(G.num, 0.47947 * np.array([1.0, 90.76]), rtol=1e-12)
    np.testing.assert_allclose(G.den, np.polymul([1.0, 0.4231], [1.0, 16.97, 167.9]), rtol=1e-12)
    assert paper_plant().sample_time_s == 0.0112
    assert paper_plant().dead_time_s == paper_plant().contains_delay_samples == 0


def test_a_plant_document_is_read_back_as_it_was_written() -> None:
    assert read_plant(to_json(paper_plant()), "p.json") == paper_plant()
    assert "dead_time_s" not in to_json(paper_plant()), "only what differs from the default is written"


IDENTIFIED: dict[str, Any] = {
    "dead_time_s": 0.017,
    "contains_delay_samples": 1,
    "discrete": {"num": [0.1, 0.05], "den": [1.0, -1.9, 0.905], "sample_time_s": 0.0112},
    "covariance": {"parameters": ["gain", "pole"], "matrix": [[4e-4, 1e-5], [1e-5, 0.01]]},
    "fit": {"estimation": 99.2, "validation": 98.7},
    "conditions": {"supply_kpa": 450, "payload_kg": 0.0, "controller": "ppid", "in_closed_loop": True},
    "recording": "0123456789abcdef" * 4,
    "warnings": ["the zero at 90.8 rad/s is uncertain by 34 %"],
}


def test_what_an_identification_adds_is_read_and_written() -> None:
    identified = read_plant(text(**IDENTIFIED), "p.json")
    assert identified.dead_time_s == 0.017
    assert identified.discrete is not None
    assert identified.discrete.den == [1.0, -1.9, 0.905]
    assert identified.covariance is not None
    assert identified.covariance.parameters == ["gain", "pole"]
    assert identified.fit["validation"] == 98.7
    assert identified.conditions["controller"] == "ppid"
    assert identified.warnings == ["the zero at 90.8 rad/s is uncertain by 34 %"]
    assert read_plant(to_json(identified), "p.json") == identified


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"num": [0.0, 0.0]}, "num: the plant's gain is 0"),
        ({"den": [0.0]}, "den: all coefficients are 0"),
        ({"num": [1.0, 0.0, 0.0, 0.0, 0.0]}, "num has degree 4, den 3: the model is improper"),
        ({"output_unit": "mm"}, "output_unit"),
        ({"sample_time_s": 0.0}, "sample_time_s"),
        ({"gain": 3.0}, "gain"),
        ({"num": [1.0, -2.0], "den": [1.0, 1.0, -6.0]}, "unstable pole at s = 2 is cancelled by a zero"),
        ({"num": [1.0, 0.0], "den": [1.0, 3.0, 0.0]}, "num and den share the root s = 0"),
        (
            {"num": [1.0, -0.2, 4.0], "den": [1.0, 2.8, 3.4, 12.0]},
            "unstable pole at s = 0.1 ± 1.997j is cancelled by a zero",
        ),
        ({"num": [1.0, 0.0, 9.0], "den": [1.0, 3.0, 9.0, 27.0]}, "pole at s = 0 ± 3j is cancelled"),
        ({"version": 2}, "version"),
        ({"den": [1.0] * 22}, "den: 22 coefficients are order 21; the largest order is 20"),
        ({"num": [1e300]}, "num[0]: 1e+300 is neither 0 nor between 1e-100 and 1e+100"),
        ({"den": [1.0, 2.0, 1e-200]}, "den[2]: 1e-200 is neither 0 nor between"),
        ({"dead_time_s": -0.01}, "dead_time_s"),
        ({"dead_time_s": 11.0}, "dead_time_s"),
        ({"contains_delay_samples": -1}, "contains_delay_samples"),
        ({"contains_delay_samples": 1.5}, "contains_delay_samples"),
        (
            {"contains_delay_samples": 1, "sample_time_s": None},
            "contains_delay_samples: 1 periods, but sample_time_s, the length of a period, is missing",
        ),
        (
            {"discrete": {"num": [1.0, 2.0, 3.0], "den": [1.0, -0.5], "sample_time_s": 0.01}},
            "discrete: num has degree 2, den 1: the model is improper",
        ),
        (
            {"discrete": {"num": [1.0], "den": [0.0, 0.0], "sample_time_s": 0.01}},
            "discrete: den: all coefficients are 0",
        ),
        ({"discrete": {"num": [1.0], "den": [1.0]}}, "sample_time_s"),
        ({"fit": {"validation": 101.0}}, "fit.validation: 101 % is over 100 %"),
        ({"recording": "run-7.mcap"}, "recording: 'run-7.mcap' is not a SHA-256"),
        (
            {"covariance": {"parameters": ["a", "a"], "matrix": [[1.0, 0.0], [0.0, 1.0]]}},
            "covariance.parameters: give the name of each parameter once",
        ),
        (
            {"covariance": {"parameters": ["a", "b"], "matrix": [[1.0, 0.0]]}},
            "covariance.matrix: it must have 2 rows of 2 numbers",
        ),
        (
            {"covariance": {"parameters": ["a", "b"], "matrix": [[1.0, 0.2], [0.1, 1.0]]}},
            "covariance.matrix: it is not symmetric",
        ),
        (
            {"covariance": {"parameters": ["a", "b"], "matrix": [[1e-6, 2.0], [2.0, 1e6]]}},
            "covariance.matrix: it has a negative eigenvalue",
        ),
        (
            {"covariance": {"parameters": ["a"], "matrix": [[-1.0]]}},
            "covariance.matrix: it has a negative eigenvalue",
        ),
    ],
)
def test_refused(changes: dict[str, object], named: str) -> None:
    with pytest.raises(DocumentError, match=r"^p\.json: ") as refusal:
        read_plant(text(**changes), "p.json")
    assert named in str(refusal.value)


def test_a_covariance_of_rank_one_and_of_very_different_sizes_is_accepted() -> None:
    for matrix in ([[1.0, 2.0], [2.0, 4.0]], [[1e-12, 1e-4], [1e-4, 1e6]], [[0.0, 0.0], [0.0, 1.0]]):
        read_plant(text(covariance={"parameters": ["a", "b"], "matrix": matrix}), "p.json")


def test_leading_zeros_do_not_make_a_plant_improper() -> None:
    zeros = read_plant(text(num=[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), "p.json")
    assert zeros.transfer_function().num.tolist() == [1.0]


def test_the_unit_must_be_that_of_the_axis() -> None:
    check_plant_fits(paper_plant(), "p.json", "m")
    with pytest.raises(DocumentError, match=r"p\.json: output_unit: m, but the axis is in rad"):
        check_plant_fits(paper_plant(), "p.json", "rad")


def test_a_plant_is_frozen() -> None:
    with pytest.raises(AttributeError):
        paper_plant().name = "other"  # type: ignore[misc]
    assert isinstance(paper_plant(), Plant)


def first_motion(which: Plant, sampling: Sampling) -> int:
    """Return the sample at which the output begins to move after a step of u at sample 0."""
    num, den = to_z(which.transfer_function(sampling), sampling.period_s)
    return len(den) - len(np.trim_zeros(np.where(np.abs(num) < 1e-12 * np.abs(num).max(), 0.0, num), "f"))


@pytest.mark.parametrize(
    ("dead_time_s", "contained", "delay_samples", "moves_at"),
    [
        (0.0, 0, 0, 1),
        (0.0, 0, 1, 2),  # the paper's convention: the loop's delay is added
        (0.0112, 1, 1, 2),  # identified through the rig: the loop's delay is in the dead time already
        (0.0112, 1, 0, 1),
        (0.0224, 1, 1, 3),  # one period of the rig, and one of the plant itself
        (0.0224, 0, 1, 4),
        (0.0112, 1, 3, 4),
    ],
)
def test_the_transport_delay_counts_once(
    dead_time_s: float, contained: int, delay_samples: int, moves_at: int
) -> None:
    identified = plant(dead_time_s=dead_time_s, contains_delay_samples=contained)
    assert first_motion(identified, Sampling(PERIOD_S, delay_samples)) == moves_at


def test_delay_contained_in_num_and_den_counts_once() -> None:
    """A model without dead time whose poles hold the rig's period of delay needs no further period."""
    identified = plant(contains_delay_samples=1)
    there = identified.transfer_function(Sampling(PERIOD_S, 1))
    expected = paper_plant().transfer_function(Sampling(PERIOD_S, 0))
    assert [p.tolist() for p in there] == [p.tolist() for p in expected]
    more = identified.transfer_function(Sampling(PERIOD_S, 3))
    assert len(more.den) == len(expected.den) + 2


def test_contained_delay_is_in_periods_of_the_record() -> None:
    """Identified at 11.2 ms, designed at 5.6 ms: 16.8 ms of the plant itself are three of these periods."""
    identified = plant(dead_time_s=0.028, contains_delay_samples=1)
    assert identified.own_dead_time_s == pytest.approx(0.0168)
    assert identified.loop_delay_s(Sampling(0.0056, 2)) == pytest.approx(0.028)
    assert first_motion(identified, Sampling(0.0056, 2)) == 1 + 3 + 2


def test_a_loop_with_less_delay_than_the_model_contains_is_refused() -> None:
    identified = plant(contains_delay_samples=1)
    with pytest.raises(
        DesignError, match=r"plant paper: contains_delay_samples: its model contains 1 periods of 0.0112 s"
    ):
        identified.transfer_function(Sampling(PERIOD_S, 0))
    with pytest.raises(DesignError, match=r"this loop has only 0\.0056 s"):
        loop_models([paper_plant(), identified], Sampling(0.0056, 1))


def test_a_continuous_loop_cannot_represent_a_dead_time() -> None:
    with pytest.raises(DesignError, match=r"dead_time_s: the plant has a dead time of 0.006 s, .*sampled"):
        plant(dead_time_s=0.006).transfer_function()
    with pytest.raises(DesignError, match=r"num and den contain a part of the rig's transport delay"):
        plant(contains_delay_samples=1).transfer_function()
    only_of_the_rig = plant(dead_time_s=0.0112, contains_delay_samples=1)
    assert only_of_the_rig.is_rational
    for used, given in zip(only_of_the_rig.transfer_function(), only_of_the_rig.rational_part, strict=True):
        assert used.tolist() == given.tolist()


def test_a_dead_time_of_too_many_periods_is_refused_by_name() -> None:
    with pytest.raises(DesignError, match=r"plant paper: the loop's delay, 0\.5112 s, is 45\.6 periods"):
        plant(dead_time_s=0.5).transfer_function(Sampling(PERIOD_S, 1))


def test_a_record_shows_the_delays_that_the_model_contains() -> None:
    identified = plant(dead_time_s=0.0168, contains_delay_samples=1)
    model, loop = identified.record_model(PERIOD_S), identified.transfer_function(Sampling(PERIOD_S, 1))
    assert [p.tolist() for p in model] == [p.tolist() for p in loop]


@pytest.mark.parametrize("dead_time_s", [0.004, 0.0112, 0.03])
def test_the_step_response_of_a_loop_with_dead_time_is_the_simulated_one(dead_time_s: float) -> None:
    """The reference simulates plant, delay line and law in 112 exact steps for each period."""
    sampling, substeps = Sampling(PERIOD_S, 1), 112
    identified = plant(dead_time_s=dead_time_s)
    K = one_degree_of_freedom(np.array([[6.0, 2.5]]), np.array([[1.0, 0.0]]))
    loops = ClosedLoops(identified.transfer_function(sampling), K, sampling=sampling)
    response = loops.response(2.0)
    states = scipy.signal.tf2ss(identified.num, identified.den)
    A, B, C, _, _ = scipy.signal.cont2discrete(states, PERIOD_S / substeps)
    count = len(response.time_s) * substeps
    late = round(dead_time_s / PERIOD_S * substeps) + substeps * sampling.delay_samples
    x, u, y = np.zeros((3, 1)), np.zeros(count + late), np.zeros(count)
    integral = previous_error = 0.0
    for k in range(count):
        y[k] = (C @ x)[0, 0]
        if k % substeps == 0:
            error = 1.0 - y[k]
            integral += 2.5 * 0.5 * PERIOD_S * (error + previous_error)
            previous_error = error
            u[k + late : k + late + substeps] = 6.0 * error + integral
        x = A @ x + B * u[k]
    np.testing.assert_allclose(y[::substeps], response.y[0], atol=1e-9)


def test_dead_time_is_part_of_what_limits_a_plant() -> None:
    slow = plant(dead_time_s=0.2)
    note = limit_notes(slow, Sampling(PERIOD_S, 1), 4.0)
    assert "the loop's hold and delay, 0.217 s, allow no crossover over 4.61 rad/s" in note
    assert limit_notes(paper_plant(), Sampling(PERIOD_S, 1), 4.0) == ""


def test_reading_a_plant_imports_neither_the_gateway_nor_slow_libraries() -> None:
    program = (
        "import sys\n"
        "from design.models.plant import read_plant\n"
        "plant = read_plant(sys.stdin.read(), 'p.json')\n"
        "heavy = ('hil.core.gateway', 'hil.recording', 'scipy', 'control', 'matplotlib', 'rich')\n"
        "print([name for name in sys.modules if name.startswith(heavy)])\n"
        "print([name for name in sys.modules if name.startswith('hil.')])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], input=text(), capture_output=True, text=True, check=True
    )
    heavy, ours = done.stdout.splitlines()
    assert heavy == "[]"
    loaded = ast.literal_eval(ours)
    assert "hil.core.documents" in loaded
    allowed = ("hil.core.errors", "hil.core.document", "hil.core.suggestions")
    assert [name for name in loaded if name != "hil.core" and not name.startswith(allowed)] == []
