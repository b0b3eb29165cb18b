"""Shorten a sequence that fails, so that a person can read it."""

from __future__ import annotations

from fuzz.fuzzer import Failure, run_sequence
from fuzz.played_rig import Step

SIMPLE: dict[type, tuple[object, ...]] = {int: (0, 1), float: (0.5,), str: ()}
"""Values that are tried in place of an argument, simplest first."""


def minimise(failure: Failure) -> Failure:
    """Return the shortest sequence found that breaks the same rule."""
    best = failure
    is_better = True
    while is_better:
        shorter = _simplify(_remove_steps(best))
        is_better = shorter.sequence != best.sequence
        best = shorter
    return best


def _remove_steps(failure: Failure) -> Failure:
    """Remove groups of steps: halves first, single steps at the end (delta debugging, Zeller 1999)."""
    size = max(len(failure.sequence.steps) // 2, 1)
    while size:
        at = 0
        while at < len(failure.sequence.steps):
            steps = failure.sequence.steps
            shorter = _fails_with(failure, [*steps[:at], *steps[at + size :]])
            if shorter is None:
                at += size
            else:
                failure = shorter
        size //= 2
    return failure


def _simplify(failure: Failure) -> Failure:
    """Replace arguments by simple values."""
    for number in range(len(failure.sequence.steps)):
        for place in range(1, len(failure.sequence.steps[number])):
            for simple in _simpler(failure.sequence.steps[number][place]):
                steps = [list(step) for step in failure.sequence.steps]
                steps[number][place] = simple
                simpler = _fails_with(failure, steps)
                if simpler is not None:
                    failure = simpler
                    break
    return failure


def _simpler(argument: object) -> list[object]:
    if isinstance(argument, list):
        zeros: list[object] = [[0] * len(argument)]
        singles: list[object] = [
            [value if place == kept else 0 for place, value in enumerate(argument)]
            for kept in range(len(argument))
        ]
        found = zeros + singles
    else:
        found = list(SIMPLE[type(argument)])
    return found[: found.index(argument)] if argument in found else found


def _fails_with(failure: Failure, steps: list[Step]) -> Failure | None:
    again = run_sequence(failure.sequence._replace(steps=steps)) if steps else None
    return again if again is not None and again.rule == failure.rule else None
