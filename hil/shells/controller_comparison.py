"""What another controller would have commanded on the measurements of a recording.

The comparison is open loop: the recorded measurements do not react to the other controller. With the recorded
controller it gives the recorded commands. The laws and the limits are those of the gateway core.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.control_law import ControlLaw, check_law_runs
from hil.core.controller_file import ControllerFile, check_controller_fits
from hil.core.errors import DocumentError, RecordingError
from hil.core.rig import VOLTS_PER_COUNT, Rig
from hil.core.suggestions import did_you_mean
from hil.core.valve_commands import ValveCommands, command_crc
from hil.recording.reader import Recording
from hil.recording.tables import AxisTable
from hil.shells.replay import setup_of

FloatArray = npt.NDArray[np.float64]


class Comparison(NamedTuple):
    """The commands of two controllers of one axis on the same measurements."""

    axis: AxisTable
    """Recorded signals in the periods in which the controller acted on a good sample."""
    recorded_name: str
    other_name: str
    output_v: FloatArray
    """Output of the other controller before the limits, in V relative to the valve's centre voltage."""
    command_v: FloatArray
    """Valve voltage that the other controller would have commanded, after the limits, in V."""
    recorded_at_limit: npt.NDArray[np.bool_]
    """True where a limit of magnitude or rate changed the recorded command."""
    other_at_limit: npt.NDArray[np.bool_]
    """True where a limit would have changed the other controller's command."""

    @property
    def difference_v(self) -> FloatArray:
        """Command of the other controller minus the recorded command, in V."""
        return self.command_v - self.axis.command_v

    @property
    def largest_difference(self) -> tuple[float, float]:
        """Largest magnitude of the difference in V, and its time in seconds from the first period."""
        place = int(np.argmax(np.abs(self.difference_v)))
        return float(abs(self.difference_v[place])), float(self.axis.time_s[place])


def compare(recording: Recording, name: str, controller: ControllerFile, source: str) -> Comparison:
    """Run ``controller`` on the recorded setpoints and positions of the axis ``name``.

    ``source`` is the controller's file for errors. The controller takes over without a bump whenever the
    recorded one did. Raises RecordingError when the axis was not controlled, or was excited by an experiment,
    and DocumentError when the controller does not fit the axis.
    """
    setup = setup_of(recording)
    if name not in setup.rig.axes:
        raise RecordingError(
            f"{recording.path}: no axis {name!r}; the recording has {', '.join(setup.rig.axes)}"
            f"{did_you_mean(name, setup.rig.axes)}"
        )
    if setup.experiment is not None and setup.experiment.axis == name:
        raise RecordingError(
            f"{recording.path}: {name} was excited by an experiment, so its commands are not those of a "
            "controller alone; compare another axis"
        )
    axis = setup.rig.axes[name]
    check_controller_fits(controller, source, setup.rig.loop.period_s, axis.unit)
    check_law_runs(controller.law, controller.sample_time_s, source)
    table, received_ns, stretches = _controlled(recording, name)
    law = ControlLaw(controller.law, controller.sample_time_s)
    output_v, command_v = _commands(setup.rig, name, law, table, received_ns, stretches)
    if not np.all(np.isfinite(output_v)):
        raise DocumentError(f"{source}: law: gives an output that is not finite on the recorded measurements")
    centre_v = axis.valve.centre_v
    return Comparison(
        table,
        setup.controllers[name].name,
        controller.name,
        output_v,
        command_v,
        _at_limit(table.output_v, table.command_v, centre_v),
        _at_limit(output_v, command_v, centre_v),
    )


def _controlled(recording: Recording, name: str) -> tuple[AxisTable, list[int], list[int]]:
    """Return the controlled periods of an axis, the instants of their samples, and their stretches.

    A stretch is a number for each row: where it changes, the controllers were started again.
    """
    table, timing = recording.axis(name), recording.timing()
    if not np.array_equal(table.time_ns, timing.wake_ns):
        common = np.intersect1d(table.time_ns, timing.wake_ns)
        table = table[np.isin(table.time_ns, common)]
        timing = timing[np.isin(timing.wake_ns, common)]
    stretches = np.cumsum(np.diff(table.running, prepend=False))
    chosen = table.running & table.fresh & np.isfinite(table.output_v) & ~_jogged(table, stretches)
    if not chosen.any():
        raise RecordingError(f"{recording.path}: no controller acted in this recording; nothing to compare")
    return table[chosen], timing.receive_ns[chosen].tolist(), stretches[chosen].tolist()


def _jogged(table: AxisTable, stretches: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Return True for the periods in which an operator jogged the axis: its valve moved without an error."""
    stretch_count = int(stretches[-1]) + 1 if len(stretches) else 0
    has_error = np.zeros(stretch_count, np.bool_)
    has_error[stretches[table.error != 0.0]] = True
    has_output = np.zeros(stretch_count, np.bool_)
    has_output[stretches[table.output_v != 0.0]] = True
    return np.asarray(~has_error[stretches] & has_output[stretches])


def _commands(
    rig: Rig, name: str, law: ControlLaw, table: AxisTable, received_ns: list[int], stretches: list[int]
) -> tuple[FloatArray, FloatArray]:
    """Return the outputs and the commands of ``law``, as the core's loop computes them."""
    period_s = rig.loop.period_s
    valves = ValveCommands([rig.axes[name].valve], period_s, command_crc(rig))
    outputs_v, commands_v = [], []
    stretch = last_ns = -1
    rows = zip(table.setpoint.tolist(), table.position.tolist(), received_ns, stretches, strict=True)
    for r, y, now_ns, number in rows:
        elapsed_s = (now_ns - last_ns) / 1e9
        if number != stretch:
            stretch, elapsed_s = number, period_s
            valves.centre()
            law.initialise(r, y, 0.0)
        last_ns = now_ns
        valves.set_change_time(elapsed_s)
        u = law.output(r, y)
        if not math.isfinite(u):
            return np.full(len(table), math.nan), np.full(len(table), math.nan)
        law.advance(valves.command(0, u))
        outputs_v.append(u)
        commands_v.append(valves.volts[0])
    return np.array(outputs_v), np.array(commands_v)


def _at_limit(output_v: FloatArray, command_v: FloatArray, centre_v: float) -> npt.NDArray[np.bool_]:
    return np.asarray(np.abs(command_v - centre_v - output_v) > VOLTS_PER_COUNT / 2)
