"""The step of an installation that compiles the C code (``[tool.setuptools.cmdclass]`` in pyproject.toml)."""

from __future__ import annotations

from setuptools import Extension
from setuptools.command.build_ext import build_ext
from setuptools.errors import CCompilerError, ExecError, PlatformError

REMEDY = """
pneumatic-hil: the C code could not be compiled: {reason}
Install a C compiler and the C library's headers, then install again. On Debian:
    apt-get install gcc libc6-dev
"""


class BuildExtension(build_ext):  # type: ignore[misc]  # setuptools has no types
    """setuptools' own command, with a message that says what to install if there is no compiler."""

    def build_extension(self, ext: Extension) -> None:
        """Compile one extension. Exits with the message if that fails."""
        try:
            super().build_extension(ext)
        except (CCompilerError, ExecError, PlatformError, OSError) as error:
            raise SystemExit(REMEDY.format(reason=error)) from None
