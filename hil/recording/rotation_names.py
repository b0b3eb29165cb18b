"""Names of what the files of a run in several files have in addition: attachments, and keys of metadata.

The attachments are no documents of the run's set-up: a gateway is built from the others.
"""

from __future__ import annotations

STATE_NAME = "core-state.json"
"""State of the core when the file began, in the format of ``hil.core.core_state``."""
CHANGED_CONTROLLERS = "changed/controllers/"
"""Controllers that an operator has changed before the file began; the axis' name and ``.json`` follow."""

RUN_ID, PART = "run id", "part"
"""Keys in metadata ``recording``: name of the run, equal in all of its files; number of the file, from 1."""
AFTER_PAUSE = "after a pause"
"""Key in metadata ``recording`` of a file before which the recording was stopped. Its value is "yes"."""


def is_set_up(name: str) -> bool:
    """Return whether the attachment ``name`` belongs to the set-up of the run."""
    return name != STATE_NAME and not name.startswith(CHANGED_CONTROLLERS)
