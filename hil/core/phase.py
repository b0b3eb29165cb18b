"""Phases of an identification experiment, apart from the loop because the recorder must not import numpy."""

from __future__ import annotations

from enum import IntEnum


class Phase(IntEnum):
    """Phases of an experiment, as recorded with every sample of the excited axis; 0 elsewhere."""

    NONE = 0
    APPROACH = 1
    SETTLE = 2
    EXCITED = 3
    RECOVER = 4
    RETURN = 5
    DONE = 6
