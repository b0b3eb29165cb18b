"""Size of a recording of three axes with all frames, by the parts of the file, beside the target for an hour.

    python tests/benchmarks/bench_recording_size.py [--minutes 10]

The run is one of the simulated arm, with noise, in lockstep. In real time, receive stamps and lateness vary,
so that the file is larger: ``--real-time`` measures that. Exit status 1: an hour would exceed the target.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

HIL = [sys.executable, "-m", "hil.cli"]
MAX_MB_H = 60.0
INDEX_ENTRY_BYTES = 16
"""Bytes of a message's entry in its chunk's index (MCAP specification, Message Index)."""


def record(path: Path, duration_s: float, is_real_time: bool) -> None:
    """Record a run of the simulated arm."""
    command = [*HIL, "run", "--duration", str(duration_s), "--record", str(path)]
    subprocess.run([*command, *([] if is_real_time else ["--lockstep"])], check=True, capture_output=True)


def parts_of(path: Path) -> tuple[dict[str, int], dict[str, int]]:
    """Return the bytes of each part of a file, and the number of messages of each topic."""
    parts: Counter[str] = Counter()
    with path.open("rb") as stream:
        for entry in StreamReader(stream, emit_chunks=True).records:
            if isinstance(entry, Chunk):
                parts["messages, compressed"] += len(entry.data)
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None and summary.statistics is not None
    counts = {
        summary.channels[channel].topic: count
        for channel, count in summary.statistics.channel_message_counts.items()
    }
    parts["index of the messages, not compressed"] = INDEX_ENTRY_BYTES * sum(counts.values())
    parts["everything else"] = path.stat().st_size - sum(parts.values())
    return parts, counts


def main() -> int:
    """Print the parts. Return 1 if the target is missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=10.0, help="length of the run (default 10)")
    parser.add_argument("--real-time", action="store_true", help="run in real time instead of lockstep")
    options = parser.parse_args()
    duration_s = 60.0 * options.minutes
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        record(path, duration_s, options.real_time)
        parts, counts = parts_of(path)
        size = path.stat().st_size
    per_hour = 3600.0 / duration_s
    messages = sum(counts.values())
    for name, count in parts.items():
        print(f"{name:40} {count * per_hour / 1e6:6.1f} MB an hour, {count / messages:5.1f} B a message")
    for topic, count in counts.items():
        print(f"{topic:40} {count * per_hour / 1e6:6.2f} million messages an hour")
    mb_h = size * per_hour / 1e6
    is_met = mb_h <= MAX_MB_H
    verdict = "met" if is_met else "MISSED"
    print(f"an hour of three axes with all frames: {mb_h:.1f} MB, target {MAX_MB_H:g} MB: {verdict}")
    return 0 if is_met else 1


if __name__ == "__main__":
    sys.exit(main())
