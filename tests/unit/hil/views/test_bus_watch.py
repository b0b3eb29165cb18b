"""What a listener concludes from the frames of the bus, and the picture of it."""

from __future__ import annotations

import io
import struct

import msgspec
import pytest
from rich.console import Console
from support.shipped_rig import SHIPPED_RIG
from support.wire import crc8, protected

from hil.core.frames import Frame
from hil.core.wire import codec
from hil.core.wire.frame_bits import bits_on_wire
from hil.views.bus_table import bus_table
from hil.views.bus_watch import MAX_UNKNOWN_IDENTIFIERS, SILENT_NS, BusWatch, Status

MS = 1_000_000
PERIOD_NS = SHIPPED_RIG.loop.period_ns
BIT_RATE = 500_000


def sample(volts: tuple[float, float, float], counter: int) -> Frame:
    data = codec.encode_tpdo1_adc(*volts, counter & 0xFF, 0)[:7]
    return protected(codec.TPDO1_ADC, data)


def picture(status: Status) -> str:
    console = Console(file=io.StringIO(), width=80)
    console.print(bus_table("can0", status, 12.3, 4, 5))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


@pytest.fixture
def watch() -> BusWatch:
    return BusWatch(SHIPPED_RIG, BIT_RATE)


def run_gateway(watch: BusWatch, periods: int, first_ns: int = 0) -> int:
    """Let a gateway and both boards send for some periods. Return the time of the last frame."""
    now_ns = first_ns
    for number in range(periods):
        now_ns = first_ns + number * PERIOD_NS
        watch.receive(Frame(codec.SYNC), now_ns)
        watch.receive(sample((1.0 + 0.001 * number, 5.0, 9.95), number), now_ns + MS)
        watch.receive(Frame(codec.RPDO1_DAC, codec.encode_rpdo1_dac(6.0, 5.0, 4.0, 0, 0)), now_ns + 2 * MS)
        if number % 9 == 0:
            for identifier in (codec.HEARTBEAT_GATEWAY, codec.HEARTBEAT_ADC, codec.HEARTBEAT_DAC):
                watch.receive(Frame(identifier, b"\x05"), now_ns + 3 * MS)
    return now_ns + 3 * MS


def test_a_running_rig_is_shown_with_rates_and_positions(watch: BusWatch) -> None:
    now_ns = run_gateway(watch, 300)
    status = watch.status(now_ns)
    assert status.gateway.state == "operational"
    assert status.gateway.sync_per_s == pytest.approx(1e9 / PERIOD_NS, abs=1)
    assert status.samples.per_s == pytest.approx(1e9 / PERIOD_NS, abs=1)
    assert (status.samples.lost, status.samples.damaged, status.samples.counter) == (0, 0, 299 & 0xFF)
    assert [board.state for board in status.boards.values()] == ["operational", "operational"]
    vertical = status.axes["vertical"]
    assert vertical.potentiometer_v == pytest.approx(1.299, abs=0.001)
    assert vertical.position == pytest.approx(-0.165 + 0.033 * 1.299, abs=1e-4)
    assert vertical.speed == pytest.approx(0.033 * 0.001 / 0.0112, rel=0.1)
    assert vertical.valve_v == pytest.approx(6.0, abs=0.001)
    assert status.axes["rotation"].is_in_range is False, "9.95 V is over max_v"
    assert status.hints == []
    assert watch.hears_a_gateway(now_ns)


def test_the_load_is_the_share_of_the_bits_of_the_last_second(watch: BusWatch) -> None:
    frame = Frame(0x190, bytes(8))
    for number in range(2000):
        watch.receive(frame, number * MS)
    status = watch.status(1999 * MS)
    assert status.bus.load == pytest.approx(1000 * bits_on_wire(frame) / BIT_RATE)
    assert status.bus.frames_per_s == 1000
    assert watch.status(10_000 * MS).bus.load == 0


def test_lost_and_damaged_samples_are_counted(watch: BusWatch) -> None:
    for number, counter in enumerate((254, 255, 2, 3)):
        watch.receive(sample((5.0, 5.0, 5.0), counter), number * PERIOD_NS)
    good = sample((5.0, 5.0, 5.0), 4)
    watch.receive(good._replace(data=good.data[:7] + b"\0"), 5 * PERIOD_NS)
    watch.receive(good._replace(data=good.data[:6]), 6 * PERIOD_NS)
    samples = watch.status(6 * PERIOD_NS).samples
    assert (samples.lost, samples.damaged, samples.counter) == (2, 2, 3)


def test_samples_of_another_wire_version_are_named(watch: BusWatch) -> None:
    good = sample((5.0, 5.0, 5.0), 4)
    watch.receive(good._replace(data=good.data[:7] + bytes((crc8(good.data[:7]),))), 0)
    status = watch.status(0)
    assert status.samples.damaged == 1
    hint = "the CRC of the samples is wrong: the sender speaks wire version 1, the rig file says 2: "
    assert any(text.startswith(hint) for text in status.hints)
    watch.receive(good, PERIOD_NS)
    assert not any("version" in hint for hint in watch.status(PERIOD_NS).hints)


def test_samples_of_a_board_without_counter_are_read(watch: BusWatch) -> None:
    rig = msgspec.structs.replace(SHIPPED_RIG, adc=msgspec.structs.replace(SHIPPED_RIG.adc, protected=False))
    watch = BusWatch(rig, BIT_RATE)
    watch.receive(Frame(codec.TPDO1_ADC, struct.pack("<hhh", 16384, 16384, 16384)), 0)
    status = watch.status(0)
    assert status.axes["vertical"].position == pytest.approx(0.0)
    assert status.samples.counter is None


def test_emergencies_are_shown_in_words(watch: BusWatch) -> None:
    watch.receive(Frame(codec.EMCY_DAC, codec.encode_emcy_dac(0x8130, 0x11, 0, 0)), 0)
    watch.receive(Frame(codec.EMCY_ADC, b"\x00"), 0)
    status = watch.status(0)
    assert status.boards["adc"].emergencies == 0, "a short frame is no emergency message"
    board = status.boards["dac"]
    text = "EMCY 0x8130 (heartbeat or life guard error), error register 0x11"
    assert (board.emergencies, board.last_emergency) == (1, text)
    assert "1 so far, last EMCY 0x8130" in picture(status)


def test_error_frames_are_counted_and_have_no_load(watch: BusWatch) -> None:
    watch.receive(Frame(0x004, b"\x00\x04" + bytes(6), is_error=True), 0)
    bus = watch.status(0).bus
    assert (bus.error_frames, bus.last_error_frame, bus.load) == (1, "00000004#0004000000000000", 0.0)


def test_unknown_identifiers_are_counted_up_to_a_limit(watch: BusWatch) -> None:
    watch.receive(Frame(0x190, is_extended=True), 0)
    watch.receive(Frame(0x190, is_remote=True), 0)
    for identifier in range(0x300, 0x300 + 2 * MAX_UNKNOWN_IDENTIFIERS):
        watch.receive(Frame(identifier), 0)
    status = watch.status(0)
    assert len(status.unknown) == MAX_UNKNOWN_IDENTIFIERS
    assert status.unknown["00000190"] == status.unknown["190"] == 1
    assert "and 56 more" in picture(status)


def test_senders_that_stop_are_silent_and_their_values_disappear(watch: BusWatch) -> None:
    now_ns = run_gateway(watch, 50) + SILENT_NS + 1
    status = watch.status(now_ns)
    assert status.gateway.state == "silent"
    assert [board.state for board in status.boards.values()] == ["silent", "silent"]
    assert status.axes["vertical"].position is None
    assert status.axes["vertical"].valve_v is None
    assert not watch.hears_a_gateway(now_ns)


class TestHints:
    def test_an_empty_bus(self, watch: BusWatch) -> None:
        (hint,) = watch.status(0).hints
        assert hint.startswith("no frame at all: check cable")

    def test_boards_without_sync(self, watch: BusWatch) -> None:
        for identifier in (codec.HEARTBEAT_ADC, codec.HEARTBEAT_DAC):
            watch.receive(Frame(identifier, b"\x7f"), 0)
        assert watch.status(0).hints == [
            "no SYNC, so the ADC board sends no samples: start a gateway, or use --sync"
        ]
        assert watch.adc_is_pre_operational(0)

    def test_a_board_that_does_not_answer_sync(self, watch: BusWatch) -> None:
        watch.receive(Frame(codec.HEARTBEAT_ADC, b"\x05"), 0)
        watch.sent(Frame(codec.SYNC), 0)
        status = watch.status(0)
        assert status.own_sync_per_s == 1
        assert status.hints[0].startswith("no heartbeat of the DAC board (node 0x20)")
        assert status.hints[1].startswith("no samples in spite of SYNC: check objects 1800h and 1A00h")
        assert "this program" in picture(status)

    def test_a_board_that_is_not_started(self, watch: BusWatch) -> None:
        watch.receive(Frame(codec.HEARTBEAT_ADC, b"\x04"), 0)
        watch.receive(Frame(codec.HEARTBEAT_ADC, b""), 0)
        watch.receive(Frame(codec.SYNC), 0)
        assert watch.status(0).hints[-1] == "no samples, because the ADC board is stopped"

    def test_an_unknown_nmt_state(self, watch: BusWatch) -> None:
        watch.receive(Frame(codec.HEARTBEAT_ADC, b"\x33"), 0)
        assert watch.status(0).boards["adc"].state == "unknown NMT state 51"


def test_the_picture_fits_into_80_columns(watch: BusWatch) -> None:
    now_ns = run_gateway(watch, 300)
    watch.receive(Frame(0x7F0), now_ns)
    watch.receive(Frame(0x040, bytes(8), is_error=True), now_ns)
    text = picture(watch.status(now_ns))
    assert max(map(len, text.splitlines())) <= 80
    for part in (
        "can0   500 kbit/s   load",
        "error frames 1   unreadable 4   dropped 5   lost samples 0",
        "SYNC 90/s   commands 90/s",
        "samples 90/s   counter 43",
        "1.299 V     -0.1221 m     +0.0030 m/s   6.000 V",
        "out of range",
        "not in arm.dbc: 7F0 ×1",
        "last error frame 00000040#0000000000000000",
    ):
        assert part in text
