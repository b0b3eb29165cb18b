"""Memory that commands need for a recording of ten hours.

    python tests/benchmarks/bench_long_recording.py

Each command is a process of its own; its largest resident memory must stay under 300 MB. Exit status 1 if one
needs more.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.constants import PERIOD_S
from support.long_recordings import record_long_run

HOURS = 10.0
MAX_RESIDENT_MB = 300.0
RANGE = (
    "import hil; run = hil.open_recording('run.mcap').between(18000.0, 18060.0);"
    "assert len(run.axis('vertical')) > 5000"
)
COMMANDS = {
    "read one minute": ["-c", RANGE],
    "export to csv": ["-m", "hil.cli", "export", "run.mcap", "--to", "csv"],
    "export to Parquet": ["-m", "hil.cli", "export", "run.mcap", "--to", "parquet"],
    "export to candump": ["-m", "hil.cli", "export", "run.mcap", "--to", "candump"],
    "report": ["-m", "hil.cli", "report", "run.mcap"],
}


def measured(arguments: list[str], folder: Path) -> tuple[int, float, float]:
    """Return exit status, seconds of processor time, and largest resident memory in MB of a command."""
    process = subprocess.Popen([sys.executable, *arguments], cwd=folder, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return process.returncode, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1000


def bench(folder: Path) -> bool:
    """Print the figures of each command, and return whether all are within the limit."""
    began = time.process_time()
    periods = record_long_run(folder / "run.mcap", round(HOURS * 3600 / PERIOD_S))
    size_mb = (folder / "run.mcap").stat().st_size / 1e6
    print(f"{periods} periods of three axes, {size_mb:.0f} MB, made in {time.process_time() - began:.0f} s")
    passed = True
    for name, arguments in COMMANDS.items():
        status, spent_s, resident_mb = measured(arguments, folder)
        is_good = status == 0 and resident_mb < MAX_RESIDENT_MB
        verdict = "" if is_good else f"  exit status {status}, limit {MAX_RESIDENT_MB:g} MB"
        print(f"{name:18} {spent_s:6.1f} s, {resident_mb:6.0f} MB resident{verdict}", flush=True)
        passed = passed and is_good
        for made in folder.glob("run.[!m]*"):
            made.unlink()
    return passed


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        sys.exit(0 if bench(Path(name)) else 1)
