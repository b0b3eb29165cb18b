"""The real-time loop of the boards: at which time each frame is handled."""

from __future__ import annotations

import pytest
from support.board_bench import RIG, HandPlant

from firmware_sim import realtime
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.links import Received


class SteppedBus:
    """A bus with its own clocks; a step is (time that passes, age of the frame, change of the wall clock)."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, steps: list[tuple[int, int, int]]) -> None:
        self.monotonic_ns, self.wall_offset_ns = 10**12, 10**18
        monkeypatch.setattr(realtime, "monotonic_ns", lambda: self.monotonic_ns)
        monkeypatch.setattr(realtime, "time_ns", lambda: self.monotonic_ns + self.wall_offset_ns)
        self.steps = steps

    def send(self, frame: Frame) -> None:
        pass

    def close(self) -> None:
        pass

    def receive(self, timeout_s: float) -> Received | None:
        if not self.steps:
            raise LinkError("over")
        passed_ns, age_ns, set_ns = self.steps.pop(0)
        self.monotonic_ns += passed_ns
        stamp_ns = self.monotonic_ns + self.wall_offset_ns - age_ns
        self.wall_offset_ns += set_ns
        return Received(Frame(0x080), stamp_ns, "kernel")


MS = 1_000_000
HOUR = 3_600_000 * MS


@pytest.mark.parametrize(
    ("steps", "expected_ms"),
    [
        ([(50 * MS, 0, 0), (11 * MS, 0, 0)], [50, 61]),
        ([(50 * MS, 40 * MS, 0), (0, 29 * MS, 0)], [10, 21]),
        ([(50 * MS, 0, 0), (10 * MS, 20 * MS, 0)], [50, 50]),
        ([(50 * MS, 10 * MS, -HOUR), (11 * MS, 0, 0)], [50, 61]),
        ([(50 * MS, 10 * MS, HOUR), (11 * MS, 0, 0)], [0, 61]),
    ],
    ids=["at once", "after a delay", "never backwards", "wall clock set back", "wall clock set forward"],
)
def test_frames_are_handled_at_their_time_of_arrival(
    steps: list[tuple[int, int, int]], expected_ms: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    bus = SteppedBus(monkeypatch, steps)
    assert arrivals_ms(bus, bus.monotonic_ns) == expected_ms


def test_a_delay_between_the_two_clocks_does_not_shift_a_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = SteppedBus(monkeypatch, [(50 * MS, 3 * MS, 0)])
    start_ns, delays = bus.monotonic_ns, [25 * MS, 25 * MS]

    def late_ns() -> int:
        bus.monotonic_ns += delays.pop() if delays and not bus.steps else 0
        return bus.monotonic_ns + bus.wall_offset_ns

    monkeypatch.setattr(realtime, "time_ns", late_ns)
    assert arrivals_ms(bus, start_ns) == [47]


@pytest.mark.parametrize(
    ("age_ms", "expected_ms"),
    [(20, 110), (35, 95)],  # the boards' heartbeats are due at 100 ms
    ids=["after the deadline", "before it, delivered late"],
)
def test_a_delay_after_a_deadline_makes_no_frame_late(
    age_ms: int, expected_ms: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    class DelayedBus(SteppedBus):
        was_delayed = False

        def receive(self, timeout_s: float) -> Received | None:
            if self.was_delayed:
                return super().receive(timeout_s)
            self.was_delayed = True
            self.monotonic_ns += round(timeout_s * 1e9) + 30 * MS  # the process is delayed after the timeout
            return None

    bus = DelayedBus(monkeypatch, [(0, age_ms * MS, 0)])
    assert arrivals_ms(bus, bus.monotonic_ns) == [expected_ms]


def arrivals_ms(bus: SteppedBus, start_ns: int) -> list[float]:
    """Return the times at which the rig gets the frames, in ms after its start."""
    arrivals = []

    class RecordingRig(SimulatedRig):
        def receive(self, frame: Frame, now_ns: int) -> tuple[Frame, ...]:
            arrivals.append((now_ns - start_ns) / MS)
            return ()

    with pytest.raises(LinkError, match="over"):
        realtime.simulate(RecordingRig(RIG, HandPlant()), bus)
    return arrivals
