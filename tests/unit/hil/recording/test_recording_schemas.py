"""The layouts that are computed from the definitions, compared with the CDR of rosbags."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hil.recording.schemas import (
    AXIS_SIGNALS,
    CDR_HEADER,
    CYCLE,
    DEADLINE,
    FRAME,
    MessageType,
    cdr_string,
    layout_of,
)

STORE = get_typestore(Stores.EMPTY)
for kind in (FRAME, AXIS_SIGNALS, CYCLE, DEADLINE):
    STORE.register(get_types_from_msg(kind.definition, kind.name))
TYPES = STORE.types

reals = st.floats(allow_nan=False)
instants = st.integers(-(2**63), 2**63 - 1)


def packed(kind: MessageType, frame_id: str, *values: object) -> bytes:
    layout = layout_of(kind.definition, frame_id)
    data = struct.pack("<" + layout.format, CDR_HEADER, *values)
    assert len(data) == layout.size
    return data


def header(seconds: int, nanoseconds: int, frame_id: str) -> object:
    stamp = TYPES["builtin_interfaces/msg/Time"](seconds, nanoseconds)
    return TYPES["std_msgs/msg/Header"](stamp, frame_id)


@given(
    st.text(st.characters(min_codepoint=33, max_codepoint=0x7FF), max_size=12),
    st.integers(0, 2**31 - 1),
    st.integers(0, 999_999_999),
    st.integers(0, 2**29 - 1),
    st.booleans(),
    st.binary(max_size=8),
)
def test_frames_are_laid_out_as_cdr(
    bus: str, seconds: int, nanoseconds: int, identifier: int, flag: bool, data: bytes
) -> None:
    ours = packed(
        FRAME, bus, seconds, nanoseconds, cdr_string(bus), identifier, flag, not flag, flag, len(data), data
    )
    padded = np.frombuffer(data.ljust(8, b"\0"), np.uint8)
    message = TYPES[FRAME.name](
        header(seconds, nanoseconds, bus), identifier, flag, not flag, flag, len(data), padded
    )
    assert ours == bytes(STORE.serialize_cdr(message, FRAME.name))


@given(st.lists(reals, min_size=6, max_size=6), st.integers(0, 255), st.integers(0, 255), st.booleans())
def test_axis_signals_are_laid_out_as_cdr(values: list[float], phase: int, state: int, fresh: bool) -> None:
    ours = packed(AXIS_SIGNALS, "", 7, 8, cdr_string(""), *values, phase, state, fresh)
    message = TYPES[AXIS_SIGNALS.name](header(7, 8, ""), *values, phase, state, fresh)
    assert ours == bytes(STORE.serialize_cdr(message, AXIS_SIGNALS.name))


@given(st.lists(instants, min_size=6, max_size=6), st.integers(0, 255), st.booleans())
def test_cycles_are_laid_out_as_cdr(values: list[int], state: int, fresh: bool) -> None:
    message = TYPES[CYCLE.name](*values, state, fresh)
    assert packed(CYCLE, "", *values, state, fresh) == bytes(STORE.serialize_cdr(message, CYCLE.name))


@given(instants, instants)
def test_deadlines_are_laid_out_as_cdr(deadline_ns: int, now_ns: int) -> None:
    message = TYPES[DEADLINE.name](deadline_ns, now_ns)
    assert packed(DEADLINE, "", deadline_ns, now_ns) == bytes(STORE.serialize_cdr(message, DEADLINE.name))


def test_fields_are_named_by_their_path_and_constants_are_left_out() -> None:
    names = [field.name for field in layout_of(AXIS_SIGNALS.definition, "").fields]
    assert names[:3] == ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id"]
    assert names[-2:] == ["state", "fresh"]


@pytest.mark.parametrize("definition", ["uint8[] data\n", "float64[<=3] x\n", "geometry_msgs/Point p\n"])
def test_a_definition_without_a_fixed_size_is_refused(definition: str) -> None:
    with pytest.raises(ValueError, match="no fixed size"):
        layout_of(definition, "")
