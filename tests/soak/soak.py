"""Run the gateway for a long time, and check that no memory grows, no frame is lost and no period drifts.

    python tests/soak/soak.py                              # an hour of simulated time, ten minutes on vcan0
    python tests/soak/soak.py --lockstep-s 20 --real-time-s 20

Exit status 1: a limit was exceeded. Where the kernel has no vcan, the part in real time runs in user-mode
Linux, as ``hil vcan`` starts it. A duration of 0 leaves a part out.
"""

from __future__ import annotations

import argparse
import contextlib
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil.core.wire import codec
from hil.recording.reader import Recording

HIL = [sys.executable, "-m", "hil.cli"]
PERIOD_NS = 11_200_000
SIMULATED = "sim"
VCAN = "vcan0"
RECORDER = "hil.recording.recorder_process"
PAGE_BYTES = resource.getpagesize()
RSS_INTERVAL_S = 0.25
WARM_UP_SHARE = 0.5
"""Share of the time in which a process may still load code and fill its buffers."""
MAX_GROWTH_MB = 3.0
MAX_RECORDER_GROWTH_MB_H = 20.0
"""The recorder process keeps an index entry of each chunk until the end of the file: 1 kB each 0.5 s."""
MAX_DRIFT_PERIODS = 1.0
COUNTERS = ("lost samples", "frames dropped by the kernel", "frames not sent")
"""Entries of the metadata ``ending`` that must be 0. Lockstep has no link, and so no link's entries."""
MACHINE_COUNTERS = ("missed periods", "rejected frames")
"""Entries that must be 0 in lockstep. In real time, a busy machine makes periods and samples late."""


class Memory(NamedTuple):
    """Resident memory of one process while the gateway runs."""

    role: str
    resident_mb: list[float]

    @property
    def growth_mb(self) -> float:
        """Growth of the largest memory after the warm-up."""
        warm = self.resident_mb[int(WARM_UP_SHARE * len(self.resident_mb)) :]
        return max(warm) - warm[0]


class Checks:
    """Printed checks. ``failed`` counts those that exceeded their limit."""

    def __init__(self) -> None:
        self.failed = 0

    def limit(self, what: str, value: float, limit: float, unit: str = "") -> None:
        """Print a value beside its limit."""
        is_within = abs(value) <= limit
        self.failed += not is_within
        verdict = "within" if is_within else "EXCEEDS"
        print(f"  {verdict:8} {what}: {value:.4g} {unit}, limit {limit:g} {unit}".rstrip())


def children_of(process_id: int) -> Iterator[int]:
    """Yield a process and its descendants."""
    yield process_id
    with contextlib.suppress(OSError):
        for child in Path(f"/proc/{process_id}/task/{process_id}/children").read_text().split():
            yield from children_of(int(child))


def role_of(process_id: int) -> str:
    """Return what a process does: the module of its command line."""
    arguments = Path(f"/proc/{process_id}/cmdline").read_bytes().decode(errors="replace").split("\0")
    return arguments[arguments.index("-m") + 1] if "-m" in arguments else arguments[0]


def watch_memory(process: subprocess.Popen[bytes]) -> list[Memory]:
    """Wait for the end of a process. Return the memory of it and of its descendants.

    The gateway runs as long as its recorder process. After that, the command reads the recording and plots.
    """
    found: dict[int, Memory] = {}
    while process.poll() is None:
        present: dict[int, Memory] = {}
        for process_id in children_of(process.pid):
            with contextlib.suppress(OSError, IndexError):
                pages = int(Path(f"/proc/{process_id}/statm").read_text().split()[1])
                present[process_id] = Memory(role_of(process_id), [pages * PAGE_BYTES / 1e6])
        if any(memory.role == RECORDER for memory in present.values()):
            for process_id, memory in present.items():
                found.setdefault(process_id, Memory(memory.role, [])).resident_mb.extend(memory.resident_mb)
        time.sleep(RSS_INTERVAL_S)
    return list(found.values())


def check_memory(checks: Checks, memories: Sequence[Memory], run_s: float) -> None:
    """Check the growth of each process, for ``run_s`` seconds of the gateway's time."""
    for memory in memories:
        allowed_mb_h = MAX_RECORDER_GROWTH_MB_H if memory.role == RECORDER else 0.0
        limit_mb = MAX_GROWTH_MB + allowed_mb_h * run_s / 3600.0
        size_mb = max(memory.resident_mb)
        checks.limit(f"growth of {memory.role}, largest {size_mb:.0f} MB", memory.growth_mb, limit_mb, "MB")


def check_recording(checks: Checks, path: Path, run_s: float) -> None:
    """Check counters, dropped messages, and the periods against the clock that stamped the samples."""
    recording = Recording(path)
    ending = recording.metadata["ending"]
    checks.limit(f"the run ended as {ending['reason']}", float(ending["reason"] != "completed"), 0.0)
    for name in COUNTERS:
        if name in ending:
            checks.limit(name, float(ending[name]), 0.0)
    is_simulated = recording.metadata["recording"]["stamp_origin"] == "simulated"
    for name in MACHINE_COUNTERS:
        if is_simulated:
            checks.limit(name, float(ending[name]), 0.0)
        else:
            print(
                f"  {'counted':8} {name}: {ending[name]}; bench_loaded.py and bench_operation.py find causes"
            )
    dropped = [
        int(count) for key, count in recording.metadata["recorder"].items() if key.startswith("dropped")
    ]
    checks.limit("messages dropped by the recorder", float(sum(dropped)), 0.0)
    timing = recording.timing()
    expected = run_s * 1e9 / PERIOD_NS
    checks.limit(f"periods missing of {expected:.0f}", max(expected - len(timing), 0.0), 1.0)
    samples = recording.frames("received", codec.TPDO1_ADC)
    answered = timing[timing["fresh"]]
    place = np.searchsorted(samples.time_ns, answered["receive_ns"])
    elapsed_ns = samples.stamp_ns[place] - samples.stamp_ns[place[0]]
    counted_ns = (answered["number"] - answered["number"][0]) * PERIOD_NS
    drift_periods = (elapsed_ns - counted_ns) / PERIOD_NS
    checks.limit("drift of counted periods from the receive stamps", float(drift_periods[-100:].mean()),
                 MAX_DRIFT_PERIODS, "periods")  # fmt: skip


def soak(name: str, command: list[str], path: Path, run_s: float) -> int:
    """Run ``command``, which records into ``path``. Return the number of exceeded limits."""
    print(f"{name}, {run_s:g} s", flush=True)
    checks = Checks()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        memories = watch_memory(process)
        assert process.stderr is not None
        errors = process.stderr.read().decode(errors="replace")
    last_words = errors.strip().splitlines()[-1:] if process.returncode else ""
    checks.limit(f"exit status {last_words}".strip(), float(process.returncode), 0.0)
    check_memory(checks, memories, run_s)
    check_recording(checks, path, run_s)
    return checks.failed


def soak_lockstep(folder: Path, duration_s: float) -> int:
    """Run in simulated time."""
    path = folder / "lockstep.mcap"
    command = [*HIL, "run", "--lockstep", "--duration", str(duration_s), "--record", str(path)]
    return soak("lockstep", command, path, duration_s)


def soak_real_time(folder: Path, duration_s: float, bus: str) -> int:
    """Run in real time. On a bus other than the simulated one, the boards run beside the gateway."""
    path = folder / "real_time.mcap"
    command = [*HIL, "run", "--duration", str(duration_s), "--record", str(path)]
    if bus == SIMULATED:
        return soak("real time, simulated boards", command, path, duration_s)
    boards_command = [sys.executable, "-m", "firmware_sim", "--bus", bus]
    with subprocess.Popen(boards_command, stdout=subprocess.PIPE) as boards:
        assert boards.stdout is not None
        boards.stdout.readline()
        try:
            return soak(f"real time on {bus}", [*command, "--bus", bus], path, duration_s)
        finally:
            boards.terminate()


def main(argv: Sequence[str] | None = None) -> int:
    """Run both parts. Return 1 if a limit was exceeded."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--lockstep-s", type=float, default=3600.0, help="simulated time (default 3600)")
    parser.add_argument("--real-time-s", type=float, default=600.0, help="time on the bus (default 600)")
    parser.add_argument("--bus", default=VCAN, help="bus of the part in real time, or sim (default vcan0)")
    options = parser.parse_args(argv)
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        if options.lockstep_s > 0:
            failed += soak_lockstep(Path(name), options.lockstep_s)
        if options.real_time_s > 0:
            if options.bus == SIMULATED or Path(f"/sys/class/net/{options.bus}").exists():
                failed += soak_real_time(Path(name), options.real_time_s, options.bus)
            else:
                sys.stdout.flush()
                again = [
                    sys.executable,
                    __file__,
                    "--lockstep-s",
                    "0",
                    "--real-time-s",
                    str(options.real_time_s),
                ]
                failed += subprocess.run([*HIL, "vcan", "--", *again, "--bus", options.bus]).returncode
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
