"""A controller structure of the user's own, from a file or module: loaded and tried, or refused in words."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import get_args

import numpy as np

from design.mathematics.polynomials import Array
from design.search.bounds import SearchBounds
from design.synthesis.structures import Structure
from hil.core.controller_file import Law
from hil.core.errors import DocumentError


def own_structure(name: str, period_s: float) -> Structure:
    """The structure "file.py:Class" or "module:Class", which may lie in the working directory.

    It is tried at the loop's period with a few values of its parameters. Raises DocumentError.
    """
    where = f"controller structure {name!r}"
    module_name, _, attribute = name.rpartition(":")
    try:
        found = getattr(_module(module_name), attribute)
        structure = found() if isinstance(found, type) else found
    except Exception as error:
        # Whatever goes wrong in a user's module is told as what it is, not as a failure of this one.
        raise DocumentError(f"{where}: {_told(error)}") from None
    if not isinstance(structure, Structure):
        raise DocumentError(f"{where}: lacks parameters, controller or law, see design.synthesis.structures")
    if not structure.parameters:
        raise DocumentError(f"{where}: parameters: none; there is nothing to be found")
    _try(structure, where, period_s)
    return structure


def _module(name: str) -> ModuleType:
    if name.endswith(".py"):
        path = Path(name)
        if not path.exists():
            raise FileNotFoundError(f"{name}: no such file")
        spec = importlib.util.spec_from_file_location(path.stem, path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        # Dataclasses look their module up by its name.
        sys.modules[path.stem] = module
        spec.loader.exec_module(module)
        return module
    sys.path.insert(0, str(Path.cwd()))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.pop(0)


def _try(structure: Structure, where: str, period_s: float) -> None:
    box, count = SearchBounds(tuple(structure.parameters)), 5
    values = box.decode(np.random.default_rng(0).random((count, len(box))))
    try:
        parts = structure.controller(values)
        law = structure.law(values[0].tolist(), period_s)
    except Exception as error:
        raise DocumentError(f"{where}: {_told(error)}") from None
    for name, part in zip(("num", "den", "num_r"), parts, strict=True):
        shape = np.shape(part)
        if len(shape) != 2 or shape[0] not in (1, count) or shape[1] == 0:
            raise DocumentError(
                f"{where}: controller: {name} has shape {shape} for {count} candidates, not ({count}, n + 1)"
            )
        if not np.isfinite(part).all():
            raise DocumentError(f"{where}: controller: {name} is not finite at {_at(box, values, part)}")
    if parts[0].shape[1] > parts[1].shape[1] or parts[2].shape[1] > parts[1].shape[1]:
        raise DocumentError(f"{where}: controller: num has a higher degree than den: improper, it cannot run")
    if not isinstance(law, get_args(Law)):
        raise DocumentError(
            f"{where}: law: gives {type(law).__name__}, not a law of hil.core.controller_file"
        )


def _at(box: SearchBounds, values: Array, part: Array) -> str:
    row = int(np.argmin(np.isfinite(part).all(axis=1))) if len(part) > 1 else 0
    return ", ".join(f"{name} {value:.4g}" for name, value in zip(box.names, values[row], strict=True))


def _told(error: Exception) -> str:
    text = str(error) or "no reason given"
    speaks_for_itself = isinstance(error, ImportError | AttributeError | OSError)
    return text if speaks_for_itself else f"{type(error).__name__}: {text}"
