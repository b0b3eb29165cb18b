"""Find controller files: the shipped ones by their names, others by their paths."""

from __future__ import annotations

import os
from pathlib import Path

from hil.core.errors import DocumentError
from hil.core.suggestions import did_you_mean

SHIPPED_CONTROLLERS = Path(__file__).parents[1] / "shipped" / "controllers"


def shipped_controllers() -> list[str]:
    """Return the names of the controllers that the package contains."""
    return sorted(path.stem for path in SHIPPED_CONTROLLERS.glob("*.json"))


def controller_path(name: str | os.PathLike[str], base: Path | None = None, origin: str = "") -> Path:
    """Return the file of a shipped controller by its name, or the file ``name`` relative to ``base``.

    ``base`` is the working directory if it is None. ``origin`` is where the controller is named, for errors.
    Raises DocumentError.
    """
    text = os.fspath(name)
    shipped = shipped_controllers()
    if text in shipped:
        return SHIPPED_CONTROLLERS / f"{text}.json"
    path = (base or Path()) / text
    if not path.exists():
        raise DocumentError(
            f"{origin}{': ' if origin else ''}controller {text!r}: there is no file {path}, and no shipped "
            f"controller has this name ({', '.join(shipped)}){did_you_mean(text, shipped)}"
        )
    return path
