"""The document of an identification experiment: which axis is excited, how, and with what signal."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import msgspec
import numpy as np

from hil.core.documents import Document, from_json
from hil.core.errors import DocumentError
from hil.core.excitation import MAX_SAMPLES, Signal, samples
from hil.core.rig import Rig

NAME = "experiment.json"
Seconds = Annotated[float, msgspec.Meta(gt=0.0, le=600.0)]


class Experiment(Document, frozen=True):
    """One identification experiment, as it stands in the recording (``experiment.json``)."""

    max_entries: ClassVar[int] = MAX_SAMPLES  # of an excitation from a table
    format: Literal["hil-experiment"]
    version: Literal[1]
    axis: str
    mode: Literal["open loop", "controller output", "setpoint"]
    signal: Signal
    centre: float = 0.0
    """Position about which the axis is excited, in the axis' unit."""
    approach_s: Seconds = 3.0
    """Time of the path to the centre, at the beginning, after the fence has acted, and at the end."""
    settle_s: Seconds = 4.0
    """Time at rest in the centre before the excitation begins or goes on."""

    def duration_s(self, period_s: float) -> float:
        """Return the time that the experiment takes if the fence does not act."""
        pauses = 2.0 * (self.approach_s + self.settle_s)
        return pauses + len(samples(self.signal, period_s)) * period_s


def read_experiment(text: str, rig: Rig) -> Experiment:
    """Read and check the text of ``experiment.json`` for a rig. Raises DocumentError naming key and limit."""
    experiment = from_json(text, Experiment, NAME)
    if experiment.axis not in rig.axes:
        raise DocumentError(f"{NAME}: axis: {experiment.axis!r} is none of {', '.join(rig.axes)} (rig: axes)")
    _check_centre(experiment, rig)
    _check_amplitude(experiment, rig)
    return experiment


def _check_centre(experiment: Experiment, rig: Rig) -> None:
    axis = rig.axes[experiment.axis]
    low, high = axis.fence_limits
    if not low < experiment.centre < high:
        raise DocumentError(
            f"{NAME}: centre: {experiment.centre:g} {axis.unit} is not inside the travel fence, {low:g} to "
            f"{high:g} {axis.unit} (rig: axes.{experiment.axis}.fence_min_y, fence_max_y)"
        )


def _check_amplitude(experiment: Experiment, rig: Rig) -> None:
    axis = rig.axes[experiment.axis]
    if experiment.mode == "setpoint":
        low, high = axis.fence_limits
        limit, keys = min(high - experiment.centre, experiment.centre - low), "fence_min_y, fence_max_y"
    else:
        valve = axis.valve
        limit, keys = min(valve.max_v - valve.centre_v, valve.centre_v - valve.min_v), "valve.min_v, max_v"
    unit = axis.unit if experiment.mode == "setpoint" else "V"
    peak = float(np.max(np.abs(samples(experiment.signal, rig.loop.period_s))))
    if not peak <= limit:
        raise DocumentError(
            f"{NAME}: the excitation reaches {peak:g} {unit}, limit {limit:g} {unit} "
            f"(rig: axes.{experiment.axis}.{keys}); reduce its amplitude"
        )
