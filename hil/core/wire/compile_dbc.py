"""Compile ``arm.dbc`` into ``codec.py``: ``python -m hil.core.wire.compile_dbc`` (needs the extra ``test``).

This is a development tool. The gateway imports only its result. Every message becomes an identifier, a
length, a NamedTuple of its signals in physical units, and a decode and an encode function around one
precompiled ``struct.Struct``. Signals must be whole little-endian bytes without gaps, as in every frame of
this bus. Any other layout is refused.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
FORMATS = {(8, False): "B", (16, False): "H", (16, True): "h", (32, False): "I"}
HEADER = '''"""Codec of every frame in ``arm.dbc``: identifiers, lengths, signals in physical units.

Written by ``python -m hil.core.wire.compile_dbc``; do not edit. Out-of-range values raise struct.error.
"""

from __future__ import annotations

from struct import Struct
from typing import NamedTuple
'''
MESSAGE = '''_{constant} = Struct("{format}")


class {kind}(NamedTuple):
    """Signals of a frame {constant}{unit}."""

    {fields}


def decode_{function}(data: bytes) -> {kind}:
    """Return the signals of a frame {constant}. ``data`` must have its full length."""
    {targets} = _{constant}.unpack(data)
    return {kind}({physical})


def encode_{function}({arguments}) -> bytes:
    """Return the data of a frame {constant}."""
    return _{constant}.pack({raw})

'''


def compile_dbc(path: Path) -> str:
    """Return the source of the codec for a DBC file. Raises ValueError for a layout that is not supported."""
    import cantools

    database: Any = cantools.database.load_file(str(path))
    return HEADER + "".join(_message(message) for message in database.messages)


def _message(message: Any) -> str:
    constant = message.name
    text = f"\n{constant} = 0x{message.frame_id:03X}\n{constant}_LENGTH = {message.length}\n"
    signals = sorted(message.signals, key=lambda signal: signal.start)
    if not signals:
        return text
    names = [_snake(signal.name) for signal in signals]
    typed = [
        f"{name}: {'int' if signal.scale == 1 else 'float'}"
        for name, signal in zip(names, signals, strict=True)
    ]
    return text + MESSAGE.format(
        constant=constant,
        format=_struct_format(message, signals),
        kind="".join(part.capitalize() for part in constant.split("_")),
        unit="".join(f", in {unit}" for unit in sorted({signal.unit for signal in signals if signal.unit})),
        fields="\n    ".join(typed),
        function=constant.lower(),
        targets=", ".join(names) + ("," if len(names) == 1 else ""),
        physical=", ".join(
            name if signal.scale == 1 else f"{name} * {signal.scale!r}"
            for name, signal in zip(names, signals, strict=True)
        ),
        arguments=", ".join(typed),
        raw=", ".join(
            name if signal.scale == 1 else f"round({name} / {signal.scale!r})"
            for name, signal in zip(names, signals, strict=True)
        ),
    )


def _struct_format(message: Any, signals: list[Any]) -> str:
    position, code = 0, "<"
    for signal in signals:
        kind = FORMATS.get((signal.length, signal.is_signed))
        if signal.byte_order != "little_endian" or signal.start != position or kind is None or signal.offset:
            raise ValueError(
                f"{message.name}.{signal.name}: only whole little-endian bytes without gaps or offset"
            )
        position += signal.length
        code += kind
    if position != 8 * message.length:
        raise ValueError(f"{message.name}: signals end at bit {position}, the frame at {8 * message.length}")
    return code


def _snake(name: str) -> str:
    return "".join(f"_{c.lower()}" if c.isupper() and i else c.lower() for i, c in enumerate(name))


if __name__ == "__main__":
    target = HERE / "codec.py"
    target.write_text(compile_dbc(HERE / "arm.dbc"))
    sys.stdout.write(f"{target} written; run `ruff format` on it\n")
