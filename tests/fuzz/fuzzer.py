"""The search: keep each sequence that reaches something new, and change the kept ones at random."""

from __future__ import annotations

import time
from dataclasses import dataclass
from random import Random

from support import branch_counters

from fuzz.broken_rule import BrokenRule
from fuzz.checker import STATES
from fuzz.played_rig import PlayedRig
from fuzz.steps import Sequence, changed, draw_sequence

NEW_SHARE = 0.05
"""Share of the sequences that are drawn anew."""
RECENT = 40
"""Number of the last kept sequences that are changed as often as all others together."""


@dataclass
class Failure:
    """A sequence that broke a rule, or made the gateway raise an exception."""

    sequence: Sequence
    rule: str
    text: str


@dataclass
class Result:
    """What a search has done."""

    inputs: int = 0
    """Number of calls of the gateway."""
    sequences: int = 0
    kept: int = 0
    open_commands: int = 0
    """Number of commands that opened a valve."""
    branches_by_state: int = 0
    """Number of pairs of a state and a branch that was taken in it."""
    branches: int = 0
    seconds: float = 0.0
    failure: Failure | None = None


def run_sequence(sequence: Sequence) -> Failure | None:
    """Run one sequence and return how it fails, or None."""
    try:
        rig = PlayedRig(sequence.rig, sequence.law, sequence.setpoint)
        for step in sequence.steps:
            rig.take(step)
    except BrokenRule as broken:
        return Failure(sequence, broken.rule, str(broken))
    except Exception as error:
        return Failure(sequence, f"exception {type(error).__name__}", f"{type(error).__name__}: {error}")
    return None


def search(inputs: int, seed: int) -> Result:
    """Search with at least so many calls of the gateway, or until a rule is broken.

    The same number and seed give the same search.
    """
    return _Search(seed).run(inputs)


class _Search:
    def __init__(self, seed: int) -> None:
        self._random = Random(seed)
        self._kept: list[Sequence] = []
        self._seen = dict.fromkeys(STATES, 0)
        """Branches that were taken, as bits, by the state in which the step began."""
        self._result = Result()

    def run(self, inputs: int) -> Result:
        began = time.perf_counter()
        result = self._result
        while result.inputs < inputs and result.failure is None:
            self._run(self._next())
        result.kept = len(self._kept)
        result.branches_by_state = sum(bits.bit_count() for bits in self._seen.values())
        together = 0
        for bits in self._seen.values():
            together |= bits
        result.branches = together.bit_count()
        result.seconds = time.perf_counter() - began
        return result

    def _next(self) -> Sequence:
        random = self._random
        if not self._kept or random.random() < NEW_SHARE:
            return draw_sequence(random)
        kept = self._kept[-RECENT:] if random.random() < 0.5 else self._kept
        return changed(random.choice(kept), random.choice(self._kept), random)

    def _run(self, sequence: Sequence) -> None:
        result = self._result
        rig = PlayedRig(sequence.rig, sequence.law, sequence.setpoint)
        is_new = False
        branch_counters.take_branches()
        try:
            for step in sequence.steps:
                state = rig.state
                rig.take(step)
                is_new = self._see(state) or is_new
        except Exception:
            result.failure = run_sequence(sequence)
            assert result.failure is not None, "a sequence must fail again when it is run again"
        result.inputs += rig.inputs
        result.sequences += 1
        result.open_commands += rig.checker.open_commands
        if is_new:
            self._kept.append(sequence)

    def _see(self, state: str) -> bool:
        """Return whether a branch was taken in ``state`` for the first time."""
        taken = branch_counters.take_branches()
        new = taken & ~self._seen[state]
        if new:
            self._seen[state] |= new
        return new != 0
