"""Setpoints r(t) of one axis, written as texts such as ``step:0.1@1``. t is seconds since control began.

====================================  =================================================================
``step:SIZE@TIME``                    0, and SIZE from TIME on
``ladder:LEVEL,LEVEL,...@TIME/HOLD``  0, then each level for HOLD seconds; the last one stays
``ramp:SIZE@TIME/DURATION``           0, then in a straight line to SIZE within DURATION
``minimum-jerk:SIZE@TIME/DURATION``   as a ramp, along 10 t^3 - 15 t^4 + 6 t^5 (Flash and Hogan 1985)
``sine:AMPLITUDE@TIME/PERIOD``        0, and AMPLITUDE sin(2 pi (t - TIME)/PERIOD) from TIME on
``csv:FILE``                          columns time_s,setpoint; straight lines between the rows
``hold``                              the position at which the axis was when control began
``POSITION``                          a number alone: this position, from time 0 on
====================================  =================================================================

Sizes are in the axis' unit. Before the first row of a CSV file the first value holds, after the last row the
last one. Two rows with the same time are a step.
"""

from __future__ import annotations

import csv
import math
import re
from bisect import bisect_right
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import NamedTuple, Protocol

from hil.core.errors import SetpointError
from hil.core.suggestions import did_you_mean

FORMS = {
    "step": "step:SIZE@TIME",
    "ladder": "ladder:LEVEL,LEVEL,...@TIME/HOLD",
    "ramp": "ramp:SIZE@TIME/DURATION",
    "minimum-jerk": "minimum-jerk:SIZE@TIME/DURATION",
    "sine": "sine:AMPLITUDE@TIME/PERIOD",
    "csv": "csv:FILE",
    "hold": "hold",
}
"""How each kind of setpoint is written."""
EXAMPLE = "step:0.1@1"
EXAMPLE_POSITION = "0.05"
COLUMNS = ["time_s", "setpoint"]
"""Columns of a table of setpoints, in seconds and in the axis' unit."""
HOLD = "hold"
"""Setpoint of an axis that keeps the position at which it was when control began."""
MIN_SPAN_S = 0.001
"""Shortest hold, ramp or sine period in seconds: the shortest period of a loop."""
_NUMBER = r"[-+]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|nan|inf)"
_FORM = re.compile(
    rf"(?P<kind>step|ladder|ramp|minimum-jerk|sine):(?P<values>{_NUMBER}(?:,{_NUMBER})*)"
    rf"@(?P<start>{_NUMBER})(?:/(?P<span>{_NUMBER}))?"
)


class Function(Protocol):
    """A setpoint as a function of time."""

    def __call__(self, t: float, /) -> float:
        """Return r in the axis' unit at ``t`` seconds."""


class Setpoint(NamedTuple):
    """A setpoint as a function of time, and its range."""

    text: str
    """The text that it was read from."""
    at: Function
    """r in the axis' unit at t seconds."""
    min_r: float
    """Smallest value in the axis' unit."""
    max_r: float
    """Largest value in the axis' unit."""
    max_speed: float = 0.0
    """Largest speed between jumps, in the axis' unit per s. The jumps of a step are intended."""


def is_position(text: str) -> bool:
    """Return whether a setpoint is a number alone: a position that stays."""
    return re.fullmatch(_NUMBER, text) is not None and text.lstrip("-+")[0] not in "ni"


def csv_file(text: str) -> str | None:
    """Return the file that a ``csv:FILE`` setpoint names; None for every other setpoint."""
    return text.removeprefix("csv:") if text.startswith("csv:") else None


def parse_setpoint(text: str, csv_text: str = "") -> Setpoint:
    """Read a setpoint. ``csv_text`` is the content of the file that ``csv:FILE`` names.

    Raises SetpointError.
    """
    file = csv_file(text)
    if file is not None:
        return _from_csv(text, csv_text, file)
    if text == HOLD:
        return Setpoint(text, Constant(0.0), math.nan, math.nan)  # the loop puts its own position there
    if is_position(text):
        position = _finite(text, text)
        return Setpoint(text, Constant(position), position, position)
    match = _FORM.fullmatch(text)
    if match is None:
        raise SetpointError(_unreadable(text))
    for number in re.findall(_NUMBER, text.partition(":")[2]):
        _finite(number, text)
    kind = match["kind"]
    values = [float(value) for value in match["values"].split(",")]
    start = float(match["start"])
    if start < 0:
        raise SetpointError(f"setpoint {text!r}: TIME is {start:g} s, but must be 0 s or more")
    if kind != "ladder" and len(values) != 1:
        raise SetpointError(f"setpoint {text!r}: {kind} takes one size, not {len(values)}")
    if (match["span"] is None) != (kind == "step"):
        problem = "takes no /SECONDS" if kind == "step" else "lacks its /SECONDS"
        raise SetpointError(f"setpoint {text!r}: {kind} {problem}; write {FORMS[kind]}")
    span = float(match["span"] or 1.0)
    if span < MIN_SPAN_S:
        raise SetpointError(f"setpoint {text!r}: /{span:g} s must be {MIN_SPAN_S} s or more")
    at = _FUNCTIONS[kind](values, start, span)
    min_r, max_r = min(0.0, *values), max(0.0, *values)
    if kind == "sine":
        min_r, max_r = -abs(values[0]), abs(values[0])
    return Setpoint(text, at, min_r, max_r, abs(values[0]) * _PEAK_SPEEDS.get(kind, 0.0) / span)


def check_speed(setpoint: Setpoint, axis: str, max_speed: float, unit: str, key: str = "") -> None:
    """Refuse a setpoint that is faster than the axis may move. Raises SetpointError.

    ``key`` is the key of the limit in the rig file, by default that of the axis' envelope.
    """
    if setpoint.max_speed > max_speed:
        raise SetpointError(
            f"{axis}: setpoint {setpoint.text!r} moves at up to {setpoint.max_speed:.4g} {unit}/s, limit "
            f"{max_speed:g} {unit}/s (rig: {key or f'axes.{axis}.envelope.max_speed'}); give it more time, "
            "or use steps"
        )


def check_within(setpoint: Setpoint, axis: str, min_y: float, max_y: float, unit: str) -> None:
    """Refuse a setpoint that leaves the range of the axis. Raises SetpointError."""
    for value, limit, key, is_outside in (
        (setpoint.min_r, min_y, "min_y", setpoint.min_r < min_y),
        (setpoint.max_r, max_y, "max_y", setpoint.max_r > max_y),
    ):
        if is_outside:
            raise SetpointError(
                f"{axis}: setpoint {setpoint.text!r} reaches {value:g} {unit}, beyond {limit:g} {unit} "
                f"(rig: axes.{axis}.{key})"
            )


def _finite(number: str, text: str) -> float:
    """Return the value of a number in the setpoint ``text``. Raises SetpointError if it is not finite."""
    value = float(number)
    if not math.isfinite(value):
        raise SetpointError(f"setpoint {text!r}: {number} is not finite")
    return value


def _unreadable(text: str) -> str:
    """Return what is wrong with a text that has none of the forms, and how to write it."""
    kind, _, value = text.partition(":")
    if kind in FORMS:
        position = value if is_position(value) else EXAMPLE_POSITION
        return (
            f"setpoint {text!r} is not written as {FORMS[kind]}; an example is {EXAMPLE}; a position that "
            f"stays is a number alone, such as {position}"
        )
    return (
        f"setpoint {text!r} is neither a number, such as {EXAMPLE_POSITION}, nor one of "
        f"{', '.join(FORMS.values())}{did_you_mean(kind, FORMS)}"
    )


class Constant(NamedTuple):
    """A setpoint that does not change."""

    value: float

    def __call__(self, _t: float) -> float:
        """Return the value."""
        return self.value


class Step(NamedTuple):
    """A setpoint that is written as ``step:SIZE@TIME``."""

    size: float
    start: float

    def __call__(self, t: float) -> float:
        """Return r at ``t`` seconds."""
        return self.size if t >= self.start else 0.0


class Ladder(NamedTuple):
    """A setpoint that is written as ``ladder:LEVEL,LEVEL,...@TIME/HOLD``."""

    levels: tuple[float, ...]
    start: float
    hold: float

    def __call__(self, t: float) -> float:
        """Return r at ``t`` seconds."""
        if t < self.start:
            return 0.0
        # 1e-9 of a hold: a level begins in its own sample even if the quotient is rounded down.
        return self.levels[int(min((t - self.start) / self.hold + 1e-9, len(self.levels) - 1))]


class Ramp(NamedTuple):
    """A setpoint that is written as ``ramp:SIZE@TIME/DURATION``."""

    size: float
    start: float
    duration: float

    def __call__(self, t: float) -> float:
        """Return r at ``t`` seconds."""
        return self.size * min(max((t - self.start) / self.duration, 0.0), 1.0)


class MinimumJerk(NamedTuple):
    """A setpoint that is written as ``minimum-jerk:SIZE@TIME/DURATION``."""

    size: float
    start: float
    duration: float

    def __call__(self, t: float) -> float:
        """Return r at ``t`` seconds."""
        x = min(max((t - self.start) / self.duration, 0.0), 1.0)
        return self.size * (x * x * x * (10.0 - 15.0 * x + 6.0 * x * x))


class Sine(NamedTuple):
    """A setpoint that is written as ``sine:AMPLITUDE@TIME/PERIOD``."""

    amplitude: float
    start: float
    period: float

    def __call__(self, t: float) -> float:
        """Return r at ``t`` seconds."""
        if t < self.start:
            return 0.0
        return self.amplitude * math.sin(math.tau * (t - self.start) / self.period)


class Table(NamedTuple):
    """The rows of a CSV file: straight lines between the values at the times."""

    times: tuple[float, ...]
    values: tuple[float, ...]

    def __call__(self, t: float) -> float:
        """Return r at ``t`` seconds."""
        times, values = self.times, self.values
        after = bisect_right(times, t)
        if after == 0:
            return values[0]
        if after == len(times):
            return values[-1]
        share = (t - times[after - 1]) / (times[after] - times[after - 1])
        return values[after - 1] + share * (values[after] - values[after - 1])


_PEAK_SPEEDS = {"ramp": 1.0, "minimum-jerk": 1.875, "sine": math.tau}
"""Largest speed of a form of size 1 whose span is 1 s. Steps and ladders only jump."""

_FUNCTIONS: dict[str, Callable[[list[float], float, float], Function]] = {
    "step": lambda values, start, _: Step(values[0], start),
    "ladder": lambda values, start, span: Ladder(tuple(values), start, span),
    "ramp": lambda values, start, span: Ramp(values[0], start, span),
    "minimum-jerk": lambda values, start, span: MinimumJerk(values[0], start, span),
    "sine": lambda values, start, span: Sine(values[0], start, span),
}


def _from_csv(text: str, content: str, file: str) -> Setpoint:
    times: list[float] = []
    values: list[float] = []
    for row_number, row in enumerate(_rows(content, file), start=1):
        if not row or row[0].lstrip().startswith("#"):
            continue
        if not times and not any(map(_is_number, row)):
            _check_header(row, row_number, file)
            continue
        try:
            time_s, value = (float(cell) for cell in row)
        except ValueError:
            raise SetpointError(
                f"{file}: row {row_number}: {','.join(row)!r} is not time_s,setpoint"
            ) from None
        if not (math.isfinite(time_s) and math.isfinite(value)):
            raise SetpointError(f"{file}: row {row_number}: {','.join(row)!r} is not finite")
        if times and time_s < times[-1]:
            raise SetpointError(f"{file}: row {row_number}: time {time_s} s goes back from {times[-1]} s")
        times.append(time_s)
        values.append(value)
    if not times:
        raise SetpointError(f"{file}: no rows of time_s,setpoint")

    return table_setpoint(text, tuple(times), tuple(values))


def _check_header(row: list[str], row_number: int, file: str) -> None:
    """Check that the header names the columns that are read. Raises SetpointError."""
    if [cell.strip() for cell in row] != COLUMNS:
        raise SetpointError(
            f"{file}: row {row_number}: the header is {','.join(row)!r:.80}, but the columns must be "
            f"{','.join(COLUMNS)}, in this order; correct the header, or leave it out"
        )


def table_setpoint(text: str, times: tuple[float, ...], values: tuple[float, ...]) -> Setpoint:
    """Return the setpoint of a table that was read: one row or more, the times in ascending order."""
    slopes = [
        abs(after - before) / (end - start)
        for (start, before), (end, after) in pairwise(zip(times, values, strict=True))
        if end > start
    ]
    return Setpoint(text, Table(times, values), min(values), max(values), max(slopes, default=0.0))


def _rows(content: str, file: str) -> Iterator[list[str]]:
    try:
        yield from csv.reader(content.splitlines())
    except csv.Error as error:
        raise SetpointError(f"{file}: not a CSV file: {error}") from None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
