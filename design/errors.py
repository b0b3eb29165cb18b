"""What can go wrong in a design for reasons the user can put right."""

from __future__ import annotations

from hil.core.errors import HilError


class DesignError(HilError):
    """A design cannot be carried out as asked; the text says why and what to change."""


class InfeasibleError(DesignError):
    """No candidate met the specifications; names what failed, and by how much, at the best compromise."""


class NotStabilisedError(DesignError):
    """No candidate of the structure stabilised the plant (or every plant of a set)."""
