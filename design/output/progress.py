"""Show the progress of the searches on stderr: one bar for each stage, with best margin and time left."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.text import Text

from design.search.searcher import Progress as SearchProgress
from design.synthesis.procedure import OnProgress

_BAR_WIDTH = 16
"""Columns of a bar: with the longest stage name, a line has fewer than 80."""


class TimeLeftColumn(ProgressColumn):
    """The estimated time left of a running stage, and the time that a finished one took."""

    def render(self, task: Task) -> Text:
        """See ProgressColumn."""
        if task.finished:
            return Text(f"{task.finished_time or 0.0:.1f} s")
        if task.time_remaining is None:
            return Text("")
        minutes, seconds = divmod(round(task.time_remaining), 60)
        return Text(f"{minutes} min left" if minutes >= 2 else f"{60 * minutes + seconds} s left")


@contextmanager
def progress_bars() -> Iterator[OnProgress]:
    """Show bars while the body runs, if stderr is a terminal; yields the function that moves them."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=_BAR_WIDTH),
        MofNCompleteColumn(),
        TextColumn("{task.fields[best]}"),
        TimeLeftColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        tasks: dict[str, TaskID] = {}

        def on_progress(stage: str, progress: SearchProgress, total: int) -> None:
            if stage not in tasks:
                for earlier in tasks.values():
                    _finish(bars, earlier)
                tasks[stage] = bars.add_task(stage, total=total, best="")
            is_feasible = progress.best_fitness > 0.0
            best = f"ε {progress.best_fitness:.4f}" if is_feasible else "none feasible"
            bars.update(tasks[stage], completed=progress.evaluations, best=best)

        yield on_progress
        for task in tasks.values():
            _finish(bars, task)


def _finish(bars: Progress, task: TaskID) -> None:
    """Mark a stage as finished: a search that has converged stops before its largest number of candidates."""
    bars.update(task, total=bars.tasks[task].completed)
