"""Progress of work along the time of a recording."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.progress import Progress


class FileProgress:
    """A bar on stderr while a recording is exported, imported or replayed; none without a terminal."""

    def __init__(self, title: str, total: float) -> None:
        """``total`` is the duration of the work, in any unit."""
        is_shown = sys.stderr.isatty()
        self._progress = Progress(
            console=Console(stderr=True, markup=False, highlight=False), transient=True, disable=not is_shown
        )
        self._task = self._progress.add_task(title, total=total)

    def __enter__(self) -> FileProgress:
        self._progress.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._progress.stop()

    def __call__(self, completed: float) -> None:
        """Move the bar to ``completed``, in the unit of the total."""
        self._progress.update(self._task, completed=completed)
