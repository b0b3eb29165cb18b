"""Time and memory for a long recording: reading, a range, report, recovery, comparison; and replay speed.

    python tests/benchmarks/bench_long_recording.py [--hours 10]

Each figure is that of a process of its own: processor time and largest resident memory. Reading is compared
with the decoded messages of mcap and mcap-ros2-support, and with decompression alone, on the same file. The
recording is one of 5.6 s, repeated with times that go on. Exit status 1: a target was missed. With ten hours,
mcap's decoding is not timed, because it takes ten minutes.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.constants import PERIOD_S
from support.long_recordings import record_long_run
from support.recorded_runs import following, lag, step

import hil

MAX_RESIDENT_MB = 300.0
MAX_PAGE_MB = 5.0
MIN_RATIO_TO_MCAP, MAX_RATIO_TO_DECOMPRESSION = 30.0, 2.0
MIN_REPLAY_SPEED = 200.0
REPLAY_S = 300.0

_noise, _position = random.Random(1), lag(0.1, 1.0, 0.2)
NOISY = following(step(0.1, 1.0), lambda t: _position(t) + _noise.randrange(-3, 4) * 8e-5)
"""Signals with the noise of a 12-bit converter. Without it, they would compress to nothing."""

PROGRAMS = {
    "import": "",
    "range of 60 s": "open_recording(path).between(1800.0, 1860.0).axis('vertical')",
    "signals of one axis": "open_recording(path).axis('vertical')",
    "report": "main(['report', path, '-o', path + '.html', '--force'])",
    "compare with itself": "main(['compare', path, path])",
    "export to CSV": "main(['export', path, '--to', 'csv', '--force'])",
    "export to Parquet": "main(['export', path, '--to', 'parquet', '--force'])",
    "export to candump": "main(['export', path, '--to', 'candump', '--force'])",
    "recover": "main(['recover', path, '-o', path + '.saved'])",
    "mcap, decoded": (
        "from mcap.reader import make_reader\n"
        "from mcap_ros2.decoder import DecoderFactory\n"
        "r = make_reader(open(path, 'rb'), decoder_factories=[DecoderFactory()])\n"
        "n = sum(1 for *_, m in r.iter_decoded_messages(['/axis/vertical']) if m.position is not None)"
    ),
    "decompression alone": (
        "import zstandard\n"
        "from mcap.records import Chunk\n"
        "from mcap.stream_reader import StreamReader\n"
        "records = StreamReader(open(path, 'rb'), emit_chunks=True).records\n"
        "chunks = [r for r in records if isinstance(r, Chunk)]\n"
        "begin = time.process_time()\n"
        "for c in chunks: zstandard.decompress(c.data, c.uncompressed_size)"
    ),
    "replay": "main(['replay', path])",
}
"""Programs by the name of what they measure."""
FRAME = """
import resource, sys, time
path = sys.argv[1]
from hil.cli import main
from hil.recording import open_recording
from hil.recording.reader import Recording
begin = time.process_time()
{program}
print("\\n", time.process_time() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


class Cost(NamedTuple):
    """Processor time in seconds, and largest resident memory in MB."""

    seconds: float
    resident_mb: float


def cost_of(name: str, path: Path) -> Cost:
    """Run a program of :data:`PROGRAMS` in a process of its own."""
    program = FRAME.format(program=PROGRAMS[name])
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=True
    )
    seconds, resident_mb = map(float, done.stdout.split()[-2:])
    return Cost(seconds, resident_mb)


def check(what: str, is_reached: bool) -> bool:
    """Print a target and whether it is reached."""
    print(f"{'reached' if is_reached else 'MISSED':8} {what}")
    return is_reached


def main() -> int:
    """Measure, print, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0, help="length of the recording (default 1)")
    hours = parser.parse_args().hours
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.mcap"
        record_long_run(path, round(3600.0 * hours / PERIOD_S), NOISY)
        print(f"a recording of {hours:g} h: {path.stat().st_size / 1e6:.0f} MB")
        names = [name for name in PROGRAMS if name != "replay" and (hours < 2.0 or name != "mcap, decoded")]
        costs = {name: cost_of(name, path) for name in names}
        page_mb = path.with_name("long.mcap.html").stat().st_size / 1e6
        run = Path(folder) / "run.mcap"
        hil.run_experiment(run, duration_s=REPLAY_S)
        costs["replay"] = cost_of("replay", run)
    for name, cost in costs.items():
        print(f"{name:22} {cost.seconds:8.3f} s  {cost.resident_mb:6.0f} MB resident")
    ours = [name for name in costs if name not in ("mcap, decoded", "decompression alone")]
    largest = max(costs[name].resident_mb for name in ours)
    read_s = costs["signals of one axis"].seconds
    to_decompression = read_s / costs["decompression alone"].seconds
    speed = REPLAY_S / costs["replay"].seconds
    targets = [
        check(f"resident memory {largest:.0f} MB, limit {MAX_RESIDENT_MB:g} MB", largest < MAX_RESIDENT_MB),
        check(f"page {page_mb:.2f} MB, limit {MAX_PAGE_MB:g} MB", page_mb < MAX_PAGE_MB),
        check(
            f"reading takes {to_decompression:.2f} times decompression, limit {MAX_RATIO_TO_DECOMPRESSION:g}",
            to_decompression < MAX_RATIO_TO_DECOMPRESSION,
        ),
        check(f"replay {speed:.0f} times real time, target {MIN_REPLAY_SPEED:g}", speed > MIN_REPLAY_SPEED),
    ]
    if "mcap, decoded" in costs:
        ratio = costs["mcap, decoded"].seconds / read_s
        text = (
            f"reading is {ratio:.0f} times faster than mcap's decoded messages, target {MIN_RATIO_TO_MCAP:g}"
        )
        targets.append(check(text, ratio > MIN_RATIO_TO_MCAP))
    return 0 if all(targets) else 1


if __name__ == "__main__":
    sys.exit(main())
