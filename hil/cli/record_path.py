"""The file that a run is recorded to, checked before the run: nothing is overwritten, and there is room."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

from hil.cli.quantities import duration_text, size_text
from hil.core.errors import RecordingError

FOLDER = Path("runs")
SUFFIX = ".mcap"
BYTES_PER_S = 50_000
"""Upper estimate of what three axes record per second."""
OVERHEAD_BYTES = 1_000_000
"""Upper estimate for documents and pictures, and for what a file system needs itself."""


def recording_path(given: Path | None, duration_s: float, has_figure: bool) -> Path:
    """Return the file to record to: ``given``, or by default ``runs/<date>-<time>.mcap``.

    ``has_figure`` is True if the run also draws the figure of a scenario. Nothing is created. Raises
    RecordingError if the recording or a picture would overwrite a file, or would not find room.
    """
    path = given or _unused_path()
    try:
        if path.is_dir():
            raise RecordingError(f"{path}: is a directory; name a file in it, such as {path / 'run.mcap'}")
        if path.suffix != SUFFIX:
            raise RecordingError(f"{path}: a recording's name ends in {SUFFIX}, such as {path}{SUFFIX}")
        for file in (path, picture_of(path), figure_of(path))[: 3 if has_figure else 2]:
            if os.path.lexists(file):
                role = "" if file == path else f" and would be a plot of {path}"
                raise RecordingError(
                    f"{file}: exists already{role}; remove it or choose another name, because nothing is "
                    "overwritten"
                )
        folder = _existing_folder(path)
        disk = os.statvfs(folder)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be created: {error.strerror}; see --record") from None
    free, needed = disk.f_bavail * disk.f_frsize, OVERHEAD_BYTES + duration_s * BYTES_PER_S
    if free < needed:
        raise RecordingError(
            f"{path}: {size_text(free)} are free on this disk, but {duration_text(duration_s)} may need "
            f"{size_text(needed)}; free some space, or choose another disk or a shorter run"
        )
    return path


def create_folder_of(path: Path) -> list[Path]:
    """Create the folder of a recording. Return the folders that did not exist, inner ones first.

    Raises RecordingError.
    """
    folder = path.parent
    created = [each for each in (folder, *folder.parents) if not each.is_dir()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordingError(
            f"{path}: the folder {folder} cannot be created: {error.strerror}; see --record"
        ) from None
    return created


def remove_empty(folders: list[Path]) -> None:
    """Remove the folders that are empty: a run that was refused had created them. Inner ones come first."""
    with contextlib.suppress(OSError):
        for folder in folders:
            folder.rmdir()


def picture_of(path: Path) -> Path:
    """Return the file of the plot beside a recording."""
    return path.with_suffix(".png")


def figure_of(path: Path) -> Path:
    """Return the file of the scenario's figure beside a recording."""
    return path.with_name(f"{path.stem}-figure.png")


def _existing_folder(path: Path) -> Path:
    """Return the deepest folder of ``path`` that exists already. Raises RecordingError."""
    folder = next(parent for parent in path.absolute().parents if os.path.lexists(parent))
    if not folder.is_dir():
        raise RecordingError(f"{path}: cannot be created: {folder} is not a directory")
    return folder


def _unused_path() -> Path:
    name = time.strftime("%Y%m%d-%H%M%S")
    path = FOLDER / f"{name}{SUFFIX}"
    number = 1
    while any(os.path.lexists(file) for file in (path, picture_of(path), figure_of(path))):
        number += 1
        path = FOLDER / f"{name}-{number}{SUFFIX}"
    return path
