"""The document of an identification experiment: which axis is excited, how, and with what signal."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, NamedTuple

import msgspec
import numpy as np

from hil.core.documents import Document, from_json
from hil.core.errors import DocumentError
from hil.core.excitation import MAX_SAMPLES, Signal, samples
from hil.core.rig import Rig

NAME = "experiment.json"
MAX_PAUSE_S = 600.0
"""Longest path to the centre, and longest rest there, in s."""
Seconds = Annotated[float, msgspec.Meta(gt=0.0, le=MAX_PAUSE_S)]


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


class Origins(NamedTuple):
    """Where the values of an experiment were given, for errors."""

    axis: str = f"{NAME}: axis"
    centre: str = f"{NAME}: centre"
    signal: str = f"{NAME}: signal"


IN_DOCUMENT = Origins()
"""Origins of an experiment that was read from its document."""


def read_experiment(text: str, rig: Rig) -> Experiment:
    """Read and check the text of ``experiment.json`` for a rig. Raises DocumentError naming key and limit."""
    experiment = from_json(text, Experiment, NAME)
    check_experiment(experiment, rig)
    return experiment


def check_experiment(experiment: Experiment, rig: Rig, origins: Origins = IN_DOCUMENT) -> None:
    """Check that an experiment fits a rig. Raises DocumentError naming origin, value and limit."""
    if experiment.axis not in rig.axes:
        raise DocumentError(
            f"{origins.axis}: {experiment.axis!r} is none of {', '.join(rig.axes)} (rig: axes)"
        )
    _check_centre(experiment, rig, origins.centre)
    _check_amplitude(experiment, rig, origins.signal)


def _check_centre(experiment: Experiment, rig: Rig, origin: str) -> None:
    axis = rig.axes[experiment.axis]
    low, high = axis.fence_limits
    if not low < experiment.centre < high:
        raise DocumentError(
            f"{origin}: {experiment.centre:g} {axis.unit} is not inside the travel fence, {low:g} to "
            f"{high:g} {axis.unit} (rig: axes.{experiment.axis}.fence_min_y, fence_max_y)"
        )


def _check_amplitude(experiment: Experiment, rig: Rig, origin: str) -> None:
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
            f"{origin}: the excitation reaches {peak:g} {unit}, limit {limit:g} {unit} "
            f"(rig: axes.{experiment.axis}.{keys}); reduce its amplitude"
        )
