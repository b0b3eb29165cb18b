"""Computed results from which the paper's figures and statements are checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from design.closed_loop.comparison import Candidate, Measures, Problem
from design.closed_loop.specifications import Reading
from design.models.plant import Plant
from design.paper.searches import PaperSearches
from design.synthesis.fixed_structure import Synthesis
from design.synthesis.weight_selection import WeightSelection


@dataclass(frozen=True)
class Evidence:
    """Computed results from which every claim is checked."""

    plant: Plant
    """Plant of eq. (15)."""
    problem: Problem
    """Continuous loop with the weight of eq. (16)."""
    weight_readings: Sequence[Reading]
    """Specifications of eq. (9), read off the loop that selects the weight, with the weight of eq. (16)."""
    searches: PaperSearches
    """Genetic and random searches of the paper's size on many seeds."""
    best_weight: WeightSelection
    """Optimum of eq. (8)."""
    optimum: Synthesis
    """Optimum of eq. (13) for a PID."""
    candidates: Mapping[str, Candidate]
    """Controllers by name: "PPID (20)", "HLS (18)", "ZN", "TLC" and others."""
    measures: Mapping[str, Measures]
    """Measures of each candidate, by the same names."""
