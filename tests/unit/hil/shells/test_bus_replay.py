"""Replay onto a bus, on a bus and a clock of the test: what is sent, when, and how it ends."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from support.recorded_runs import RUN_HEADER, START_NS, in_memory
from support.wire import crc8, frame_crc

from hil.core.errors import LinkError, RecordingError
from hil.core.frames import Frame
from hil.core.wire import codec
from hil.links.link import Received
from hil.recording import open_recording
from hil.recording.reader import Recording
from hil.recording.recorder import Recorder
from hil.shells.bus_replay import (
    MAX_POLLING_NS,
    MAX_WAIT_NS,
    MIN_POLLING_NS,
    BusReplay,
    Side,
    centre_after,
    fresh_samples,
    schedule_of,
)
from hil.shells.run_plan import CENTRING_PERIODS, StopRequest
from hil.shells.run_setup import load_rig

MS = 1_000_000
SEND_NS, LOOK_NS, OVERSLEEP_NS = 20_000, 500, 80_000
"""Times that the bus needs to take a frame, the clock to be read, and the process to wake up."""


class Bench:
    """A bus and a clock. Reading the clock and sending take time; a wait ends too late."""

    def __init__(self) -> None:
        self.now_ns = 10**15
        self.sent: list[tuple[int, Frame]] = []
        self.waits_s: list[float] = []
        self.arriving: list[Frame] = []
        self.full = False
        self.fails_after: int | None = None

    def clock_ns(self) -> int:
        self.now_ns += LOOK_NS
        return self.now_ns

    def send(self, frame: Frame) -> bool:
        if self.fails_after is not None and len(self.sent) >= self.fails_after:
            raise LinkError("vcan0: cannot send: Network is down")
        self.now_ns += SEND_NS
        if not self.full:
            self.sent.append((self.now_ns, frame))
        return not self.full

    def receive(self, timeout_s: float) -> Received | None:
        self.waits_s.append(timeout_s)
        if self.arriving:
            return Received(self.arriving.pop(), 0, "user")
        self.now_ns += round(timeout_s * 1e9) + OVERSLEEP_NS
        return None


FRAMES = [
    ("sent", 0, Frame(codec.NMT, b"\x01\x10")),
    ("sent", 0, Frame(codec.NMT, b"\x01\x20")),
    ("sent", 11, Frame(codec.SYNC)),
    ("received", 12, Frame(codec.TPDO1_ADC, bytes.fromhex("0040004000400700"))),
    ("sent", 13, Frame(codec.RPDO1_DAC, bytes.fromhex("0050004000402A00"))),
    ("received", 14, Frame(codec.SYNC)),
    ("received", 15, Frame(0x44, bytes(8), False, False, True)),
    ("received", 16, Frame(0x12345678, b"\x01", True)),
    ("sent", 22, Frame(codec.SYNC)),
    ("received", 23, Frame(codec.TPDO1_ADC, bytes.fromhex("0040004000400800"))),
    ("sent", 324, Frame(codec.RPDO1_DAC, bytes.fromhex("0060004000402B00"))),
    ("received", 330, Frame(codec.HEARTBEAT_ADC, b"\x05")),
]
"""Direction, time in ms, and frame."""


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, msgspec.structs.replace(RUN_HEADER), lossless=True)
    for direction, at_ms, frame in FRAMES:
        now_ns = START_NS + at_ms * MS
        if direction == "sent":
            recorder.frame_sent(frame, now_ns)
        else:
            recorder.frame_received(frame, now_ns, now_ns)
    recorder.close({})
    return open_recording(path)


@pytest.fixture
def bench() -> Iterator[Bench]:
    return Bench()


def offsets_ms(bench: Bench) -> list[float]:
    """Return the times of the sent frames, in ms from the first one."""
    return [round((at_ns - bench.sent[0][0]) / MS, 1) for at_ns, _ in bench.sent]


def test_the_gateways_frames_are_sent_at_their_instants(recording: Recording, bench: Bench) -> None:
    replay = BusReplay(bench, schedule_of(recording, Side.GATEWAY), clock_ns=bench.clock_ns)
    assert replay.run(StopRequest())
    assert [frame for _, frame in bench.sent] == [frame for way, _, frame in FRAMES if way == "sent"]
    assert offsets_ms(bench) == [0, 0, 11, 13, 22, 324]
    assert (replay.sent, replay.refused, replay.last_counter) == (6, 0, 0x2B)


def test_the_boards_side_sends_nothing_that_only_a_gateway_may_send(
    recording: Recording, bench: Bench
) -> None:
    schedule = schedule_of(recording, Side.BOARDS)
    assert schedule.left_out == 2, "a foreign SYNC and an error frame"
    BusReplay(bench, schedule, clock_ns=bench.clock_ns).run(StopRequest())
    assert [frame.id for _, frame in bench.sent] == [0x190, 0x12345678, 0x190, 0x710]
    assert offsets_ms(bench) == [0, 4, 11, 318]


def test_an_error_of_one_frame_does_not_move_the_next(recording: Recording, bench: Bench) -> None:
    """Each frame's error is the time to take it and to look at the clock, not a sum over the frames."""
    replay = BusReplay(bench, schedule_of(recording, Side.GATEWAY), clock_ns=bench.clock_ns)
    replay.run(StopRequest())
    timing = replay.timing_error()
    assert timing.p50_ms == pytest.approx((SEND_NS + 2 * LOOK_NS) / MS, abs=0.002)
    assert timing.worst_ms <= (2 * SEND_NS + 8 * LOOK_NS) / MS, "the second of two frames of one instant"
    assert str(timing).startswith("p50 0.02")


def test_the_clock_is_polled_for_longer_after_late_wake_ups(recording: Recording, bench: Bench) -> None:
    replay = BusReplay(bench, schedule_of(recording, Side.GATEWAY), clock_ns=bench.clock_ns)
    for overslept_ns, expected_ns in ((0, MIN_POLLING_NS), (10**6, 1_500_000), (10**9, MAX_POLLING_NS)):
        replay._adapt_polling(overslept_ns)
        assert replay._polling_ns == expected_ns
    for _ in range(200):
        replay._adapt_polling(0)
    assert replay._polling_ns == MIN_POLLING_NS


@pytest.mark.parametrize("speed", [0.5, 2.0, 10.0])
def test_speed_scales_the_times(recording: Recording, bench: Bench, speed: float) -> None:
    replay = BusReplay(bench, schedule_of(recording, Side.GATEWAY), speed=speed, clock_ns=bench.clock_ns)
    replay.run(StopRequest())
    assert offsets_ms(bench) == pytest.approx([ms / speed for ms in (0, 0, 11, 13, 22, 324)], abs=0.06)


def test_a_range_begins_with_the_start_of_the_boards(recording: Recording, bench: Bench) -> None:
    assert recording.start_ns == 0, "without a period, times count from the clock's zero"
    begin_s, end_s = START_NS / 1e9 + 0.012, START_NS / 1e9 + 0.1
    replay = BusReplay(bench, schedule_of(recording, Side.GATEWAY, begin_s, end_s), clock_ns=bench.clock_ns)
    began_ns = bench.now_ns
    replay.run(StopRequest())
    assert [frame.id for _, frame in bench.sent] == [codec.NMT, codec.NMT, codec.RPDO1_DAC, codec.SYNC]
    assert [frame.data for _, frame in bench.sent[:2]] == [b"\x01\x10", b"\x01\x20"]
    assert (bench.sent[2][0] - began_ns) / MS == pytest.approx(1.0, abs=0.1), "from the begin of the range"
    boards = schedule_of(recording, Side.BOARDS, begin_s, end_s)
    assert boards.first == []


@pytest.mark.parametrize("side", Side)
def test_a_range_without_frames_is_refused(recording: Recording, side: Side) -> None:
    with pytest.raises(RecordingError, match=f"has no frame of the {side} to send in this range"):
        schedule_of(recording, side, 100.0)


def test_a_loop_goes_on_without_a_gap_until_it_is_stopped(recording: Recording, bench: Bench) -> None:
    schedule = schedule_of(recording, Side.BOARDS)
    assert schedule.loop_ns == (318 + 11) * MS, "the last frame, and one interval of the samples"
    stop = StopRequest()
    watched: list[float] = []

    def watch(time_s: float, worst_ms: float) -> None:
        watched.append(time_s)
        assert 0.0 < worst_ms < 0.1
        if len(watched) == 2:
            stop.set()

    replay = BusReplay(bench, schedule, clock_ns=bench.clock_ns, watch=watch)
    assert not replay.run(stop, endless=True)
    rounds = [at_ns for at_ns, frame in bench.sent if frame.is_extended]
    assert len(rounds) > 5
    assert np.allclose(np.diff(rounds) / MS, 329.0, atol=0.1)


def test_a_request_to_stop_is_seen_during_a_long_wait(recording: Recording, bench: Bench) -> None:
    stop = StopRequest()
    receive = bench.receive

    def stopping(timeout_s: float) -> Received | None:
        if bench.sent[-1][1].id == codec.SYNC and len(bench.sent) == 5:
            stop.set()
        return receive(timeout_s)

    bench.receive = stopping  # type: ignore[method-assign]
    replay = BusReplay(bench, schedule_of(recording, Side.GATEWAY), clock_ns=bench.clock_ns)
    assert not replay.run(stop)
    assert len(bench.sent) == 5
    assert max(bench.waits_s) <= MAX_WAIT_NS / 1e9


def test_frames_of_other_nodes_are_taken_from_the_queue_and_counted(
    recording: Recording, bench: Bench
) -> None:
    bench.arriving = [Frame(0x700 + number) for number in range(9)]
    replay = BusReplay(bench, schedule_of(recording, Side.GATEWAY), clock_ns=bench.clock_ns)
    replay.run(StopRequest())
    assert (replay.received, bench.arriving) == (9, [])
    assert offsets_ms(bench) == [0, 0, 11, 13, 22, 324]


def test_frames_that_a_full_queue_refuses_are_counted(recording: Recording, bench: Bench) -> None:
    bench.full = True
    replay = BusReplay(bench, schedule_of(recording, Side.GATEWAY), clock_ns=bench.clock_ns)
    assert replay.run(StopRequest())
    assert (replay.sent, replay.refused, replay.last_counter) == (0, 6, None)


def test_samples_answer_each_sync_with_new_counters(recording: Recording, bench: Bench) -> None:
    schedule = schedule_of(recording, Side.BOARDS, answer_sync=True)
    assert [frame.data[6] for frame in schedule.answers] == [7, 8]
    syncs = [Frame(codec.SYNC), Frame(codec.SYNC), Frame(codec.SYNC)]
    bench.arriving = [*syncs, Frame(codec.SYNC, b"", True), Frame(codec.SYNC, b"", False, True), Frame(0x81)]
    replay = BusReplay(bench, schedule, change=fresh_samples(2), clock_ns=bench.clock_ns)
    assert replay.run(StopRequest())
    samples = [frame for _, frame in bench.sent if frame.id == codec.TPDO1_ADC]
    assert [frame.data[6] for frame in samples] == [0, 1], "one for each SYNC, while there are samples"
    assert (replay.answered, replay.received, replay.sent) == (2, 6, 4)
    assert [frame.id for _, frame in bench.sent if frame not in samples] == [0x12345678, 0x710]


class TestCentring:
    """However a replay of the gateway's side ends, the last command centres the valves."""

    @staticmethod
    def no_reopening() -> None:
        pytest.fail("a bus that works is not opened again")

    @pytest.mark.parametrize("frames", [0, 4, 6])
    def test_the_counter_goes_on_and_the_crc_is_right(
        self, recording: Recording, bench: Bench, frames: int
    ) -> None:
        replay = BusReplay(bench, schedule_of(recording, Side.GATEWAY), clock_ns=bench.clock_ns)
        bench.fails_after = frames
        if frames < 6:
            with pytest.raises(LinkError):
                replay.run(StopRequest())
        else:
            replay.run(StopRequest())
        bench.fails_after = None
        del bench.sent[:]
        assert centre_after(replay, load_rig(), self.no_reopening) == CENTRING_PERIODS
        commands = [frame for _, frame in bench.sent if frame.id == codec.RPDO1_DAC]
        first = {0: 0, 4: 0x2B, 6: 0x2C}[frames]
        for counter, command in enumerate(commands, first):
            decoded = codec.decode_rpdo1_dac(command.data)
            assert decoded[:3] == (5.0, 5.0, 5.0)
            assert decoded.counter == counter
            assert decoded.crc8 == frame_crc(0x220, command.data[:7])
        assert [frame.id for _, frame in bench.sent] == [codec.RPDO1_DAC, codec.SYNC] * CENTRING_PERIODS
        periods_ms = np.diff([at_ns for at_ns, frame in bench.sent if frame.id == codec.SYNC]) / MS
        assert np.allclose(periods_ms, 11.2, atol=0.2)

    def test_a_bus_that_is_gone_gives_no_error(self, recording: Recording, bench: Bench) -> None:
        replay = BusReplay(bench, schedule_of(recording, Side.GATEWAY), clock_ns=bench.clock_ns)
        bench.fails_after = 0
        opened = []
        assert centre_after(replay, load_rig(), lambda: opened.append(True)) == 0
        assert opened == [True]

    def test_a_bus_that_fails_is_opened_again(self, recording: Recording, bench: Bench) -> None:
        replay = BusReplay(bench, schedule_of(recording, Side.GATEWAY), clock_ns=bench.clock_ns)
        bench.fails_after = 0

        def reopen() -> None:
            bench.fails_after = None

        assert centre_after(replay, load_rig(), reopen) == CENTRING_PERIODS


@pytest.mark.parametrize("version", [1, 2])
def test_fresh_samples_have_a_new_counter_and_its_crc(version: int) -> None:
    fresh = fresh_samples(version)
    sample = Frame(codec.TPDO1_ADC, bytes.fromhex("0040014002400700"))
    for counter in [*range(256), 0, 1]:
        decoded = codec.decode_tpdo1_adc(fresh(sample).data)
        assert decoded.counter == counter
        assert decoded[:3] == codec.decode_tpdo1_adc(sample.data)[:3]
        body = fresh_data(sample, counter)
        assert decoded.crc8 == (crc8(body) if version == 1 else frame_crc(0x190, body))
    for other in (Frame(0x710, b"\x05"), Frame(0x190, bytes(6)), Frame(0x190, bytes(8), True)):
        assert fresh(other) == other


def fresh_data(sample: Frame, counter: int) -> bytes:
    return sample.data[:6] + bytes((counter,))
