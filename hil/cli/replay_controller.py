"""``hil replay --with-controller``: compare another controller's commands with the recorded ones."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hil.cli.cut_off import warn_if_cut_off
from hil.conversion.output_file import check_output, new_file
from hil.core.errors import DocumentError, RecordingError
from hil.recording import open_recording
from hil.shells.controller_comparison import Comparison, compare
from hil.shells.run_setup import load_controller

OPEN_LOOP = (
    "open loop: the measurements are the recorded ones. With the other controller,\n"
    "the arm would have moved otherwise. So this shows how the answers of the\n"
    "controllers differ, not how the arm would follow."
)


def replay_with_controller(path: Path, options: argparse.Namespace) -> int:
    """Compare, print figures, and write the plot; return the exit status. Raises HilError."""
    output = options.output or path.with_name(f"{path.stem}-with-controller.png")
    if output.suffix.lower() != ".png":
        raise DocumentError(f"-o {output}: a plot's name ends in .png, such as {output}.png")
    chosen = _by_axis(options.with_controller)
    recording = open_recording(path)
    warn_if_cut_off(recording)
    if "imported" in recording.metadata:
        raise RecordingError(
            f"{path}: was imported from a bus log, which has no setpoints, so no controller can be run on it"
        )
    controllers = {axis: load_controller(name) for axis, name in chosen.items()}
    check_output(output, force=options.force)
    comparisons = [
        compare(recording, axis, controllers[axis], f"--with-controller {axis}={name}")
        for axis, name in chosen.items()
    ]
    from hil.views.controller_plot import plot_commands

    with new_file(output, force=options.force, source=path) as temporary:
        plot_commands(
            temporary,
            [
                (found.axis, found.command_v, found.difference_v, found.recorded_name, found.other_name)
                for found in comparisons
            ],
        )
    sys.stdout.write("".join(map(_figures, comparisons)))
    sys.stdout.write(f"{OPEN_LOOP}\nplot       {output}\n")
    return 0


def _by_axis(given: list[str]) -> dict[str, str]:
    chosen: dict[str, str] = {}
    for text in given:
        axis, equals, name = text.partition("=")
        if not (axis and equals and name):
            raise DocumentError(f"--with-controller {text}: write AXIS=FILE, such as vertical=new.json")
        if axis in chosen:
            raise DocumentError(
                f"--with-controller {axis}=…: is given twice; give one controller for an axis"
            )
        chosen[axis] = name
    return chosen


def _figures(found: Comparison) -> str:
    largest_v, at_s = found.largest_difference
    periods = len(found.axis)
    return (
        f"{found.axis.name}: {found.other_name} beside {found.recorded_name}, {periods} periods\n"
        f"  largest difference of the command  {largest_v:.4f} V at {at_s:.3f} s\n"
        f"  rms difference                     {float((found.difference_v**2).mean() ** 0.5):.4f} V\n"
        f"  periods at a limit                 {int(found.other_at_limit.sum())}, recorded "
        f"{int(found.recorded_at_limit.sum())}\n"
    )
