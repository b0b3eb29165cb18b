"""The protocol between the daemon and its clients, version 1: JSON lines over a Unix-domain socket.

The daemon sends a greeting when a client connects::

    {"protocol": "hil-operation", "version": 1, "hil": "0.2.0"}

A client sends one request in a line. The daemon answers the requests of a connection in their order, each
with one line that repeats the request's ``id``::

    {"request": "setpoint", "id": 7, "axis": "vertical", "setpoint": "step:0.05@0"}
    {"id": 7, "accepted": true, "text": "vertical: setpoint step:0.05@0"}

``text`` says what happened, or why the request was refused. Requests and their keys:

================  =============================  ==========================================================
request           keys besides ``id``            effect
================  =============================  ==========================================================
``status``                                       the answer has the key ``status``, see :class:`Status`
``rig``                                          the answer's ``text`` is that of the rig file that the daemon
                                                 uses
``watch``         ``interval_s`` (0.05 to 60)    from now on, the connection only sends :class:`Update` lines
``arm``           ``override`` (optional)        ready -> armed, unless a check fails that is not in the list
                                                 ``override``
``disarm``                                       armed -> ready
``start``                                        armed -> running: the controllers move the valves
``stop``                                         running -> armed: the valves are centred
``reset``                                        fault -> offline
``setpoint``      ``axis``, ``setpoint``,        changes the setpoint; its time 0 is now. ``table`` is the
                  ``table`` (optional)           text of the file that a setpoint ``csv:FILE`` names
``setpoints``     ``setpoints``: a list of       changes the setpoints of several axes in one period, or none
                  objects with the keys of       of them if one is refused
                  ``setpoint``
``controller``    ``axis``, ``name``,            changes the controller; ``document`` is the text of a
                  ``document``,                  controller file, ``name`` is its name in messages. With
                  ``only_check`` (optional)      ``only_check``, it is checked and nothing is changed
``jog``           ``axis``, ``offset_v``,        moves one axis with a constant valve voltage, then centres
                  ``duration_s``                 its valve
``event``         ``text``                       something happens to the simulated arm now
``record new``                                   closes the recording and begins another
``record stop``                                  closes the recording; the loop goes on without one
``shutdown``                                     centres the valves, closes the recording, ends the daemon
================  =============================  ==========================================================

Numbers that are not finite are null in :class:`Status`: no sample has come yet. Later versions of the program
may add keys to answers, which a client ignores. A request with an unknown key is refused.

Limits: a line has at most ``MAX_LINE_BYTES`` bytes. ``MAX_CONNECTIONS`` clients are served at a time. If more
connect, the process with the most connections loses the one that was idle for longest. A connection is read
at ``MAX_REQUESTS_PER_S`` on average. A client that does not read what it asked for is disconnected after
``WRITE_TIMEOUT_S``, and so is one that sends a line which is no JSON object. A request with a wrong key or
value is refused, and the connection goes on. The socket file has mode 0600, and the daemon serves only its
own user and root.
"""

from __future__ import annotations

from typing import Annotated, Any, get_args

import msgspec

from hil.core.document_keys import key_problems
from hil.core.document_words import validation_problem

PROTOCOL = "hil-operation"
VERSION = 1
MAX_LINE_BYTES = 128 * 1024
"""Largest line in bytes, either way. A controller of 50 states needs less."""
MAX_CONNECTIONS = 16
"""Number of clients that are served at the same time."""
MAX_REQUESTS_PER_S = 200.0
"""Average rate at which requests of one connection are read."""
WRITE_TIMEOUT_S = 5.0
"""Time after which a client that reads nothing is disconnected."""
MAX_OVERRIDES = 32
"""Number of checks that one request to arm can override."""
MAX_SETPOINTS = 16
"""Number of setpoints that one request can give."""
MAX_ID = 2**53
"""Largest ``id`` of a request: every whole number up to it is one in JavaScript."""
MAX_PROBLEM_CHARACTERS = 1024
"""Longest text that says what is wrong with a request; a longer one is cut off."""
ALREADY_SHUTTING_DOWN = "the daemon is already shutting down"
"""Answer to ``shutdown`` while the daemon ends."""

AxisName = Annotated[str, msgspec.Meta(min_length=1, max_length=64)]
ShortText = Annotated[str, msgspec.Meta(min_length=1, max_length=1024)]
_Id = Annotated[int, msgspec.Meta(ge=0, le=MAX_ID)]


class Call(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="request", kw_only=True):
    """A request of a client. ``id`` is chosen by the client and repeated in the answer."""

    id: _Id = 0


class StatusCall(Call, frozen=True, tag="status"):
    """Ask for the status."""


class RigCall(Call, frozen=True, tag="rig"):
    """Ask for the text of the rig file that the daemon uses."""


class WatchCall(Call, frozen=True, tag="watch"):
    """Ask for an :class:`Update` every ``interval_s`` seconds."""

    interval_s: Annotated[float, msgspec.Meta(ge=0.05, le=60.0)] = 0.2


class ArmCall(Call, frozen=True, tag="arm", omit_defaults=True):
    """Allow motion."""

    override: Annotated[tuple[ShortText, ...], msgspec.Meta(max_length=MAX_OVERRIDES)] = ()
    """Names of checks that do not keep the daemon from arming if they fail."""


class DisarmCall(Call, frozen=True, tag="disarm"):
    """Forbid motion."""


class StartCall(Call, frozen=True, tag="start"):
    """Begin to control."""


class StopCall(Call, frozen=True, tag="stop"):
    """Stop controlling and centre the valves."""


class ResetCall(Call, frozen=True, tag="reset"):
    """Leave state fault."""


class SetpointCall(Call, frozen=True, tag="setpoint", omit_defaults=True):
    """Change the setpoint of an axis."""

    axis: AxisName
    setpoint: ShortText
    """Setpoint as in a rig file, such as ``step:0.05@0``, or a number."""
    table: str = ""
    """Text of the file that a setpoint ``csv:FILE`` names."""


class AxisSetpoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The setpoint of one axis in a request for several."""

    axis: AxisName
    setpoint: ShortText
    """Setpoint as in a rig file, such as ``step:0.05@0``, or a number."""
    table: str = ""
    """Text of the file that a setpoint ``csv:FILE`` names."""


class SetpointsCall(Call, frozen=True, tag="setpoints"):
    """Change the setpoints of several axes in one period, or none of them if one is refused."""

    setpoints: Annotated[tuple[AxisSetpoint, ...], msgspec.Meta(min_length=1, max_length=MAX_SETPOINTS)]


class ControllerCall(Call, frozen=True, tag="controller", omit_defaults=True):
    """Change the controller of an axis."""

    axis: AxisName
    name: ShortText
    """Name of the controller file, for messages."""
    document: str
    """Text of the controller file."""
    only_check: bool = False
    """True to be answered whether the controller fits the axis, without a change."""


class JogCall(Call, frozen=True, tag="jog"):
    """Move one axis with a constant valve voltage for a short time."""

    axis: AxisName
    offset_v: float
    """Valve voltage in volts, relative to the valve's centre."""
    duration_s: Annotated[float, msgspec.Meta(gt=0.0)]
    """Time after which the valve is centred, in seconds."""


class EventCall(Call, frozen=True, tag="event"):
    """Let something happen to the simulated arm."""

    text: ShortText
    """The event without a time, such as ``payload:3``."""


class RecordNewCall(Call, frozen=True, tag="record new"):
    """Close the recording and begin another."""


class RecordStopCall(Call, frozen=True, tag="record stop"):
    """Close the recording."""


class ShutdownCall(Call, frozen=True, tag="shutdown"):
    """End the daemon."""


LoopCall = (
    ArmCall
    | DisarmCall
    | StartCall
    | StopCall
    | ResetCall
    | SetpointCall
    | SetpointsCall
    | ControllerCall
    | JogCall
    | EventCall
    | RecordNewCall
    | RecordStopCall
    | ShutdownCall
)
"""Requests that the loop takes. The socket process answers the others itself."""
AnyCall = StatusCall | RigCall | WatchCall | LoopCall
"""Every request."""


class LogLine(msgspec.Struct, frozen=True):
    """A log entry with its time."""

    time_ns: int
    """Time of the entry, in nanoseconds since 1970."""
    severity: int
    """20 information, 30 warning, 40 error, 50 fault."""
    source: str
    text: str


class AxisStatus(msgspec.Struct, frozen=True):
    """Signals of one axis in the last period. None stands for a number that is not known yet."""

    name: str
    unit: str
    """Unit of setpoint, position and error: m or rad."""
    setpoint: float | None
    position: float | None
    error: float | None
    """Control error, setpoint minus position."""
    output_v: float | None
    """Output of the controller in volts, before the limits."""
    command_v: float | None
    """Commanded valve voltage in volts."""
    potentiometer_v: float | None = None
    """Potentiometer voltage in volts that the position was computed from."""


class Status(msgspec.Struct, frozen=True):
    """State of the daemon at the end of a period."""

    state: str
    """State of the life cycle: offline, ready, armed, running, fault."""
    fault: str | None
    """Source and reason of the fault in state fault."""
    readiness: str
    """What is known about the boards and their samples."""
    bus: str
    is_simulated: bool
    """True if the boards are simulated and were started by the daemon."""
    period: int
    """Number of the period."""
    period_s: float
    """Sample time of the loop in seconds."""
    time_ns: int
    """Time of this status, in nanoseconds since 1970."""
    max_lateness_ms: float
    """Largest delay of a period's begin in the last 0.1 s, in milliseconds."""
    missed_periods: int
    """Number of periods since the start that were skipped, or sent no SYNC, because the loop was late."""
    rejected_frames: int
    """Number of samples, heartbeats and emergency messages since the start that a check has rejected."""
    lost_samples: int
    """Number of samples since the start that were lost on their way, by the ADC board's counter."""
    recording: str | None
    """Path of the recording, or None if nothing is recorded."""
    axes: tuple[AxisStatus, ...]
    """Signals of every axis, in the order of the rig file."""
    max_lateness_since_start_ms: float = 0.0
    """Largest delay of a period's begin since the start, in milliseconds."""
    calibrated_axis: str | None = None
    """Axis whose limits are wide because it is being calibrated. Controllers do not start then."""
    overridden_checks: tuple[str, ...] = ()
    """Failed checks that an operator has overridden to arm."""
    sample_age_s: float | None = None
    """Time since the last good sample, of which the signals are, in seconds; None before the first one."""
    log: tuple[LogLine, ...] = ()
    """Log entries since the last status of the same watch; empty in the answer to ``status``."""


class Greeting(msgspec.Struct, frozen=True):
    """First line on a connection."""

    protocol: str
    version: int
    hil: str
    """Version of the daemon's program."""


class Answer(msgspec.Struct, frozen=True, omit_defaults=True, kw_only=True):
    """Answer to a request. A line that is no JSON object is answered with ``id`` 0."""

    id: int
    accepted: bool
    text: str
    """What happened, or why not."""
    status: Status | None = None


class Update(msgspec.Struct, frozen=True):
    """Line of a watching connection."""

    status: Status


def encode_line(message: msgspec.Struct) -> bytes:
    """Return the line of a message, with its line end."""
    return msgspec.json.encode(message) + b"\n"


_DECODER: msgspec.json.Decoder[AnyCall] = msgspec.json.Decoder(AnyCall)
_NAMES = [kind.__struct_config__.tag for kind in get_args(AnyCall)]


class WrongRequestError(ValueError):
    """A JSON object has a key or a value that no request has. The message says which."""

    def __init__(self, text: str, call_id: int) -> None:
        super().__init__(text)
        self.call_id = call_id
        """The request's ``id``, or 0 if it has none."""


def decode_call(line: bytes) -> AnyCall:
    """Return the request in a line.

    Raises WrongRequestError for a wrong key or value, and ValueError if the line is no JSON object.
    """
    try:
        try:
            return _DECODER.decode(line)
        except msgspec.ValidationError as error:
            plain, message = msgspec.json.decode(line), str(error)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if not isinstance(plain, dict):
        raise ValueError("it is no JSON object")
    raise _wrong_request(plain, message)


def _wrong_request(plain: dict[str, Any], message: str) -> WrongRequestError:
    """Return the error for an object of which msgspec says ``message``."""
    problems = key_problems(plain, AnyCall) or [validation_problem(message, plain, AnyCall)]
    name = plain.get("request")
    refused = f"{name} refused: " if name in _NAMES else ""
    text = refused + "; ".join(problem.removesuffix(".") for problem in problems)
    given = plain.get("id")
    call_id = given if type(given) is int and 0 <= given <= MAX_ID else 0
    return WrongRequestError(text[:MAX_PROBLEM_CHARACTERS], call_id)
