"""Operators' requests as the texts of ``/gateway/operator``.

A trigger of the run's own plan is its bare value, such as ``start``. Every other request is a JSON object:

    {"request": "setpoint", "axis": "vertical", "setpoint": "step:0.1@0", "asked_by": "uid 1000, pid 4711"}

``request`` is the value of a trigger, or ``setpoint``, ``controller`` or ``jog``; the other keys are the
fields of the request, without those that have their default. The trigger ``arm`` has the keys ``failures``
and ``overrides`` if a check before arming has failed or is overridden. ``asked_by`` says who asked, as the
shell that took the request knows it.
"""

from __future__ import annotations

import json
from typing import Any

import msgspec

from hil.core.life_cycle import Trigger
from hil.core.printable import printable
from hil.core.requests import ArmRequest, ControllerRequest, JogRequest, Request, SetpointRequest

_KINDS: dict[str, type[ArmRequest | SetpointRequest | ControllerRequest | JogRequest]] = {
    "arm": ArmRequest,
    "setpoint": SetpointRequest,
    "controller": ControllerRequest,
    "jog": JogRequest,
}
_NAMES = {kind: name for name, kind in _KINDS.items()}


def request_text(request: Request, asked_by: str) -> str:
    """Return the text of a request. A bare trigger is written as in runs without an operator."""
    if isinstance(request, Trigger):
        if not asked_by:
            return request.value
        fields: dict[str, Any] = {"request": request.value}
    else:
        defaults = request._field_defaults
        given = {name: value for name, value in request._asdict().items() if value != defaults.get(name)}
        fields = {"request": _NAMES[type(request)], **given}
    return json.dumps(fields | {"asked_by": asked_by})


def read_request(text: str) -> tuple[Request, str]:
    """Return the request of a text, and who asked. Raises ValueError if it is none."""
    if not text.startswith("{"):
        return _trigger(text), ""
    fields = json.loads(text)
    name, asked_by = fields.pop("request", ""), fields.pop("asked_by", "")
    kind = _KINDS.get(name)
    if kind is None or (kind is ArmRequest and not fields):
        return _trigger(name), str(asked_by)
    try:
        fields = kind._field_defaults | fields
        if fields.keys() != set(kind._fields):
            raise msgspec.ValidationError(f"it must have the keys {', '.join(kind._fields)}")
        return msgspec.convert([fields[key] for key in kind._fields], kind), str(asked_by)
    except msgspec.ValidationError as error:
        raise ValueError(f"{text!r} is not a request of the kind {name}: {error}") from None


def describe_request(request: Request) -> str:
    """Return a request in words for the log. What its author has written cannot act on a terminal."""
    return printable(_in_words(request))


def _in_words(request: Request) -> str:
    match request:
        case SetpointRequest(axis, setpoint, _):
            return f"setpoint of {axis}: {setpoint}"
        case ControllerRequest(axis, name, _):
            return f"controller of {axis}: {name}"
        case ArmRequest(_, overrides):
            return f"arm, overriding {', '.join(overrides)}" if overrides else "arm"
        case JogRequest(axis, offset_v, duration_s):
            return f"jog {axis} by {offset_v:+g} V for {duration_s:g} s"
    return request.value


def _trigger(text: str) -> Trigger:
    try:
        return Trigger(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a command of the operator") from None
