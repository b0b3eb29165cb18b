"""What a failed test leaves behind: recording, plot and log, in a folder that the report names."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from hil.lockstep_rig import LockstepRig
    from hil.recording.reader import Recording

Keeper = Callable[[Path], list[str]]
"""Writes files into a folder, and returns a line for the report for each of them."""

_KEEPERS = pytest.StashKey[list[Keeper]]()
_MAX_NAME_LETTERS = 120


def keep_on_failure(item: pytest.Item, keeper: Keeper) -> None:
    """Call ``keeper`` if the test fails."""
    item.stash.setdefault(_KEEPERS, []).append(keeper)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Keep what a failed test has, and add a section to its report."""
    report = yield
    keepers = item.stash.get(_KEEPERS, [])
    if report.failed and report.when == "call" and keepers:
        folder = failure_folder(item)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        report.sections.append(("kept by hil", "\n".join(_kept(keepers, folder))))
    return report


def failure_folder(item: pytest.Item) -> Path:
    """Return the folder for the files of a failed test."""
    config = item.config
    base = str(config.getoption("--hil-failures") or config.getini("hil_failures"))
    return config.rootpath / base / re.sub(r"[^\w.=-]+", "-", item.nodeid).strip("-")[-_MAX_NAME_LETTERS:]


def keep_lockstep_rig(rig: LockstepRig, name: str) -> Keeper:
    """Return a keeper for a rig in simulated time."""

    def keep(folder: Path) -> list[str]:
        recording = rig.save_recording(folder / f"{name}.mcap")
        return [*keep_recording(recording, folder, name), f"log        {_write_log(recording, folder, name)}"]

    return keep


def keep_recording(recording: Recording, folder: Path, name: str) -> list[str]:
    """Draw the plot of a recording that is in ``folder`` already. Returns lines for the report."""
    from hil.core.errors import RecordingError
    from hil.views.plots import plot_run

    lines = [f"recording  {recording.path}"]
    try:
        plot_run(recording, folder / f"{name}.png")
    except RecordingError as error:
        return [*lines, f"no plot: {error}"]
    return [*lines, f"plot       {folder / f'{name}.png'}"]


def _write_log(recording: Recording, folder: Path, name: str) -> Path:
    """Write the log, with the seconds since the first period."""
    path = folder / f"{name}.log"
    lines = [
        f"{recording.seconds(at_ns):9.4f} s  {entry.severity.name:7} {entry.source}: {entry.text}\n"
        for at_ns, entry in recording.log()
    ]
    path.write_text("".join(lines), encoding="utf-8")
    return path


def _kept(keepers: list[Keeper], folder: Path) -> list[str]:
    lines: list[str] = []
    for keeper in keepers:
        try:
            lines += keeper(folder)
        except Exception as error:  # the test's own failure must still be reported
            lines.append(f"not kept: {type(error).__name__}: {error}")
    return lines
