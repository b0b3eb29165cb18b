"""The CRC of protected frames in both versions of the wire, and the data identity of version 2."""

from __future__ import annotations

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import wire

from firmware_sim.boards.codec import RejectedPdoError, data_identity, decode_values, encode_values
from hil.core.wire import codec
from hil.core.wire.frame_crc import FrameCrc, frame_crc

PROTECTED = {
    "sample": codec.TPDO1_ADC,
    "command": codec.RPDO1_DAC,
    "read-back": codec.TPDO1_DAC,
    "inputs": codec.TPDO2_ADC,
}
PAIRS = list(combinations(PROTECTED, 2))
ANALOGUE = ["sample", "command", "read-back"]
bodies = st.binary(min_size=7, max_size=7)
identifiers = st.integers(1, 0x7FF)


@given(identifiers, st.binary(min_size=1, max_size=7))
def test_version_2_covers_the_low_and_the_high_byte_of_the_identifier(identifier: int, data: bytes) -> None:
    assert FrameCrc(identifier, 2).append(data) == wire.protected(identifier, data).data


@given(identifiers, st.binary(min_size=1, max_size=7))
def test_version_1_covers_the_data_alone(identifier: int, data: bytes) -> None:
    assert FrameCrc(identifier, 1).append(data) == data + bytes((wire.crc8(data),))


@given(
    st.sampled_from([1, 2]), identifiers, st.tuples(*[st.integers(-0x8000, 0x7FFF)] * 3), st.integers(0, 255)
)
def test_gateway_and_boards_agree(
    version: int, identifier: int, counts: tuple[int, int, int], counter: int
) -> None:
    from_board = encode_values(counts, counter, data_identity(identifier, version))
    crc = FrameCrc(identifier, version)
    assert crc.problem(from_board) is None
    assert crc.append(from_board[:7]) == from_board


@pytest.mark.parametrize(("sent", "received"), [*PAIRS, *((b, a) for a, b in PAIRS)])
@given(data=bodies)
def test_data_of_one_frame_are_wrong_under_the_identifier_of_another(
    sent: str, received: str, data: bytes
) -> None:
    frame = FrameCrc(PROTECTED[sent], 2).append(data)
    receiver = FrameCrc(PROTECTED[received], 2)
    assert not receiver.is_right(frame)
    problem = receiver.problem(frame)
    assert problem is not None and problem.startswith(f"CRC 0x{frame[7]:02X}, computed 0x")
    with pytest.raises(RejectedPdoError) as caught:
        decode_values(frame, True, data_identity(PROTECTED[received], 2))
    assert caught.value.reason == RejectedPdoError.CRC


@pytest.mark.parametrize("name", PROTECTED)
@given(data=bodies)
def test_the_versions_never_agree_on_a_frame_of_the_rig(name: str, data: bytes) -> None:
    one, two = FrameCrc(PROTECTED[name], 1), FrameCrc(PROTECTED[name], 2)
    assert not two.is_right(one.append(data))
    assert not one.is_right(two.append(data))
    assert two.other_version(one.append(data)) == 1
    assert one.other_version(two.append(data)) == 2


@pytest.mark.parametrize("name", PROTECTED)
def test_eight_of_2047_identifiers_share_the_crc_of_a_frame_of_the_rig(name: str) -> None:
    """A CRC of 8 bits cannot distinguish 2047 identifiers. SECURITY.md states the share."""
    frame = FrameCrc(PROTECTED[name], 2).append(bytes(7))
    same = [other for other in range(1, 0x800) if FrameCrc(other, 2).is_right(frame)]
    assert PROTECTED[name] in same
    assert len(same) == 8
    assert not set(same) & (set(PROTECTED.values()) - {PROTECTED[name]})


def test_the_problem_names_the_version_that_the_sender_speaks() -> None:
    frame = FrameCrc(codec.TPDO1_ADC, 1).append(bytes(7))
    problem = FrameCrc(codec.TPDO1_ADC, 2).problem(frame)
    computed = wire.frame_crc(codec.TPDO1_ADC, bytes(7))
    assert problem == (
        f"CRC 0x{frame[7]:02X}, computed 0x{computed:02X}; the sender speaks "
        "wire version 1, the rig file says 2: update the board, or write wire_version = 1 (rig: "
        "bus.wire_version)"
    )


def test_a_damaged_frame_names_no_version() -> None:
    frame = FrameCrc(codec.TPDO1_ADC, 2).append(bytes(7))
    damaged = bytes((1, *frame[1:]))
    assert FrameCrc(codec.TPDO1_ADC, 2).other_version(damaged) is None
    assert "version" not in (FrameCrc(codec.TPDO1_ADC, 2).problem(damaged) or "")


def test_modules_without_protection_have_no_crc_in_either_version() -> None:
    assert frame_crc(codec.RPDO1_DAC, 1, protected=False) is None
    assert frame_crc(codec.RPDO1_DAC, 2, protected=False) is None
    assert frame_crc(codec.RPDO1_DAC, 2, protected=True) is not None
