"""Import libraries that not everybody has installed."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from hil.core.errors import EnvironmentLackError


def optional_module(name: str, extra: str, purpose: str) -> Any:
    """Import the module ``name``, which the package's extra ``extra`` installs.

    ``purpose`` begins the error, such as ``writing Parquet``. Raises EnvironmentLackError with the command
    that installs it.
    """
    try:
        return import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        raise EnvironmentLackError(
            f"{purpose} needs {package}; pip install 'pneumatic-hil[{extra}]'"
        ) from None
