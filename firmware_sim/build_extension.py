"""The step of an installation that compiles the C code (``[tool.setuptools.cmdclass]`` in pyproject.toml)."""

from __future__ import annotations

from distutils.errors import CCompilerError, DistutilsExecError, DistutilsPlatformError

from setuptools import Extension
from setuptools.command.build_ext import build_ext

REMEDY = """
pneumatic-hil: the C code could not be compiled: {reason}
Install a C compiler and the C library's headers, then install again. On Debian:
    apt-get install gcc libc6-dev
"""


class BuildExtension(build_ext):
    """setuptools' own command, with a message that says what to install if there is no compiler."""

    def build_extension(self, ext: Extension) -> None:
        """Compile one extension. Exits with the message if that fails."""
        try:
            super().build_extension(ext)
        except (CCompilerError, DistutilsExecError, DistutilsPlatformError, OSError) as error:
            raise SystemExit(REMEDY.format(reason=error)) from None
