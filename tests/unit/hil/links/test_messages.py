"""Whatever arrives, a link returns nothing but sound frames and raises nothing."""

import os
import socket
from collections.abc import Callable, Iterator

import can
import msgpack
import pytest
from can.interfaces.udp_multicast.utils import pack_message
from hypothesis import given
from hypothesis import strategies as st
from support.lawicel_adapters import TwoAdapters
from support.link_contract import free_port

from hil.core.frames import Frame
from hil.links import Link, Received, open_link
from hil.links.messages import MAX_EXTENDED_ID, MAX_STANDARD_ID

WHOLE_LINES = [b"t19084000400040001A5", b"t710105", b"T1ABCDEF02AABB", b"r1230", b"R1ABCDEF00"]
ANY_LINE = st.one_of(
    st.binary(max_size=40),
    st.text("0123456789abcdefABCDEFtTrR+-_ .", max_size=30).map(str.encode),
    st.builds(
        lambda line, place, byte: line[:place] + byte + line[place + 1 :],
        st.sampled_from(WHOLE_LINES), st.integers(0, 20), st.binary(max_size=2),
    ),
)  # fmt: skip
ANYTHING = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**63), 2**64 - 1), st.floats(), st.text(max_size=4),
    st.binary(max_size=70), st.lists(st.integers(-1, 256), max_size=9),
)  # fmt: skip
MESSAGE_KEYS = [
    "arbitration_id", "is_extended_id", "is_remote_frame", "is_error_frame", "channel", "dlc", "data",
    "is_fd", "bitrate_switch", "error_state_indicator", "timestamp", "check", "is_rx",
]  # fmt: skip


def assert_sound(received: Received) -> None:
    """Check what the gateway relies on and a recording can hold."""
    frame = received.frame
    assert 0 <= frame.id <= (MAX_EXTENDED_ID if frame.is_extended or frame.is_error else MAX_STANDARD_ID)
    assert [type(value) for value in frame] == [int, bytes, bool, bool, bool]
    assert len(frame.data) <= 8
    assert type(received.stamp_ns) is int


@pytest.fixture(scope="module")
def serial_line() -> Iterator[tuple[Link, int]]:
    with TwoAdapters() as adapters, open_link(f"slcan:{adapters.one.device}") as link:
        adapters.pause()
        yield link, adapters.one.line
        adapters.resume()


@pytest.fixture(scope="module")
def multicast() -> Iterator[tuple[Link, Callable[[bytes], None]]]:
    port = free_port()
    with (
        open_link(f"udp:{port}") as link,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        yield link, lambda data: stranger.sendto(data, ("239.74.163.2", port)) and None


class TestWhateverArrives:
    @given(lines=st.lists(ANY_LINE, max_size=8))
    def test_on_a_serial_line(self, serial_line: tuple[Link, int], lines: list[bytes]) -> None:
        link, line = serial_line
        os.write(line, b"".join(text + b"\r" for text in lines) + b"\rt7ED0\r")
        while (received := link.receive(5)) is not None and received.frame != Frame(0x7ED):
            assert_sound(received)
        assert received is not None, "the last frame was not received"

    @given(
        datagrams=st.lists(
            st.one_of(
                st.binary(max_size=80),
                st.dictionaries(st.sampled_from(MESSAGE_KEYS), ANYTHING).map(msgpack.packb),
            ),
            max_size=8,
        )
    )
    def test_on_udp(self, multicast: tuple[Link, Callable[[bytes], None]], datagrams: list[bytes]) -> None:
        link, send = multicast
        for datagram in [*datagrams, pack_message(can.Message(arbitration_id=0x7ED, is_extended_id=False))]:
            send(datagram)
        while (received := link.receive(5)) is not None and received.frame != Frame(0x7ED):
            assert_sound(received)
        assert received is not None, "the last frame was not received"
