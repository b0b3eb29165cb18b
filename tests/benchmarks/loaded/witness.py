"""A witness beside a run: when each processor stalled, and what the kernel did with the run's processes.

    python -m loaded.witness FILE PID PROCESSOR

On each processor, a process sleeps for 2 ms again and again, at a higher priority than any loop of this
product. If it is late, the host or the kernel ran nothing on that processor. The first one also reads, every
4 ms, the scheduler's figures of the processes below process PID. All is written to FILE after SIGTERM, as
JSON.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from hil.host.realtime_rights import FIFO_PRIORITY, real_time_rights

SLEEP_NS = 2_000_000
LATE_NS = 1_000_000
"""A witness that is later than this has seen its processor stall."""
READ_EVERY = 2
"""The scheduler's figures are read after so many sleeps."""
SEARCH_EVERY = 125
"""New processes are looked for after so many sleeps."""
ROLES = {
    "boards": b"firmware_sim",
    "recorder": b"recorder_process",
    "guest": b"linux.uml",
    "loop": b"hil.cli\0run",
}
"""Part of the command line of each process that is observed."""


_COMMAND = [sys.executable, "-m", "loaded.witness"]


class Observed:
    """A process, and its figures whenever they have changed."""

    def __init__(self, role: str, pid: int) -> None:
        self.role = role
        self._pid = pid
        self._before: tuple[int, int, str] = (0, 0, "")
        self.changes: list[tuple[int, int, int, str]] = []
        """Time (epoch ns), ns that it waited for a processor, major page faults, and state, such as D."""

    def read(self, now_ns: int) -> None:
        try:
            waited_ns = int(Path(f"/proc/{self._pid}/schedstat").read_text().split()[1])
            fields = Path(f"/proc/{self._pid}/stat").read_text().rsplit(")", 1)[1].split()
        except OSError:
            return
        now = (waited_ns, int(fields[9]), fields[0])
        if now != self._before:
            self._before = now
            self.changes.append((now_ns, *now))


def below(pid: int) -> Iterator[int]:
    """Yield a process and all its descendants."""
    yield pid
    with contextlib.suppress(OSError):
        for thread in Path(f"/proc/{pid}/task").iterdir():
            for child in (thread / "children").read_text().split():
                yield from below(int(child))


def search(root: int, observed: dict[int, Observed]) -> None:
    """Add new processes that have a role. Of a guest, that is the process of its kernel."""
    for pid in below(root):
        if pid in observed:
            continue
        with contextlib.suppress(OSError):
            command = Path(f"/proc/{pid}/cmdline").read_bytes()
            role = next((role for role, part in ROLES.items() if part in command), None)
            if role is not None and not (
                role == "guest" and any(o.role == "guest" for o in observed.values())
            ):
                observed[pid] = Observed(role, pid)


def main(path: Path, root: int, processor: int) -> None:
    stalls: list[tuple[int, int]] = []
    observed: dict[int, Observed] = {}
    is_over: list[bool] = []
    signal.signal(signal.SIGTERM, lambda *_: is_over.append(True))
    os.sched_setaffinity(0, {processor})
    with real_time_rights():
        os.sched_setaffinity(0, {processor})
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY + 1))
        print("ready", flush=True)
        number, starter = 0, os.getppid()
        while not is_over and os.getppid() == starter:  # nothing of this priority may be left behind
            due_ns = time.time_ns() + SLEEP_NS
            time.sleep(SLEEP_NS * 1e-9)
            woke_ns = time.time_ns()
            if woke_ns - due_ns > LATE_NS:
                stalls.append((due_ns, woke_ns))
            if root:
                if number % SEARCH_EVERY == 0:
                    search(root, observed)
                elif number % READ_EVERY == 0:
                    for process in observed.values():
                        process.read(woke_ns)
            number += 1
    roles = [(process.role, process.changes) for process in observed.values()]
    path.write_text(json.dumps({"stalls": stalls, "processes": roles}))


class Evidence(NamedTuple):
    """What the witness saw. Times are epoch ns."""

    stalls: list[tuple[int, int]]
    """Intervals in which a processor ran nothing of this machine, or nothing but the kernel."""
    processes: list[tuple[str, list[tuple[int, int, int, str]]]]
    """Role of each process, and its figures (:class:`Observed`) whenever they have changed."""


class Witness:
    """Observes the processes below ``root`` from now on."""

    def __init__(self, root: int) -> None:
        self._folder = tempfile.TemporaryDirectory()
        processors = sorted(os.sched_getaffinity(0))
        self._started = [
            subprocess.Popen(
                # The figures are read on the first processor. The loop runs on the last one.
                [*_COMMAND, self._path(place), str(root if place == 0 else 0), str(processor)],
                stdout=subprocess.PIPE,
                cwd=Path(__file__).parent.parent,
            )
            for place, processor in enumerate(processors)
        ]
        for process in self._started:
            assert process.stdout is not None
            process.stdout.readline()

    def finish(self) -> Evidence:
        """End the observation."""
        stalls, processes = [], []
        for place, process in enumerate(self._started):
            process.terminate()
            process.wait()
            seen = json.loads(Path(self._path(place)).read_text())
            stalls += [(due, woke) for due, woke in seen["stalls"]]
            processes += [(role, [tuple(one) for one in changes]) for role, changes in seen["processes"]]
        self._folder.cleanup()
        return Evidence(stalls, processes)

    def _path(self, place: int) -> str:
        return f"{self._folder.name}/{place}.json"


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
