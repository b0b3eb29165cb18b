"""``python -m mutants``: change the safety path in small ways, and list the changes that no test notices."""

from __future__ import annotations

import argparse
import os
import pickle
import sys
import time
from pathlib import Path
from random import Random
from typing import Any

import numpy as np  # noqa: F401  # imported once, before any process is forked
import pytest
from hypothesis import Phase, settings
from support import branch_counters

from mutants.function_trials import FunctionTrials
from mutants.module_trials import OPTIONS, run_module_trials
from mutants.operators import Mutant, mutants_of
from mutants.report import Equivalents, Report, lines_of, make_report
from mutants.safety_path import MODULES, NOT_RUN
from mutants.trial import Trial

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests/unit/hil/core"
REPORT = Path("build/mutants.json")
PROFILE = "without shrinking"


def main() -> int:
    """Run the trials. Return 0 if no mutant survives, 1 if one does, 2 if a test fails without any change."""
    arguments = _arguments()
    mutants = _chosen(arguments)
    until_s = time.monotonic() + arguments.seconds
    settings.register_profile(
        PROFILE, derandomize=True, deadline=None, phases=(Phase.explicit, Phase.generate)
    )
    os.environ["HYPOTHESIS_PROFILE"] = PROFILE
    branch_counters.install()
    functions = [mutant for mutant in mutants if _is_inside_function(mutant)]
    trials, files, failures = _in_a_fork(functions, arguments.workers, until_s)
    if failures:
        sys.stdout.write(f"these tests fail without any change:\n{lines_of(failures)}")
        return 2
    others = [mutant for mutant in mutants if not _is_inside_function(mutant)]
    trials += run_module_trials(ROOT, others, files, arguments.workers, until_s)
    equivalents = Equivalents()
    report = make_report(trials, len(mutants), equivalents)
    report.write(REPORT)
    sys.stdout.write(f"{report.text()}\nreport: {REPORT}\n")
    _print_unused(arguments, report, equivalents)
    return 1 if report.survivors else 0


def _print_unused(arguments: argparse.Namespace, report: Report, equivalents: Equivalents) -> None:
    is_whole = arguments.sample is None and not report.left_over and not arguments.only
    if is_whole and equivalents.unused:
        sys.stdout.write(f"listed as equivalent, but killed or gone:\n{lines_of(equivalents.unused)}")


def _chosen(arguments: argparse.Namespace) -> list[Mutant]:
    paths = [path for path in MODULES if not arguments.only or Path(path).stem in arguments.only]
    mutants = [mutant for path in paths for mutant in mutants_of((ROOT / path).read_text(), path)]
    if arguments.sample is None or arguments.sample >= len(mutants):
        return mutants
    return Random(arguments.seed).sample(mutants, arguments.sample)


def _is_inside_function(mutant: Mutant) -> bool:
    return mutant.function.split(".")[-1][:1].islower() or mutant.function.split(".")[-1].startswith("_")


def _in_a_fork(
    mutants: list[Mutant], workers: int, until_s: float
) -> tuple[list[Trial], dict[str, list[str]], list[str]]:
    """Run the mutants of functions in a forked process. This one thus imports no module that may change."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(reading)
        result: Any = None
        try:
            plugin = FunctionTrials(ROOT, mutants, workers, until_s)
            files = [str(path) for path in sorted(TESTS.glob("test_*.py")) if path.name not in NOT_RUN]
            sys.stdout.flush()
            console = os.dup(1)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            pytest.main([*OPTIONS, *files], plugins=[plugin])
            os.dup2(console, 1)
            result = plugin.trials, plugin.files_by_module(), plugin.baseline_failures
        finally:
            with os.fdopen(writing, "wb") as pipe:
                pickle.dump(result, pipe)
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        found = pickle.load(pipe)
    os.waitpid(pid, 0)
    return found  # type: ignore[no-any-return]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m mutants", description=__doc__)
    parser.add_argument(
        "--sample", type=int, help="try so many mutants of the examined modules, drawn at random"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample")
    parser.add_argument("--seconds", type=float, default=86_400.0, help="begin no trial after so much time")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", nargs="+", default=[], metavar="MODULE", help="names of modules")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
