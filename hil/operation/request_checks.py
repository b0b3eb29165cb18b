"""Checks of requests that take long, such as that of a controller. They are made before the loop gets it.

The server makes them in a thread, so that a stop need not wait for the controllers of other clients.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

from hil.core.check_names import check_overrides
from hil.core.controller_change import PreparedController, prepare_controller
from hil.core.errors import DocumentError, SetpointError
from hil.core.requests import ControllerRequest, SetpointRequest
from hil.core.rig import read_rig
from hil.core.setpoint_change import MAX_TABLE_CHARACTERS, PreparedSetpoint, prepare_setpoint
from hil.core.suggestions import did_you_mean
from hil.operation.pipe import Facts
from hil.operation.protocol import (
    ArmCall,
    AxisSetpoint,
    ControllerCall,
    EventCall,
    SetpointCall,
    SetpointsCall,
)

CheckedCall = ArmCall | EventCall | ControllerCall | SetpointCall | SetpointsCall
Checked = PreparedController | tuple[PreparedSetpoint, ...] | None
"""What was read for a request: a controller, or the tables of its setpoints."""


class RequestChecks:
    """The checks of requests for the rig that ``facts`` describe."""

    def __init__(self, facts: Facts) -> None:
        self._facts = facts
        self._rig = read_rig(facts.rig, "rig.toml")

    def check(self, call: CheckedCall) -> Checked:
        """Check what takes long to check, and return a controller or the tables that were read.

        Raises HilError.
        """
        match call:
            case ArmCall():
                check_overrides(call.override, self._rig)
            case EventCall():
                self._check_event(call.text)
            case ControllerCall():
                self._check_axis(call.axis)
                request = ControllerRequest(call.axis, call.name, call.document)
                controller = prepare_controller(request, self._rig)
                if controller.refusal:
                    raise DocumentError(f"controller refused: {controller.refusal}")
                return controller
            case SetpointCall():
                return self._tables([call])
            case SetpointsCall():
                _check_together(call.setpoints)
                return self._tables(call.setpoints)
        return None

    def _tables(self, setpoints: Sequence[SetpointCall | AxisSetpoint]) -> tuple[PreparedSetpoint, ...]:
        """Return the tables of setpoints, read and checked. Raises HilError."""
        tables: list[PreparedSetpoint] = []
        for one in setpoints:
            self._check_axis(one.axis)
            table = prepare_setpoint(SetpointRequest(one.axis, one.setpoint, one.table), self._rig)
            if table is not None and table.refusal:
                raise SetpointError(f"setpoint refused: {table.refusal}")
            tables += [] if table is None else [table]
        return tuple(tables)

    def _check_axis(self, name: str) -> None:
        """Check that the rig has an axis. Raises DocumentError."""
        axes = self._rig.axes
        if name not in axes:
            raise DocumentError(
                f"there is no axis {name!r}: the axes of the rig are {', '.join(axes)}"
                f"{did_you_mean(name, axes)}"
            )

    def _check_event(self, text: str) -> None:
        if self._facts.event_check is None:
            raise DocumentError(
                f"event {text!r}: only simulated boards have events; this daemon is on {self._facts.bus}"
            )
        module, _, function = self._facts.event_check.partition(":")
        getattr(import_module(module), function)(text, self._rig)


def _check_together(setpoints: Sequence[AxisSetpoint]) -> None:
    """Check that the setpoints of a request are for different axes and fit into a message.

    Raises SetpointError.
    """
    axes = [one.axis for one in setpoints]
    for place, axis in enumerate(axes):
        if axis in axes[:place]:
            raise SetpointError(f"setpoint refused: {axis} is given twice; give one setpoint for each axis")
    characters = sum(len(one.table) for one in setpoints)
    if characters > MAX_TABLE_CHARACTERS:
        raise SetpointError(
            f"setpoint refused: the tables have {characters} characters together, limit "
            f"{MAX_TABLE_CHARACTERS}; leave out rows, because straight lines connect them"
        )
