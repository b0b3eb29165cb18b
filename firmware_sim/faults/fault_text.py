"""Faults as texts: ``lose:sample,5@2``, ``hang:adc@running+0.5``, ``unplug@vertical>0.05/0.3``.

A text is ``NAME[:VALUES]@WHEN[/FOR]``. NAME is the kind of fault in a scenario file with hyphens in place of
spaces. VALUES are in the order of the file's keys, separated by commas; a value that the file may omit may be
omitted here. WHEN is a time in seconds from the boards' first sample, or a condition, or both:
``CONDITION+SECONDS``. A condition is a state of the gateway's life cycle or a position of an axis
(:class:`firmware_sim.faults.kinds.Fault`). FOR is the duration in seconds. The name of an event of the arm
(``firmware_sim.arm.event_text``) is a fault too.
"""

from __future__ import annotations

import re
from typing import Any, Final, get_args

import msgspec

from firmware_sim.arm.event_text import FORM_OF as EVENT_FORM_OF
from firmware_sim.arm.event_text import event_text, parse_event
from firmware_sim.arm.events import AnyEvent
from firmware_sim.faults.condition import NUMBER, POSITION, RUNNING, STATES
from firmware_sim.faults.kinds import AnyFault, ArmFault, Fault
from hil.core.documents import from_plain
from hil.core.errors import DocumentError
from hil.core.suggestions import did_you_mean

_GROUPS: Final = {
    "frames": (
        "lose:FRAME[,AMOUNT]",
        "late:FRAME,S[,AMOUNT]",
        "repeat:FRAME[,AMOUNT]",
        "reorder:FRAME[,AMOUNT]",
        "corrupt:FRAME[,AMOUNT]",
        "alter:FRAME[,AMOUNT]",
        "miscount:FRAME,STEP[,AMOUNT]",
        "mislabel:FRAME,FRAME[,AMOUNT]",
        "foreign:FRAME,INTERVAL_S",
        "flood:ID,INTERVAL_S",
    ),
    "bus (error-frames in simulated time with a bit rate only)": (
        "bus-off",
        "unplug",
        "error-frames[:AMOUNT[,SENDER]]",
    ),
    "boards": ("reset:BOARD", "hang:BOARD", "babble:BOARD,INTERVAL_S", "twin:BOARD"),
    "sensors": (
        "freeze-sensor:AXIS",
        "drift-sensor:AXIS,V_PER_S",
        "noisy-sensor:AXIS,RMS_V",
        "offset-sensor:AXIS,V",
    ),
    "valves": ("stick-valve:AXIS", "slow-valve:AXIS,LAG_S"),
    "host, in simulated time only": ("stall:S", "step-clock:S"),
    "processes, in rigs of real processes only": ("kill:PROCESS", "pause:PROCESS", "fill-disk"),
}
"""Forms of the faults without their time, by what they act on."""
FORMS: Final = (
    "; ".join(f"{group}: {', '.join(forms)}" for group, forms in _GROUPS.items())
    + "; and every event of the arm"
)
"""Forms of all faults without their time, for help texts and errors."""
FORM_OF: Final = {
    re.split(r"[:\[]", form)[0]: form for forms in _GROUPS.values() for form in forms
} | EVENT_FORM_OF
"""Form of each fault and of each event of the arm, without its time."""
WHEN_FORMS: Final = (
    "@SECONDS, @STATE, @AXIS>POSITION, @AXIS<POSITION or @CONDITION+SECONDS, then optionally /DURATION_S; "
    f"STATE is {RUNNING} (a command moves a valve), {', '.join(STATES)}"
)

_CONDITION: Final = re.compile("|".join((RUNNING, *STATES, POSITION)))
_FORM: Final = re.compile(
    rf"(?P<name>[a-z-]+)(?::(?P<values>[^@]+))?"
    rf"@(?:(?P<at>{NUMBER})|(?P<when>{_CONDITION.pattern})(?:\+(?P<after>{NUMBER}))?)"
    rf"(?:/(?P<for>{NUMBER}))?"
)
_BASE_FIELDS: Final = frozenset(field.name for field in msgspec.structs.fields(Fault))
_KINDS: Final[dict[str, type[Fault]]] = {
    str(kind.__struct_config__.tag).replace(" ", "-"): kind
    for kind in get_args(AnyFault)
    if kind is not ArmFault
}
_EVENTS: Final = frozenset(str(kind.__struct_config__.tag).replace(" ", "-") for kind in get_args(AnyEvent))


FAULT_NAMES: Final = frozenset(_KINDS)
"""Names of the faults, without the events of the arm."""
_NAMES: Final = ", ".join(FORM_OF)


def parse_fault(text: str, source: str | None = None) -> AnyFault:
    """Return the fault that a text describes. ``source`` names the text in errors.

    Raises DocumentError with the text, the value and its limit.
    """
    source = source or f"--fault {text!r}"
    name = re.split("[:@/]", text)[0]
    if name not in FORM_OF:
        hint = did_you_mean(name, FORM_OF)
        raise DocumentError(f"{source}: there is no fault {name!r}{hint or '.'} The names are: {_NAMES}")
    match = _FORM.fullmatch(text)
    if match is None:
        raise DocumentError(f"{source}: {_problem(text)} Write {FORM_OF[name]} and its time, {WHEN_FORMS}")
    plain: dict[str, Any] = {"when": match["when"] or "", "at_s": float(match["at"] or match["after"] or 0)}
    if match["for"] is not None:
        plain["for_s"] = float(match["for"])
    if name in _EVENTS:
        if match["values"] is None:
            raise DocumentError(f"{source}: its values are missing; write {FORM_OF[name]}")
        event = parse_event(f"{name}:{match['values']}@0", source)
        return _convert({**plain, "fault": "arm", "event": msgspec.to_builtins(event)}, ArmFault, source)
    kind = _KINDS[name]
    fields = [field for field in msgspec.structs.fields(kind) if field.name not in _BASE_FIELDS]
    values = match["values"].split(",") if match["values"] else []
    if not sum(field.required for field in fields) <= len(values) <= len(fields):
        keys = ", ".join(field.name for field in fields) or "no values"
        raise DocumentError(
            f"{source}: {name} takes {keys}; {match['values'] or ''!r} has {len(values)}; "
            f"the form is {FORM_OF[name]}"
        )
    plain |= {field.name: _value(value) for field, value in zip(fields, values, strict=False)}
    try:
        return _convert({**plain, "fault": kind.__struct_config__.tag}, kind, source)
    except DocumentError as error:
        raise DocumentError(f"{error}; the form is {FORM_OF[name]}") from None


def _problem(text: str) -> str:
    """Return a sentence on what is wrong with the text of a known fault that :data:`_FORM` rejects."""
    head, at, moment = text.partition("@")
    if not at:
        return "its time is missing."
    if head.endswith(":"):
        return "its values are missing."
    when, slash, duration = moment.partition("/")
    if slash and re.fullmatch(NUMBER, duration) is None:
        return f"its duration {duration!r} is not a number of seconds."
    condition, plus, after = when.partition("+")
    if plus and _CONDITION.fullmatch(condition):
        return f"the time {after!r} after its condition is not a number of seconds."
    hint = did_you_mean(condition, (RUNNING, *STATES))
    return f"{when!r} is neither a time nor a condition{hint or '.'}"


def fault_text(fault: AnyFault) -> str:
    """Return the text of a fault, from which :func:`parse_fault` makes an equal fault."""
    plain = msgspec.to_builtins(fault)
    kind = plain.pop("fault")
    at_s, when, for_s = (plain.pop(key) for key in ("at_s", "when", "for_s"))
    if isinstance(fault, ArmFault):
        head = event_text(fault.event).partition("@")[0]
    else:
        values = ",".join(_values(fault, plain))
        head = kind.replace(" ", "-") + (f":{values}" if values else "")
    moment = f"{when}+{_text(at_s)}" if when and at_s else when or _text(at_s)
    return f"{head}@{moment}" + ("" if for_s is None else f"/{_text(for_s)}")


def _values(fault: AnyFault, plain: dict[str, Any]) -> list[str]:
    """Return the values of a fault as texts, without those at the end that have their default."""
    fields = [field for field in msgspec.structs.fields(fault) if field.name in plain]
    while fields and plain[fields[-1].name] == fields[-1].default:
        del fields[-1]
    return [_text(plain[field.name]) for field in fields]


def _convert(plain: dict[str, Any], kind: type[Fault], source: str) -> AnyFault:
    fault: AnyFault = from_plain(plain, kind, source)  # type: ignore[assignment]
    return fault


def _text(value: Any) -> str:
    return str(value).removesuffix(".0")


def _value(text: str) -> Any:
    """Return the value that TOML would give; a string needs no quotation marks here."""
    if re.fullmatch(r"[-+]?\d{1,18}|0x[0-9A-Fa-f]{1,8}", text):
        return int(text, 0) if text.startswith("0x") else int(text)
    return float(text) if re.fullmatch(NUMBER, text) else text
