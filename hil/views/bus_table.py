"""The picture of a :class:`~hil.views.bus_watch.Status` for a terminal of 80 columns."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hil.views.bus_watch import Axis, Board, Status

_STATE_STYLES = {"operational": "green", "silent": "red", "stopped": "red"}
_MAX_SHOWN_UNKNOWN = 8
_NONE = "–"


def bus_table(name: str, status: Status, elapsed_s: float, unreadable: int, dropped: int) -> RenderableType:
    """Return the picture. ``name`` is the bus; the link counts ``unreadable`` and ``dropped`` frames."""
    bus = status.bus
    title = Text.assemble(
        (name, "bold"), f"   {bus.bit_rate / 1000:g} kbit/s   load {100 * bus.load:.1f} %   "
    )
    title.append(f"{bus.frames_per_s:.0f} frames/s   {elapsed_s:.0f} s")
    faults = Text()
    for label, count in (
        ("error frames", bus.error_frames),
        ("unreadable", unreadable),
        ("dropped", dropped),
        ("lost samples", status.samples.lost),
        ("damaged samples", status.samples.damaged),
    ):
        faults.append(f"{label} {count}   ", style="yellow" if count else "dim")
    parts: list[RenderableType] = [title, faults, _nodes(status), _axes(status.axes)]
    if bus.last_error_frame:
        parts.append(Text(f"last error frame {bus.last_error_frame}", style="yellow"))
    if status.unknown:
        shown = [f"{identifier} ×{count}" for identifier, count in status.unknown.items()]
        more = f" and {len(shown) - _MAX_SHOWN_UNKNOWN} more" if len(shown) > _MAX_SHOWN_UNKNOWN else ""
        parts.append(Text(f"not in arm.dbc: {', '.join(shown[:_MAX_SHOWN_UNKNOWN])}{more}"))
    parts += [Text(hint, style="yellow") for hint in status.hints]
    return Group(*parts)


def _nodes(status: Status) -> Table:
    table = Table(box=None, pad_edge=False, show_header=False, padding=(0, 3, 0, 0))
    gateway, samples = status.gateway, status.samples
    table.add_row(
        "gateway 0x01",
        _state(gateway.state),
        f"SYNC {gateway.sync_per_s:.0f}/s   commands {gateway.commands_per_s:.0f}/s",
    )
    if status.own_sync_per_s:
        table.add_row("this program", "", f"SYNC {status.own_sync_per_s:.0f}/s")
    counter = _NONE if samples.counter is None else str(samples.counter)
    for name, board in status.boards.items():
        is_adc = name == "adc"
        does = f"samples {samples.per_s:.0f}/s   counter {counter}" if is_adc else ""
        table.add_row(f"{name.upper()} 0x{board.node_id:02X}", _state(board.state), does)
        if board.emergencies:
            table.add_row("", Text("EMCY", style="yellow"), _emergency(board))
    return table


def _state(state: str) -> Text:
    return Text(state, style=_STATE_STYLES.get(state, "yellow"), no_wrap=True)


def _emergency(board: Board) -> Text:
    return Text(f"{board.emergencies} so far, last {board.last_emergency}", style="yellow")


def _axes(axes: dict[str, Axis]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("axis")
    for column in ("potentiometer", "position", "speed", "valve"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("")
    for name, axis in axes.items():
        table.add_row(
            name,
            _number(axis.potentiometer_v, "6.3f", "V"),
            _number(axis.position, "+8.4f", axis.unit),
            _number(axis.speed, "+8.4f", f"{axis.unit}/s"),
            _number(axis.valve_v, "6.3f", "V"),
            Text("" if axis.is_in_range else "out of range", style="red"),
        )
    return table


def _number(value: float | None, form: str, unit: str) -> str:
    return f"{_NONE:>6} {unit}" if value is None else f"{value:{form}} {unit}"
