"""Run one mutant in a process of its own, and some of them at once."""

from __future__ import annotations

import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from enum import StrEnum
from typing import NamedTuple

from mutants.operators import Mutant

KILLED_STATUS, SURVIVED_STATUS, BROKEN_STATUS = 0, 1, 2
MAX_MEMORY = 4 << 30
MAX_WALL_S = 300
"""Time after which a trial that waits for something is ended by a signal."""


class Verdict(StrEnum):
    """What became of a mutant."""

    KILLED = "killed"
    TIMED_OUT = "timed out"
    """It runs for much longer than the original, so it counts as killed."""
    SURVIVED = "survived"
    UNREACHED = "unreached"
    """No test runs the changed line. It counts as survived."""
    BROKEN = "broken"
    """The trial itself has failed, so that nothing is known. It counts as survived."""


class Trial(NamedTuple):
    """A mutant and its verdict."""

    mutant: Mutant
    verdict: Verdict


def run_trials(
    mutants: Iterable[Mutant], survives: Callable[[Mutant], bool], workers: int, until_s: float
) -> Iterator[Trial]:
    """Run each mutant in a forked process, ``workers`` at once, and yield the verdicts as they come.

    ``survives`` is called in the forked process and returns whether all tests pass. No trial begins after the
    monotonic time ``until_s``.
    """
    waiting = iter(mutants)
    running: dict[int, Mutant] = {}
    while True:
        while len(running) < workers and time.monotonic() < until_s:
            mutant = next(waiting, None)
            if mutant is None:
                break
            running[_fork(mutant, survives)] = mutant
        if not running:
            return
        pid, status = os.wait()
        mutant = running.pop(pid)
        yield Trial(mutant, _verdict(status))


def limit_processor_time(seconds: float) -> None:
    """End this process when it has used so much more processor time, rounded up to seconds."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    limit = int(used.ru_utime + used.ru_stime + seconds) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))


def _fork(mutant: Mutant, survives: Callable[[Mutant], bool]) -> int:
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid:
        return pid
    status = BROKEN_STATUS
    try:
        nowhere = os.open(os.devnull, os.O_RDWR)
        for descriptor in (1, 2):
            os.dup2(nowhere, descriptor)
        signal.alarm(MAX_WALL_S)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, MAX_MEMORY))
        status = SURVIVED_STATUS if survives(mutant) else KILLED_STATUS
    finally:
        os._exit(status)


def _verdict(status: int) -> Verdict:
    if os.WIFSIGNALED(status):
        return Verdict.TIMED_OUT if os.WTERMSIG(status) == signal.SIGXCPU else Verdict.KILLED
    verdicts = {KILLED_STATUS: Verdict.KILLED, SURVIVED_STATUS: Verdict.SURVIVED}
    return verdicts.get(os.WEXITSTATUS(status), Verdict.BROKEN)
