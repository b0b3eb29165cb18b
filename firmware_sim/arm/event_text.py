"""Changes on the arm as texts of a command line: ``payload:3@2``, ``stuck-spool:vertical@4``.

A text is the change's name in a scenario file, with hyphens for its spaces, then its values in the order of
the file's keys, then ``@`` and the seconds. What the file may leave out, the text may leave out.
"""

from __future__ import annotations

import re
from typing import Any, Final, get_args

import msgspec

from firmware_sim.arm.conditions import AnyChange, Change
from hil.core.documents import from_plain
from hil.core.errors import DocumentError

FORMS: Final = (
    "payload:KG@S, supply-pressure:KPA@S, temperature:CELSIUS@S, friction:AXIS,FACTOR@S, "
    "leak:AXIS,CHAMBER,M3_S_PA@S, stuck-spool:AXIS@S, broken-wire:AXIS@S "
    "(stuck-spool:AXIS,false@S loosens it, broken-wire:AXIS,false@S mends it)"
)

_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_FORM: Final = re.compile(rf"(?P<name>[a-z-]+):(?P<values>[^@]+)@(?P<time>{_NUMBER})")
_KINDS: Final[dict[str, type[Change]]] = {
    str(kind.__struct_config__.tag).replace(" ", "-"): kind for kind in get_args(AnyChange)
}


def parse_event(text: str) -> AnyChange:
    """The change that ``text`` describes. Raises DocumentError naming the text, the value and its limit."""
    source = f"--event {text!r}"
    match = _FORM.fullmatch(text)
    if match is None or match["name"] not in _KINDS:
        raise DocumentError(f"{source} is none of: {FORMS}")
    kind = _KINDS[match["name"]]
    fields = [field for field in msgspec.structs.fields(kind) if field.name != "at_s"]
    values = match["values"].split(",")
    if not sum(field.required for field in fields) <= len(values) <= len(fields):
        keys = ", ".join(field.name for field in fields)
        raise DocumentError(f"{source}: {match['name']} takes {keys}; {match['values']!r} does not fit")
    plain = {field.name: _value(value) for field, value in zip(fields, values, strict=False)}
    plain |= {"change": kind.__struct_config__.tag, "at_s": float(match["time"])}
    change: AnyChange = from_plain(plain, kind, source)  # type: ignore[assignment]
    return change


def event_text(change: AnyChange) -> str:
    """The text of ``change``, which :func:`parse_event` reads back."""
    plain = msgspec.to_builtins(change)
    name, at_s = plain.pop("change").replace(" ", "-"), plain.pop("at_s")
    return f"{name}:{','.join(map(_text, plain.values()))}@{_text(at_s)}"


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value).removesuffix(".0")


def _value(text: str) -> Any:
    """As TOML would have it, strings without quotation marks."""
    if text in ("true", "false"):
        return text == "true"
    if re.fullmatch(r"[-+]?\d{1,18}", text):
        return int(text)
    return float(text) if re.fullmatch(_NUMBER, text) else text
