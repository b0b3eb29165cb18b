"""A period of the loop as bytes, which the loop writes and a reader takes as an array."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from itertools import chain

import numpy as np
import numpy.typing as npt

from hil.core.output import AxisSignals, Cycle

_INSTANTS = ("number", "deadline_ns", "wake_ns", "receive_ns", "computed_ns", "sent_ns")
_HEAD = "6qBB6x"
"""``_INSTANTS``, state and fresh."""
_AXIS = "6dB7x"
"""The fields of ``AxisSignals``."""

Pack = Callable[[Cycle, int, int], bytes]
Periods = npt.NDArray[np.void]


def period_bytes(axes: int) -> int:
    """Return the size of a period in bytes."""
    return struct.calcsize(_format(axes))


def period_format() -> list[str]:
    """Return names and types of the fields of a period with one axis."""
    return [*_INSTANTS, *Cycle._fields, *AxisSignals._fields, _format(1)]


def packer(axes: int) -> Pack:
    """Return a function that packs a period, when its answer was computed, and when it had been sent."""
    pack = struct.Struct(_format(axes)).pack

    def pack_period(cycle: Cycle, computed_ns: int, sent_ns: int) -> bytes:
        number, deadline_ns, wake_ns, receive_ns, state, fresh, signals = cycle
        values = chain.from_iterable(signals)
        return pack(
            number, deadline_ns, wake_ns, receive_ns, computed_ns, sent_ns, state, fresh, *values
        )  # fmt: skip

    return pack_period


def unpack_periods(messages: Sequence[bytes], axes: int) -> Periods:
    """Return an array with one element for each period.

    Its fields are those of ``Cycle``, ``computed_ns`` and ``sent_ns`` (monotonic time). The field ``axes``
    has a column for each axis, with the fields of ``AxisSignals``.
    """
    return np.frombuffer(b"".join(messages), _dtype(axes))


def _format(axes: int) -> str:
    return f"<{_HEAD}{_AXIS * axes}"


def _dtype(axes: int) -> np.dtype[np.void]:
    *doubles, phase = AxisSignals._fields
    signals = [*((name, "<f8") for name in doubles), (phase, "u1"), ("padding", "V7")]
    instants = [(name, "<i8") for name in _INSTANTS]
    head = [*instants, ("state", "u1"), ("fresh", "?"), ("padding", "V6")]
    return np.dtype([*head, ("axes", np.dtype(signals), (axes,))])
