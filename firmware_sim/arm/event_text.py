"""Events of the arm as texts on a command line: ``payload:3@2``, ``stuck-spool:vertical@4``.

A text is ``NAME:VALUES@SECONDS``. NAME is the kind of event in a scenario file with hyphens in place of
spaces. VALUES are in the order of the file's keys, separated by commas; a value that the file may omit may be
omitted here.
"""

from __future__ import annotations

import re
from typing import Any, Final, get_args

import msgspec

from firmware_sim.arm.events import AnyEvent, Event
from hil.core.documents import from_plain
from hil.core.errors import DocumentError
from hil.core.suggestions import did_you_mean

FORM_OF: Final = {
    "payload": "payload:KG",
    "supply-pressure": "supply-pressure:GAUGE_KPA",
    "temperature": "temperature:CELSIUS",
    "friction": "friction:AXIS,FACTOR",
    "leak": "leak:AXIS,CHAMBER,M3_S_PA",
    "stuck-spool": "stuck-spool:AXIS",
    "broken-wire": "broken-wire:AXIS",
    "emergency-stop": "emergency-stop:pressed",
    "enable-switch": "enable-switch:released",
}
"""Form of each event without its time."""
FORMS: Final = (
    ", ".join(f"{form}@S" for form in FORM_OF.values())
    + " (emergency-stop:released@S and enable-switch:held@S close the contacts, stuck-spool:AXIS,false@S "
    "frees the spool, broken-wire:AXIS,false@S repairs the wire)"
)
"""Forms of all events with their times, for help texts and errors."""

_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_FORM: Final = re.compile(rf"(?P<name>[a-z-]+):(?P<values>[^@]+)@(?P<time>{_NUMBER})")
_KINDS: Final[dict[str, type[Event]]] = {
    str(kind.__struct_config__.tag).replace(" ", "-"): kind for kind in get_args(AnyEvent)
}


def parse_event(text: str, source: str = "") -> AnyEvent:
    """Return the event that a text describes. Raises DocumentError with the text, the value and its limit.

    ``source`` is where the text comes from, for errors; by default the option ``--event``.
    """
    source = source or f"--event {text!r}"
    match = _FORM.fullmatch(text)
    if match is None or match["name"] not in _KINDS:
        name = text.partition(":")[0]
        if name in _KINDS:
            form = f"{FORM_OF[name]}@S"
            raise DocumentError(f"{source}: not an event; write {form}, where S is its time in seconds")
        hint = did_you_mean(name, _KINDS)
        raise DocumentError(f"{source}: not an event{f'{hint} The' if hint else '; the'} forms are: {FORMS}")
    kind = _KINDS[match["name"]]
    fields = [field for field in msgspec.structs.fields(kind) if field.name != "at_s"]
    values = match["values"].split(",")
    if not sum(field.required for field in fields) <= len(values) <= len(fields):
        keys = ", ".join(field.name for field in fields)
        raise DocumentError(
            f"{source}: {match['name']} takes the values {keys}; {match['values']!r} has {len(values)}"
        )
    plain = {field.name: _value(value) for field, value in zip(fields, values, strict=False)}
    plain |= {"change": kind.__struct_config__.tag, "at_s": float(match["time"])}
    try:
        event: AnyEvent = from_plain(plain, kind, source)  # type: ignore[assignment]
    except DocumentError as error:
        raise DocumentError(f"{error}; the form is {FORM_OF[match['name']]}") from None
    return event


def event_text(event: AnyEvent) -> str:
    """Return the text of an event, from which :func:`parse_event` makes an equal event."""
    plain = msgspec.to_builtins(event)
    name, at_s = plain.pop("change").replace(" ", "-"), plain.pop("at_s")
    return f"{name}:{','.join(map(_text, plain.values()))}@{_text(at_s)}"


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value).removesuffix(".0")


def _value(text: str) -> Any:
    """Return the value that TOML would give; a string needs no quotation marks here."""
    if text in ("true", "false"):
        return text == "true"
    if re.fullmatch(r"[-+]?\d{1,18}", text):
        return int(text)
    return float(text) if re.fullmatch(_NUMBER, text) else text
