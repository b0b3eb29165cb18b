"""The errors of a design that the user can correct."""

from __future__ import annotations

from hil.core.errors import HilError


class DesignError(HilError):
    """A design cannot be made as requested; the text says why, and what to change."""


class InfeasibleError(DesignError):
    """No candidate meets the specifications; the text names those that fail, at the best compromise found."""


class NotStabilisedError(DesignError):
    """No candidate of the structure stabilises the plant, or every plant of a set."""
