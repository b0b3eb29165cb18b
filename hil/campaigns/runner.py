"""Runs the cases of a campaign in processes. The results come in the order of the cases."""

from __future__ import annotations

import os
import signal
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from typing import Final, TypeAlias

from hil.campaigns.campaign_file import case_count
from hil.campaigns.case import CaseResult, run_case
from hil.campaigns.prepared import PreparedCampaign
from hil.core.errors import HilError

_Group: TypeAlias = "Future[list[CaseResult]]"

CASES_AT_ONCE: Final = 8
"""Number of cases that a process is given at once."""
WAITING_PER_WORKER: Final = 4
"""Number of groups of cases that wait for each process, so that none is idle."""


def default_workers() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0))


def run_cases(prepared: PreparedCampaign, first: int, workers: int) -> Iterator[list[CaseResult]]:
    """Return the results of the cases from ``first`` on, in groups and in order.

    With one worker, the cases run in this process. Otherwise the processes begin at once. The iterator raises
    the HilError of a case that cannot run, and HilError if a process ends.
    """
    groups = groups_of(prepared, first)
    if workers == 1:
        return (run_group(prepared, start, stop) for start, stop in groups)
    pool = ProcessPoolExecutor(workers, initializer=_ignore_interrupt)
    submitted = (pool.submit(run_group, prepared, start, stop) for start, stop in groups)
    # All processes are forked here, before the caller shows progress in a thread.
    waiting = deque(islice(submitted, workers * WAITING_PER_WORKER))
    return _in_order(pool, waiting, submitted)


def _in_order(
    pool: ProcessPoolExecutor, waiting: deque[_Group], following: Iterator[_Group]
) -> Iterator[list[CaseResult]]:
    """Yield the results of ``waiting``; submit one of ``following`` for each."""
    with pool:
        try:
            while waiting:
                results = waiting.popleft().result()
                waiting.extend(islice(following, 1))
                yield results
        except BrokenProcessPool:
            raise HilError(
                "a process of the campaign ended, perhaps for lack of memory; run the same command again to "
                "go on after the last result"
            ) from None
        finally:
            for future in waiting:
                future.cancel()


def _ignore_interrupt() -> None:
    """Let Ctrl-C end the campaign's main process, which waits for the cases that have begun."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def run_group(prepared: PreparedCampaign, start: int, stop: int) -> list[CaseResult]:
    """Run the cases from ``start`` to before ``stop``."""
    return [run_case(prepared, number) for number in range(start, stop)]


def groups_of(prepared: PreparedCampaign, first: int) -> Iterator[tuple[int, int]]:
    """Yield the first case of each group, and the one after its last, from the case ``first`` on."""
    count = case_count(prepared.campaign)
    for start in range(first, count, CASES_AT_ONCE):
        yield start, min(start + CASES_AT_ONCE, count)
