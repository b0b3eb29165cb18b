"""Load a user's own controller structure from a file or module, and check it before it is used."""

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
    """Load the structure named "file.py:Class" or "module:Class".

    Files are relative to the working directory, which is also searched for modules. The structure is
    evaluated at the loop's period for a few values of its parameters. Raises DocumentError, whatever the
    user's code does.
    """
    where = f"controller structure {name!r}"
    module_name, _, attribute = name.rpartition(":")
    try:
        found = getattr(_module(module_name), attribute)
        structure = found() if isinstance(found, type) else found
    except Exception as error:
        # The user's module may raise anything; the message shows its error, not a traceback of this program.
        raise DocumentError(f"{where}: {_error_text(error)}") from None
    if not isinstance(structure, Structure):
        raise DocumentError(
            f"{where}: lacks parameters, controller or law; see Structure in design.synthesis.structures"
        )
    if not structure.parameters:
        raise DocumentError(f"{where}: parameters is empty; name at least one parameter to be searched")
    _check_by_trial(structure, where, period_s)
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


def _check_by_trial(structure: Structure, where: str, period_s: float) -> None:
    bounds, count = SearchBounds(tuple(structure.parameters)), 5
    values = bounds.decode(np.random.default_rng(0).random((count, len(bounds))))
    try:
        parts = structure.controller(values)
        law = structure.law(values[0].tolist(), period_s)
    except Exception as error:
        raise DocumentError(f"{where}: {_error_text(error)}") from None
    for name, part in zip(("num", "den", "num_r"), parts, strict=True):
        shape = np.shape(part)
        if len(shape) != 2 or shape[0] not in (1, count) or shape[1] == 0:
            raise DocumentError(
                f"{where}: controller: {name} has shape {shape} for {count} candidates, not ({count}, n + 1)"
            )
        if not np.isfinite(part).all():
            raise DocumentError(
                f"{where}: controller: {name} is not finite at {_values_text(bounds, values, part)}"
            )
    if parts[0].shape[1] > parts[1].shape[1] or parts[2].shape[1] > parts[1].shape[1]:
        raise DocumentError(
            f"{where}: controller: num has a higher degree than den; an improper controller cannot run"
        )
    if not isinstance(law, get_args(Law)):
        raise DocumentError(
            f"{where}: law: returns {type(law).__name__}, not a law of hil.core.controller_file"
        )


def _values_text(bounds: SearchBounds, values: Array, part: Array) -> str:
    """Return the parameter values of the first candidate whose polynomial is not finite."""
    row = int(np.argmin(np.isfinite(part).all(axis=1))) if len(part) > 1 else 0
    return ", ".join(f"{name} {value:.4g}" for name, value in zip(bounds.names, values[row], strict=True))


def _error_text(error: Exception) -> str:
    text = str(error) or "no reason given"
    is_clear_alone = isinstance(error, ImportError | AttributeError | OSError)
    return text if is_clear_alone else f"{type(error).__name__}: {text}"
