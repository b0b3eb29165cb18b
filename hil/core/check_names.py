"""Names of the checks before arming, by which an operator can override them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

from hil.core.errors import DocumentError
from hil.core.rig import Rig, Right
from hil.core.suggestions import did_you_mean

POSITION, CONTROLLER = "position-", "controller-"
"""Beginnings of the names of the core's checks. The name of the axis follows."""


def check_of_right(right: str) -> str:
    """Return the name of the check of a right of the machine, such as ``memory-lock``."""
    return right.replace(" ", "-")


def check_names(rig: Rig) -> tuple[str, ...]:
    """Return the names of all checks that an operator of ``rig`` can override."""
    rights = tuple(check_of_right(right) for right in get_args(Right))
    return (*(f"{start}{axis}" for start in (POSITION, CONTROLLER) for axis in rig.axes), *rights)


def check_overrides(names: Sequence[str], rig: Rig) -> None:
    """Check that each of ``names`` is the name of a check of ``rig``. Raises DocumentError."""
    valid = check_names(rig)
    for name in names:
        if name not in valid:
            raise DocumentError(
                f"--override {name}: no check has this name; the checks are {', '.join(valid)}"
                f"{did_you_mean(name, valid)}"
            )
