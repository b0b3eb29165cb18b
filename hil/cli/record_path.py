"""Where a run is recorded and drawn, seen to before it begins: nothing is overwritten, and there is room."""

from __future__ import annotations

import os
import time
from pathlib import Path

from hil.core.errors import RecordingError

FOLDER = Path("runs")
SUFFIX = ".mcap"
BYTES_PER_S = 50_000
"""More than three axes record in a second."""
LEAST_BYTES = 1_000_000
"""Documents, pictures, and what a file system keeps for itself."""


def recording_path(given: Path | None, duration_s: float, is_drawn_twice: bool) -> Path:
    """The file to record to, its folder made; ``runs/<date>-<time>.mcap`` when none is ``given``.

    Raises RecordingError where a recording or its pictures would overwrite something or find no room.
    """
    path = given or _free_path()
    try:
        if path.is_dir():
            raise RecordingError(f"{path}: is a directory; name a file in it, such as {path / 'run.mcap'}")
        if path.suffix != SUFFIX:
            raise RecordingError(f"{path}: a recording's name ends in {SUFFIX}, such as {path}{SUFFIX}")
        for file in (path, picture_of(path), figure_of(path))[: 3 if is_drawn_twice else 2]:
            if os.path.lexists(file):
                what = "" if file == path else f" and would be a plot of {path}"
                raise RecordingError(
                    f"{file}: exists already{what}; nothing is overwritten: remove it or choose another name"
                )
        path.parent.mkdir(parents=True, exist_ok=True)
        disk = os.statvfs(path.parent)
    except FileExistsError:
        raise RecordingError(f"{path}: cannot be created: {path.parent} is no directory") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be created: {error.strerror}; see --record") from None
    free, needed = disk.f_bavail * disk.f_frsize, LEAST_BYTES + duration_s * BYTES_PER_S
    if free < needed:
        raise RecordingError(
            f"{path}: {free / 1e6:.1f} MB are free on that disk, and {duration_s:g} s may take "
            f"{needed / 1e6:.1f} MB: make room, or choose another place or a shorter run"
        )
    return path


def picture_of(path: Path) -> Path:
    """The plot beside a recording."""
    return path.with_suffix(".png")


def figure_of(path: Path) -> Path:
    """The scenario's figure beside a recording."""
    return path.with_name(f"{path.stem}-figure.png")


def _free_path() -> Path:
    name = time.strftime("%Y%m%d-%H%M%S")
    path = FOLDER / f"{name}{SUFFIX}"
    number = 1
    while any(os.path.lexists(file) for file in (path, picture_of(path), figure_of(path))):
        number += 1
        path = FOLDER / f"{name}-{number}{SUFFIX}"
    return path
