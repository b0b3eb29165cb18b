"""Assessments: how a search ranks stable, unstable and failing candidates."""

from __future__ import annotations

import numpy as np
import pytest
from support.paper_loop import BEST_PID, G0, PPID, W1

from design.closed_loop.assessment import Assessment, assess, worst
from design.closed_loop.loops import ClosedLoops
from design.closed_loop.specifications import MAX_VIOLATION, PAPER, QUANTITIES, Specification, violations
from design.models.controller import Controller
from design.models.transfer_function import TransferFunction
from design.synthesis.structures import STRUCTURES

UNSTABLE, SLOW, MORE_UNSTABLE = [500.0, 5.0], [0.01, 0.01], [5000.0, 5.0]


def assessed(
    K: Controller,
    specifications: tuple[Specification, ...] = (),
    cutoff: np.ndarray | None = None,
    G: TransferFunction = G0,
) -> Assessment:
    loops = ClosedLoops(G, K, W=W1)
    return assess(loops, loops.margin, loops.stable, specifications, cutoff)


def test_an_unstable_loop_ranks_below_any_violation() -> None:
    found = assessed(STRUCTURES["pi"].controller(np.array([UNSTABLE, SLOW])), PAPER)
    assert found.stable.tolist() == [False, True]
    unstable, slow = found.fitness
    assert unstable < -len(QUANTITIES) * MAX_VIOLATION < slow < 0.0


def test_unstable_loops_rank_by_their_growth() -> None:
    K = STRUCTURES["pi"].controller(np.array([UNSTABLE, MORE_UNSTABLE, SLOW]))
    found = assessed(K)
    fastest = [np.roots(closed).real.max() for closed in ClosedLoops(G0, K).closed]
    np.testing.assert_allclose(found.growth, [*fastest[:2], 0.0])
    assert found.fitness[1] < found.fitness[0] < found.fitness[2]


def test_a_loop_that_meets_everything_ranks_by_its_margin() -> None:
    K = STRUCTURES["pid"].controller(np.array([PPID, BEST_PID]))
    limits = (Specification("overshoot", 0.1), Specification("settling_s", 1.2))
    found = assessed(K, limits)
    np.testing.assert_allclose(found.fitness, found.margin)
    assert found.fitness[0] == pytest.approx(0.54774, abs=1e-5)
    tight = assessed(K, (Specification("settling_s", 0.5),))
    np.testing.assert_allclose(tight.fitness, -tight.violation)
    assert (tight.violation > 0.5).all()


@pytest.mark.parametrize("cutoff", [-1e5, -50.0, -1.0, 1e-9, 0.3, 0.56, 0.7])
def test_a_cutoff_changes_no_fitness_above_it(cutoff: float) -> None:
    random = np.random.default_rng(4)
    values = np.array(BEST_PID) * 10.0 ** random.uniform(-1.0, 1.0, size=(60, 4))
    K = STRUCTURES["pid"].controller(values)
    exact, quick = assessed(K, PAPER), assessed(K, PAPER, np.full(len(values), cutoff))
    is_above = exact.fitness >= cutoff
    np.testing.assert_array_equal(quick.fitness[is_above], exact.fitness[is_above])
    assert (quick.fitness[~is_above] < cutoff).all()


def test_over_several_plants_each_candidate_has_its_worst_assessment() -> None:
    K = STRUCTURES["pid"].controller(np.array([PPID, BEST_PID, (0.3, 0.01, 0.01, 0.1)]))
    louder = TransferFunction(8.0 * G0.num, G0.den)
    limits = (Specification("settling_s", 1.2),)
    both = [assessed(K, limits), assessed(K, limits, G=louder)]
    together = worst(both)
    np.testing.assert_array_equal(together.fitness, np.minimum(*(one.fitness for one in both)))
    chosen = np.argmin([one.fitness for one in both], axis=0)
    assert set(chosen) == {0, 1}
    for field, parts in zip(together._fields, zip(*both, strict=True), strict=True):
        np.testing.assert_array_equal(getattr(together, field), np.choose(chosen, parts), err_msg=field)


def test_violations_beyond_their_cutoff_need_no_step_response() -> None:
    loops = ClosedLoops(G0, STRUCTURES["pid"].controller(np.array([PPID, BEST_PID])), W=W1)
    limits = (Specification("bandwidth_rad_s", 400.0), Specification("settling_s", 0.1))
    without = violations(limits[:1], loops)
    np.testing.assert_array_equal(violations(limits, loops, np.full(2, 0.5)), without)
    assert (violations(limits, loops) > without).all()
