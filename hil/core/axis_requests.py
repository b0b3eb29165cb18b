"""Checks of an operator's requests that change a setpoint or a controller, and the changes themselves."""

from __future__ import annotations

from hil.core.axis_loops import AxisLoops
from hil.core.control_law import ControlLaw, Matching
from hil.core.controller_change import PreparedController, digest_of, prepare_controller
from hil.core.errors import SetpointError
from hil.core.output import Output, answer
from hil.core.requests import ControllerRequest, JogRequest, Reply, SetpointRequest
from hil.core.rig import Rig
from hil.core.setpoint_change import PreparedSetpoint, read_request
from hil.core.suggestions import did_you_mean

SMALL_BUMP_V = 1e-6
"""Change of a valve voltage in V that is not reported: far below the 0.3 mV that a frame can carry."""
MAX_NAME = 200
"""Longest name of an axis or of a controller file in a request, in characters."""
Prepared = PreparedController | PreparedSetpoint
"""What another process has read and checked for a request."""
LOOP_NOT_CHECKED = "; the file holds no plant as numbers, so the closed loop was not checked"


class AxisRequests:
    """Requests about one axis, checked against the rig file and given to the axis' loop."""

    def __init__(self, rig: Rig, loops: AxisLoops) -> None:
        self._rig = rig
        self._loops = loops

    def refuse(self, request: SetpointRequest | ControllerRequest | JogRequest) -> Output | None:
        """Return the refusal of a request for an axis that cannot be operated, or None."""
        axes = self._rig.axes
        name = request.axis
        if name in axes:
            if not self._loops.is_excited(name):
                return None
            return answer(name, Reply(False, "refused: an experiment has this axis until the end of the run"))
        if len(name) > MAX_NAME:
            return answer("operator", Reply(False, f"refused: the axis has a name of {len(name)} characters"))
        text = f"refused: no axis {name!r}; the rig has {', '.join(axes)}{did_you_mean(name, axes)}"
        return answer("operator", Reply(False, text))

    def change(
        self,
        request: SetpointRequest | ControllerRequest,
        is_running: bool,
        prepared: Prepared | None,
    ) -> Output:
        """Change a setpoint or a controller, or refuse.

        ``is_running`` says whether the axis is under its controller. ``prepared`` is used if it belongs to
        this request.
        """
        refusal = self.refuse(request)
        if refusal is not None:
            return refusal
        if isinstance(request, SetpointRequest):
            table = prepared if isinstance(prepared, PreparedSetpoint) else None
            return answer(request.axis, self._change_setpoint(request, is_running, table))
        controller = prepared if isinstance(prepared, PreparedController) else None
        return answer(request.axis, self._change_controller(request, is_running, controller))

    def refuse_setpoint(self, request: SetpointRequest, prepared: PreparedSetpoint | None) -> Reply | None:
        """Return the refusal of a setpoint, or None if it can be given. Nothing is changed."""
        refusal = self.refuse(request)
        if refusal is not None:
            return refusal.reply
        try:
            read_request(request, self._rig, prepared)
        except SetpointError as error:
            return _refused_setpoint(error)
        return None

    def _change_setpoint(
        self, request: SetpointRequest, is_running: bool, prepared: PreparedSetpoint | None
    ) -> Reply:
        try:
            setpoint = read_request(request, self._rig, prepared)
        except SetpointError as error:
            return _refused_setpoint(error)
        self._loops.change_setpoint(request.axis, setpoint, is_running)
        axis = self._rig.axes[request.axis]
        limits, unit = axis.operator_limits, axis.unit
        when = "now" if is_running else "when control starts"
        return Reply(
            True,
            f"setpoint {request.setpoint}, approached {when} with at most {limits.max_speed:g} {unit}/s and "
            f"{limits.max_acceleration:g} {unit}/s^2",
        )

    def _change_controller(
        self, request: ControllerRequest, is_running: bool, prepared: PreparedController | None
    ) -> Reply:
        if len(request.name) > MAX_NAME or not request.name.isprintable():
            return Reply(
                False, f"controller refused: its name must have at most {MAX_NAME} printable characters"
            )
        if prepared is None or prepared.digest != digest_of(request, self._rig):
            prepared = prepare_controller(request, self._rig)
        if prepared.numbers is None:
            return Reply(False, f"controller refused: {prepared.refusal}")
        law = ControlLaw.of_numbers(prepared.numbers, self._rig.loop.period_s)
        matching = self._loops.change_law(request.axis, law, is_running)
        text = f"controller {request.name} {self._describe(request.axis, matching)}"
        return Reply(True, text if prepared.is_loop_checked else text + LOOP_NOT_CHECKED)

    def _describe(self, name: str, matching: Matching | None) -> str:
        """Return how a controller took over, with the size of a bump."""
        if matching is None:
            return "acts from the next start on"
        rate = (
            f"at most {self._rig.axes[name].valve.max_rate_v_s:g} V/s (rig: axes.{name}.valve.max_rate_v_s)"
        )
        if abs(matching.jump_v) > SMALL_BUMP_V:
            return (
                f"takes over with a bump of {matching.jump_v:+.4g} V, because it has no state that could be "
                f"matched; {rate}"
            )
        if abs(matching.drift_v) > SMALL_BUMP_V:
            time_constant_s = float(f"{matching.time_constant_s:.3g}")  # so that 1000 s has no exponent
            return (
                f"takes over at the last command; it has no integrator, so its output then moves by "
                f"{matching.drift_v:+.4g} V with a time constant of {time_constant_s:g} s, {rate}"
            )
        return "takes over at the last command, without a bump"


def _refused_setpoint(error: SetpointError) -> Reply:
    return Reply(False, f"setpoint refused: {error}")
