"""Names of the attachments of a recording that begins in the middle of a run.

They are no documents of the run's set-up: a gateway is built from the others.
"""

from __future__ import annotations

STATE_NAME = "core-state.json"
"""State of the core when the file began, in the format of ``hil.core.core_state``."""
CHANGED_CONTROLLERS = "changed/controllers/"
"""Controllers that an operator has changed before the file began; the axis' name and ``.json`` follow."""


def is_set_up(name: str) -> bool:
    """Return whether the attachment ``name`` belongs to the set-up of the run."""
    return name != STATE_NAME and not name.startswith(CHANGED_CONTROLLERS)
