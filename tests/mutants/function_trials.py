"""Trials of the mutants of function bodies, in a process that has collected the tests once.

The tests run once on the original, which says which test reaches which branch, and how long it takes. Then a
process is forked for each mutant. It replaces the code of one function and runs the tests that reach the
changed line, the shortest first, until one fails.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Sequence
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest
from support import branch_counters

from mutants.operators import Mutant, mutated_tree
from mutants.trial import Trial, Verdict, limit_processor_time, run_trials

SLOWER = 20.0
"""A test on a mutant may take so many times as long as on the original."""
PATIENCE_S = 2.0
"""Processor time that each test may take in any case."""


class FunctionTrials:
    """A plugin of pytest that runs mutants in place of the collected tests."""

    def __init__(self, root: Path, mutants: Sequence[Mutant], workers: int, until_s: float) -> None:
        self._root = root
        self._mutants = mutants
        self._workers = workers
        self._until_s = until_s
        self._items: list[pytest.Item] = []
        self._reached: dict[pytest.Item, int] = {}
        self._duration_s: dict[pytest.Item, float] = {}
        self._has_failed = False
        self.trials: list[Trial] = []
        self.baseline_failures: list[str] = []
        """Tests that fail on the original. There are no trials then."""

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run the trials."""
        self._items = list(session.items)
        for item in self._items:
            branch_counters.take_branches()
            self._duration_s[item] = 0.0
            if self._fails(item):
                self.baseline_failures.append(item.nodeid)
            self._reached[item] = branch_counters.take_branches()
        gc.collect()
        gc.freeze()  # so that the collector of a forked process copies no memory
        if not self.baseline_failures:
            reached = [mutant for mutant in self._mutants if self._tests(mutant)]
            for mutant in set(self._mutants) - set(reached):
                self.trials.append(Trial(mutant, Verdict.UNREACHED))
            for trial in run_trials(reached, self._survives, self._workers, self._until_s):
                self.trials.append(trial)
        return True

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take the result of a test."""
        self._has_failed = self._has_failed or report.failed
        self._last_s = getattr(self, "_last_s", 0.0) + report.duration

    def files_by_module(self) -> dict[str, list[str]]:
        """Return the test files that reach each module, by its path, those with the most tests first."""
        files: dict[str, dict[str, int]] = {}
        for number, branch in enumerate(branch_counters.known):
            counts = files.setdefault(self._relative(branch.path), {})
            for item, reached in self._reached.items():
                if branch_counters.is_in(reached, number):
                    path = self._relative(str(item.path))
                    counts[path] = counts.get(path, 0) + 1
        return {path: sorted(counts, key=lambda file: -counts[file]) for path, counts in files.items()}

    def _fails(self, item: pytest.Item) -> bool:
        self._has_failed, self._last_s = False, 0.0
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)
        self._duration_s.setdefault(item, self._last_s)
        self._duration_s[item] = self._duration_s[item] or self._last_s
        return self._has_failed

    def _tests(self, mutant: Mutant) -> list[pytest.Item]:
        """Return the tests that reach a mutant, the shortest first, beginning with those of its own file."""
        branch = branch_counters.innermost(str(self._root / mutant.path), mutant.line)
        if branch is None:
            return []
        own = f"test_{Path(mutant.path).name}"
        reaching = [item for item in self._items if branch_counters.is_in(self._reached[item], branch)]
        return sorted(reaching, key=lambda item: (item.path.name != own, self._duration_s[item]))

    def _survives(self, mutant: Mutant) -> bool:
        _replace_code(self._root, mutant)
        for item in self._tests(mutant):
            limit_processor_time(PATIENCE_S + SLOWER * self._duration_s[item])
            if self._fails(item):
                return False
        return True

    def _relative(self, path: str) -> str:
        return str(Path(path).relative_to(self._root)) if path.startswith(str(self._root)) else path


def _replace_code(root: Path, mutant: Mutant) -> None:
    """Give the function of a mutant its changed code, wherever it is referred to."""
    path = root / mutant.path
    code = compile(mutated_tree(path.read_text(), mutant), str(path), "exec", dont_inherit=True)
    module = sys.modules[mutant.path.removesuffix(".py").replace("/", ".")]
    outer = mutant.function.split(".<locals>")[0]
    changed, function = _code_of(code, outer), _function(module, outer)
    if changed.co_freevars == function.__code__.co_freevars:
        function.__code__ = changed
        return
    # A method without its super() has no cell for the class, so that the code does not fit the function.
    *classes, last = outer.split(".")
    setattr(_holder(module, classes), last, FunctionType(changed, function.__globals__))


def _code_of(code: CodeType, name: str) -> CodeType:
    """Return the code of the function with this qualified name in the code of a module."""
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            if constant.co_qualname == name:
                return constant
            if name.startswith(f"{constant.co_qualname}."):
                return _code_of(constant, name)
    raise KeyError(name)


def _function(module: object, name: str) -> FunctionType:
    *classes, last = name.split(".")
    found: Any = vars(_holder(module, classes))[last]
    if isinstance(found, property):
        found = found.fget
    found = getattr(found, "__func__", found)
    assert isinstance(found, FunctionType), name
    return found


def _holder(module: object, classes: Sequence[str]) -> Any:
    """Return the class with this path of names in a module, or the module itself for an empty path."""
    for name in classes:
        module = getattr(module, name)
    return module
