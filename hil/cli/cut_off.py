"""The warning about a recording that was cut off, for the commands that use what is left of it."""

from __future__ import annotations

import sys

from hil.recording.reader import Recording


def warn_if_cut_off(recording: Recording) -> None:
    """Say on stderr that the end of the recording is missing, if it is."""
    if not recording.complete:
        sys.stderr.write(
            f"{recording.path}: was cut off, so its end is missing; what is whole is used, up to "
            f"{recording.duration_s:.3f} s\n"
        )
