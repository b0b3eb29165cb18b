"""Trials of the mutants of constants, tables and classes, for which the modules are imported anew.

Such a change acts when other modules are imported. The forked process has imported no module of this project,
so that it imports all of them with the change. It then runs the test files that reach the changed module.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pytest
from support import branch_counters

from mutants.operators import Mutant, mutated
from mutants.trial import Trial, Verdict, limit_processor_time, run_trials

OPTIONS = ["-q", "-x", "--assert=plain", "-p", "no:cacheprovider", "-p", "no:xdist"]
# Rewritten assertions would make the hook of pytest import the modules, and not that of branch_counters.
PATIENCE_S = 120.0
"""Processor time that the tests of one mutant may take."""
MAX_FILES = 12


def run_module_trials(
    root: Path,
    mutants: Sequence[Mutant],
    files_by_module: Mapping[str, Sequence[str]],
    workers: int,
    until_s: float,
) -> Iterator[Trial]:
    """Run the mutants and yield the verdicts. ``files_by_module`` are the test files that reach a module."""

    def files(mutant: Mutant) -> list[str]:
        own = f"test_{Path(mutant.path).name}"
        found = files_by_module.get(mutant.path, ())
        return sorted(found, key=lambda file: Path(file).name != own)[:MAX_FILES]

    def survives(mutant: Mutant) -> bool:
        path = root / mutant.path
        branch_counters.sources[str(path)] = mutated(path.read_text(), mutant).encode()
        limit_processor_time(PATIENCE_S)
        own, *others = [str(root / file) for file in files(mutant)]
        return pytest.main([*OPTIONS, own]) == 0 and pytest.main([*OPTIONS, *others]) == 0

    reached = [mutant for mutant in mutants if files(mutant)]
    for mutant in mutants:
        if mutant not in reached:
            yield Trial(mutant, Verdict.UNREACHED)
    yield from run_trials(reached, survives, workers, until_s)
