"""The versions that belong into a bug report."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from importlib.metadata import version
from typing import Final

from hil import __version__
from hil.host.doctor import kernel_files
from hil.host.doctor.check import Check, check
from hil.host.doctor.kernel_files import read_line

_PACKAGES: Final = ("python-can", "pyserial", "mcap", "numpy")


def versions() -> Iterator[Check]:
    """Show the versions of the kernel, of Python and of the packages that a run uses."""
    kind = "PREEMPT_RT" if read_line(kernel_files.SYS / "kernel/realtime") == "1" else "not PREEMPT_RT"
    yield check("kernel", f"{platform.system()} {platform.release()}, {kind}")
    found = [f"hil {__version__}", *(f"{name} {version(name)}" for name in _PACKAGES)]
    yield check("versions", ", ".join([f"Python {platform.python_version()}", *found]))
