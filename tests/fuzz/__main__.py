"""``python -m fuzz``: search for calls of the gateway that break a rule, or run one sequence again."""

from __future__ import annotations

import argparse
import sys
from multiprocessing import get_context
from pathlib import Path

from support import branch_counters

branch_counters.install()  # before anything imports hil.core

from fuzz.fuzzer import Result, run_sequence, search  # noqa: E402
from fuzz.minimiser import minimise  # noqa: E402
from fuzz.sequence_file import read_sequence, write_failure  # noqa: E402

FAILURES = Path("build/fuzz")


def main() -> int:
    """Run the search on some processes. Return 0 if no rule was broken, else 1."""
    arguments = _arguments()
    if arguments.sequence is not None:
        return _run_again(arguments.sequence)
    share = -(-arguments.inputs // arguments.processes)
    seeds = [arguments.seed + number for number in range(arguments.processes)]
    with get_context("fork").Pool(arguments.processes) as pool:
        results = pool.starmap(_search_and_minimise, [(share, seed) for seed in seeds])
    _print_summary(results)
    failed = False
    for seed, result in zip(seeds, results, strict=True):
        if result.failure is not None:
            failed = True
            path = write_failure(result.failure, FAILURES, seed)
            number = len(result.failure.sequence.steps)
            sys.stdout.write(
                f"{result.failure.text}\n  {number} steps, in {path}; run them again with: "
                f"make fuzz SEQUENCE={path}\n"
            )
    return 1 if failed else 0


def _search_and_minimise(inputs: int, seed: int) -> Result:
    result = search(inputs, seed)
    if result.failure is not None:
        result.failure = minimise(result.failure)
    return result


def _run_again(path: Path) -> int:
    failure = run_sequence(read_sequence(path))
    sys.stdout.write(f"{path}: {'no rule is broken' if failure is None else failure.text}\n")
    return 0 if failure is None else 1


def _print_summary(results: list[Result]) -> None:
    inputs = sum(result.inputs for result in results)
    seconds = max(result.seconds for result in results)
    sequences, kept = (sum(counts) for counts in zip(*((r.sequences, r.kept) for r in results), strict=True))
    branches = max(result.branches for result in results)
    sys.stdout.write(
        f"{inputs} inputs in {sequences} sequences and {seconds:.1f} s ({inputs / seconds:.0f} inputs/s)\n"
        f"{sum(result.open_commands for result in results)} commands that open a valve\n"
        f"{branches} of {len(branch_counters.known)} branches of hil.core that were loaded, "
        f"{max(result.branches_by_state for result in results)} pairs of branch and state, "
        f"{kept} sequences kept for them\n"
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000_000, help="calls of the gateway")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--sequence", type=Path, help="run the sequence in this file instead")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
