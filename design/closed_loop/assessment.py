"""What a search has to know about a candidate, and the fitness by which it ranks candidates.

The fitness orders candidates so that a search finds its way from unstable loops to the best one:

1. a stable loop that meets its specifications has its margin as fitness, which is over 0;
2. a stable loop that violates specifications has minus the sum of its violations, which is below 0;
3. an unstable loop ranks below every stable one, and the lower, the faster it diverges.

So a stable loop of small margin never ranks below an unstable one, as it does in eqs. (8) and (14) of the
paper, where everything that fails has the fitness 0.01. The fitness serves for ranking only. Stability and
the other properties are read from the :class:`Assessment`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from design.closed_loop.loops import ClosedLoops
from design.closed_loop.specifications import Specification, violations
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array, Flags

_BELOW_STABLE = 1e4
"""Fitness below which unstable loops rank; more than all violations together can amount to."""
_MAX_GROWTH = 1e8
"""Growth in 1/s beyond which unstable loops rank alike."""


class Assessment(NamedTuple):
    """The properties of B candidates, each array (B,)."""

    margin: Array
    """The margin to be made as large as possible: ε, or ε_opt for a weight."""
    stable: Flags
    violation: Array
    """Sum of the relative violations of the specifications; 0 where all of them hold."""
    growth: Array
    """Largest real part of the closed-loop poles in 1/s where the loop is unstable, and 0 elsewhere."""

    @property
    def fitness(self) -> Array:
        """Rank (B,) of the candidates as a number: larger is better, and positive exactly if all is met."""
        ranked = np.where(self.violation > 0.0, -self.violation, self.margin)
        return np.where(self.stable, ranked, -_BELOW_STABLE - np.minimum(self.growth, _MAX_GROWTH))


def assess(
    loops: ClosedLoops,
    margin: Array,
    stable: Flags,
    specifications: Sequence[Specification],
    cutoff: Array | None = None,
) -> Assessment:
    """Return the assessment of B loops whose margins and stability are known.

    Where the fitness is below ``cutoff`` (B,), any lower fitness may result, which is faster.
    """
    growth = np.zeros(len(margin))
    unstable = np.flatnonzero(~stable)
    if len(unstable):
        growth[unstable] = poly.spectral_abscissa(loops.closed[unstable])
    violation = np.zeros(len(margin))
    if specifications:
        violation = violations(specifications, loops, _violation_cutoff(cutoff, margin))
    return Assessment(margin, stable, violation, growth)


def worst(assessments: Sequence[Assessment]) -> Assessment:
    """Return, for each candidate, the assessment of lowest fitness, of one for each of several plants."""
    result = assessments[0]
    for other in assessments[1:]:
        is_worse = other.fitness < result.fitness
        result = Assessment(*(np.where(is_worse, b, a) for a, b in zip(result, other, strict=True)))
    return result


def _violation_cutoff(cutoff: Array | None, margin: Array) -> Array | None:
    """Return the violation (B,) beyond which the fitness is below its cutoff.

    A cutoff over 0 requires that every specification holds, and that the margin reaches the cutoff.
    """
    if cutoff is None:
        return None
    return np.where(cutoff > 0.0, np.where(margin >= cutoff, 0.0, -1.0), -cutoff)
