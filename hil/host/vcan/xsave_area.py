"""Locate the library that ``xsave_area.c`` is compiled into. The C file explains what it is for."""

from __future__ import annotations

from pathlib import Path

from hil.core.errors import EnvironmentLackError


def xsave_area_library() -> Path:
    """Return the path of the compiled library.

    Any suffix is accepted: the library uses no Python API, so it does not matter which Python built it.
    Raises EnvironmentLackError if it was never compiled.
    """
    folder = Path(__file__).parent
    built = sorted(folder.glob("_xsave_area*.so"), key=lambda path: path.stat().st_mtime)
    if not built:
        raise EnvironmentLackError(
            "user-mode Linux needs a library of this package that is not compiled (no _xsave_area*.so in "
            f"{folder}); install a C compiler and this package again: sudo apt-get install gcc libc6-dev, "
            "then pip install -e ."
        )
    return built[-1]
