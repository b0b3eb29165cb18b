"""The shipped campaign ``faults`` as a user runs it: time, memory, and scaling over processes.

``--draws N`` makes N times 470 cases of 3 s. The default is more than 2,000 cases.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from hil.campaigns.campaign_file import Campaign, case_count, find_campaign, read_campaign
from hil.campaigns.prepared import PreparedCampaign, prepare
from hil.campaigns.runner import default_workers, run_cases

CASES = 2000
MAX_S_ON_TWO_CORES = 60.0
MIN_SCALING = 0.9
MAX_MEMORY_RATIO = 1.1
SCALING_CASES = 48
"""Number of cases for each process in one round of the measurement of scaling."""
ROUNDS = 3


class Usage(NamedTuple):
    """What one run of the command used."""

    cases: int
    wall_s: float
    processor_s: float
    memory_mb: float
    """Largest memory of the command and of each of its processes, in MB."""


def run_command(draws: int, cases: int, workers: int) -> Usage:
    """Run ``hil campaign faults`` in a process of its own, the page included."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "hil.cli", "campaign", "faults", "--draws", str(draws)]
        command += ["--workers", str(workers), "--output", str(Path(folder) / "results")]
        begun_s = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        wall_s = time.perf_counter() - begun_s
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 1):
        raise SystemExit(f"{' '.join(command)} ended with {process.returncode}")
    return Usage(cases, wall_s, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def scaling(prepared: PreparedCampaign, workers: int) -> float:
    """Return the speed of ``workers`` processes over that of one, divided by their number.

    Both are measured in turns, so that the machine's load is in both. The best round counts.
    """
    last = case_count(prepared.campaign)
    return max(
        seconds(prepared, last - SCALING_CASES, 1)
        / seconds(prepared, last - SCALING_CASES * workers, workers)
        for _ in range(ROUNDS)
    )


def seconds(prepared: PreparedCampaign, first: int, workers: int) -> float:
    """Return the time in which the cases from ``first`` on are run."""
    begun_s = time.perf_counter()
    for _ in run_cases(prepared, first, workers):
        pass
    return time.perf_counter() - begun_s


def cases_of(campaign: Campaign, draws: int) -> int:
    """Return the number of cases with so many draws."""
    return case_count(campaign) // campaign.draws * draws


def verdict(is_met: bool) -> str:
    """Return the last column of a line."""
    return "" if is_met else "MISSED"


def main() -> int:
    """Print each target beside its figure; return 1 if one is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--draws", type=int, default=5)
    draws = parser.parse_args().draws
    path = find_campaign("faults")
    campaign = read_campaign(path.read_text(), str(path))
    workers = default_workers()
    few = run_command(1, cases_of(campaign, 1), workers)
    many = run_command(draws, cases_of(campaign, draws), workers)
    case_ms = 1000.0 * many.processor_s / many.cases
    time_s = many.wall_s * CASES / many.cases
    max_s = MAX_S_ON_TWO_CORES * 2 / workers
    ratio = many.memory_mb / few.memory_mb
    print(f"load average {os.getloadavg()[0]:.1f} on {workers} processors")
    print(f"{many.cases} cases of 3 s in {many.wall_s:.1f} s, {case_ms:.1f} ms of processor time a case,")
    print(f"  {case_ms * CASES / workers / 1000.0:.1f} s for {CASES} cases where nothing else runs")
    met = [time_s <= max_s]
    print(f"time of {CASES} cases          {time_s:7.1f} s    target <= {max_s:g} s  {verdict(met[-1])}")
    met.append(ratio <= MAX_MEMORY_RATIO)
    memory = f"{many.memory_mb:.0f}/{few.memory_mb:.0f} MB = {ratio:.2f}"
    cases = f"{many.cases}/{few.cases} cases"
    print(f"memory, {cases}   {memory}   target <= {MAX_MEMORY_RATIO}  {verdict(met[-1])}")
    if workers > 1:
        found = scaling(prepare(campaign), workers)
        met.append(found >= MIN_SCALING)
        print(
            f"scaling over {workers} processes {found:9.2f}      target >= {MIN_SCALING}  {verdict(met[-1])}"
        )
    return 0 if all(met) else 1


if __name__ == "__main__":
    raise SystemExit(main())
