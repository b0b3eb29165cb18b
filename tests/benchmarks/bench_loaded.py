"""The loop on a loaded machine: missed periods and faults beside each kind of load, and their causes.

    python tests/benchmarks/bench_loaded.py [--duration 15] [--rounds 2] [--loads build memory] [--only vcan]

The loads are made here, without a network: ``busy`` keeps every processor busy; ``build`` compiles C and
Python; ``install`` unpacks thousands of files, and forces files to the disk one by one, as a package
installer does; ``memory`` lets the kernel reclaim its page cache. The runs use the default bus (UDP) and, in
user-mode Linux, vcan0 with the boards in a process of their own, with the recording on the disk.

A witness (``loaded/witness.py``) runs beside each run. It decides why a period was missed: the host or the
kernel ran nothing; a process of the run waited for the disk; it was ready but not scheduled; user-mode Linux
was too slow; or none of these. Exit status 1: a period was missed for another reason than a stall.

What was found with it, on two shared processors, Linux 6.18:

- No run waited for the disk: no major page fault of loop or boards, no wait of user-mode Linux.
- User-mode Linux was too slow. Its kernel and its programs are processes that run in turns, and on two
  processors each turn woke the other one. The response took up to 10 ms of 11.2 ms without a load. Beside
  ``install`` and ``build and install``, 5 of 7 runs faulted. The machine now has one processor.
- User-mode Linux had real-time priority. If a real-time program is busy for a second, Linux lets ordinary
  programs run for 50 ms (the fair server, or throttling before Linux 6.12), and stops every real-time
  program on that processor meanwhile, such as the default loop: the witness saw stalls of 45 to 60 ms. The
  machine now has the highest priority among ordinary programs instead.
- ``memory``, and time that the host takes ("stolen"), stop the witness too. No program can prevent that.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from loaded.causes import Cause, Incident, cause_of, incidents
from loaded.loads import LOADS, load
from loaded.witness import Witness

from hil.recording.reader import Recording

HIL = [sys.executable, "-m", "hil.cli"]
VCAN = "vcan0"


class Run(NamedTuple):
    """What the recording of one run shows."""

    ending: str
    """Reason of the ending; with the fault, if there was one."""
    missed: int
    lost: int
    """Periods without a good sample."""
    late_us: tuple[float, float]
    """Lateness of the loop, p99 and largest."""
    response_us: tuple[float, float]
    """Time from SYNC to command, p99 and largest."""
    incidents: list[Incident]


def worst(nanoseconds: np.ndarray) -> tuple[float, float]:
    """Return p99 and the largest of times in ns, in us."""
    if not len(nanoseconds):
        return 0.0, 0.0
    return float(np.percentile(nanoseconds, 99)) * 1e-3, float(nanoseconds.max()) * 1e-3


def gateway_run(folder: Path, bus: str, duration_s: float) -> Run:
    """Run the gateway, on vcan0 with the boards in a process of their own."""
    path = folder / "run.mcap"
    command = [*HIL, "run", "--no-plot", "--duration", str(duration_s), "--record", str(path)]
    with contextlib.ExitStack() as stack:
        if bus == VCAN:
            boards = [sys.executable, "-m", "firmware_sim", "--bus", bus]
            started = stack.enter_context(subprocess.Popen(boards, stdout=subprocess.PIPE))
            stack.callback(started.terminate)
            assert started.stdout is not None
            started.stdout.readline()
            command += ["--bus", bus]
        done = subprocess.run(command, capture_output=True, text=True)
    if not path.exists():
        return Run(f"no recording: {done.stderr.strip()[-200:]}", 0, 0, (0.0, 0.0), (0.0, 0.0), [])
    return read_run(Recording(path))


def read_run(recording: Recording) -> Run:
    """Read what is shown of a run."""
    ending, timing = recording.metadata["ending"], recording.timing()
    running = timing[timing["running"]]
    return Run(
        ending["reason"] + (f": {ending['fault']}" if ending["fault"] else ""),
        int(ending["missed periods"]),
        int((~running["fresh"]).sum()),
        worst(timing["wake_ns"] - timing["deadline_ns"]),
        worst((timing["sent_ns"] - timing["wake_ns"])[timing["fresh"]]),
        incidents(recording),
    )


def guest_run(folder: Path, duration_s: float) -> Run:
    """Run on vcan0, in user-mode Linux if this kernel has none."""
    inner = [sys.executable, __file__, "--inner", str(folder), "--duration", str(duration_s)]
    done = subprocess.run([*HIL, "vcan", "--", *inner], capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(done.stderr.strip()[-500:])
    *fields, found = json.loads(done.stdout.strip().splitlines()[-1])
    return Run(*fields, [Incident(*incident) for incident in found])


def pressure() -> dict[str, float]:
    """Return for how many seconds some process waited for processor, disk and memory, and the stolen time."""
    totals = {}
    for kind in ("cpu", "io", "memory"):
        with contextlib.suppress(OSError):
            line = Path(f"/proc/pressure/{kind}").read_text().splitlines()[0]
            totals[kind] = int(line.rpartition("=")[2]) * 1e-6
    totals["stolen"] = int(Path("/proc/stat").read_text().split()[8]) / os.sysconf("SC_CLK_TCK")
    return totals


def measure(name: str, bus: str, duration_s: float) -> Counter[str]:
    """Measure one run beside a witness, print it, and return how many periods each cause has cost."""
    before, begin_s = pressure(), time.monotonic()
    witness = Witness(os.getpid())
    with tempfile.TemporaryDirectory(dir=".", prefix="loaded-") as folder:
        run = (
            guest_run(Path(folder), duration_s) if bus == VCAN else gateway_run(Path(folder), bus, duration_s)
        )
    evidence = witness.finish()
    causes: Counter[str] = Counter()
    details = []
    for incident in run.incidents:
        cause, figures = cause_of(incident, evidence)
        causes[cause] += 1
        what = "loop late" if incident.is_loop else "no sample"
        details.append(
            f"    {what} {(incident.end_ns - incident.begin_ns) / 1e6:.1f} ms: {cause} ({figures})"
        )
    if not run.ending.startswith("completed"):
        causes["faults"] += 1
    took_s = time.monotonic() - begin_s
    waited = ", ".join(f"{kind} {(now - before[kind]) / took_s:.0%}" for kind, now in pressure().items())
    shown = ", ".join(f"{cause} {causes[cause]}" for cause in Cause if causes[cause]) or "none"
    print(
        f"{name}, {bus}: missed {run.missed:3}, without sample {run.lost:3}; causes: {shown}; late p99/max "
        f"{run.late_us[0]:.0f}/{run.late_us[1]:.0f} us, response {run.response_us[0]:.0f}/"
        f"{run.response_us[1]:.0f} us; stalls of the witness {len(evidence.stalls)}; share of time "
        f"with waiting: {waited}; {run.ending}"
    )
    print(*details[:12], sep="\n", end="\n" if details else "", flush=True)
    return causes


def main() -> int:
    """Measure every load on both buses."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--duration", type=float, default=15.0, help="seconds of each run (default 15)")
    parser.add_argument("--rounds", type=int, default=2, help="runs of each kind (default 2)")
    parser.add_argument("--only", choices=["udp", "vcan"], help="measure on this bus only")
    parser.add_argument("--loads", nargs="+", choices=LOADS, default=list(LOADS), help="loads (default all)")
    parser.add_argument("--inner", metavar="FOLDER", help="measure on vcan0 of this kernel, and print JSON")
    options = parser.parse_args()
    if options.inner:
        print(json.dumps(gateway_run(Path(options.inner), VCAN, options.duration)))
        return 0
    buses = {"udp": ["sim"], "vcan": [VCAN]}.get(options.only, ["sim", VCAN])
    rows: dict[str, Counter[str]] = {}
    for name in options.loads:
        with load(name):
            for _ in range(options.rounds):
                for bus in buses:
                    row = rows.setdefault(f"{name}, {bus}", Counter())
                    row += measure(name, bus, options.duration) + Counter({"runs": 1})
    print(f"\n{'load, bus':28}{'runs':>6}{'faults':>8}" + "".join(f"{cause:>24}" for cause in Cause))
    for name, row in rows.items():
        print(f"{name:28}{row['runs']:6}{row['faults']:8}" + "".join(f"{row[cause]:24}" for cause in Cause))
    ours = sum(row[cause] for row in rows.values() for cause in Cause if cause is not Cause.HOST)
    print(f"missed periods for another reason than a stall of the host: {ours}, target 0")
    return 1 if ours else 0


if __name__ == "__main__":
    sys.exit(main())
