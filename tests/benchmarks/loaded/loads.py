"""Loads that are made here, without a network, each by some programs in folders of their own on the disk."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

BUSY = "while True: pass"
BUILD = """
import compileall, os, shutil, subprocess, json
while True:
    shutil.copytree(os.path.dirname(json.__file__), 'sources', dirs_exist_ok=True)
    compileall.compile_dir('sources', force=True, quiet=2)
    lines = [f'int f{n}(int x) {{ return x * {n} + (x >> {n % 31}); }}' for n in range(20000)]
    open('source.c', 'w').write(chr(10).join(lines))
    subprocess.run(['gcc', '-O2', '-c', 'source.c', '-o', 'object.o'], check=True)
"""
INSTALL = """
import os, shutil
content = os.urandom(40_000)
while True:
    for number in range(3000):
        os.makedirs(f'tree/{number % 50}', exist_ok=True)
        with open(f'tree/{number % 50}/{number}', 'wb') as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    with open('archive', 'wb') as file:
        for _ in range(5000): file.write(content)
        os.fsync(file.fileno())
    shutil.rmtree('tree')
"""
UNPACK = """
import numpy, pathlib, shutil, subprocess
packages = pathlib.Path(numpy.__file__).parent.parent
subprocess.run(['tar', '-cf', 'packages.tar', '-C', packages, 'numpy'], check=True)
while True:
    subprocess.run(['tar', '-xf', 'packages.tar'], check=True)
    subprocess.run(['python3', '-m', 'compileall', '-qq', 'numpy'])
    shutil.rmtree('numpy')
"""
MEMORY = """
import mmap, os
size = 2 * os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES')
with open('sparse', 'wb') as file:
    file.truncate(size)
while True:
    with open('sparse', 'rb', buffering=0) as file:
        while file.readinto(bytearray(1 << 24)):
            with mmap.mmap(-1, 1 << 28) as taken:
                for place in range(0, 1 << 28, 4096): taken[place] = 1
                for _ in range(40): file.readinto(bytearray(1 << 24))
"""
"""Reads a file of holes that is twice as long as the memory, so that the kernel has to reclaim its page
cache, and takes and gives back 256 MB again and again. Needs no disk."""
LOADS: dict[str, list[str]] = {
    "no load": [],
    "busy": [BUSY] * 2 * (os.cpu_count() or 1),
    "build": [BUILD] * 2,
    "install": [INSTALL, UNPACK],
    "build and install": [BUILD, BUILD, INSTALL, UNPACK],
    "memory": [MEMORY] * 2,
}
"""Programs of each load."""


@contextlib.contextmanager
def load(name: str) -> Iterator[None]:
    """Run the programs of a load."""
    with tempfile.TemporaryDirectory(dir=".", prefix="load-") as folder, contextlib.ExitStack() as stack:
        for number, program in enumerate(LOADS[name]):
            place = Path(folder) / str(number)
            place.mkdir()
            process = subprocess.Popen(
                [sys.executable, "-c", program], cwd=place, stderr=subprocess.DEVNULL, start_new_session=True
            )
            stack.callback(process.wait)
            stack.callback(os.killpg, process.pid, signal.SIGKILL)
        yield
