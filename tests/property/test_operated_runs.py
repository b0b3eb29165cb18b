"""Operated runs in simulated real time under stalls, late wake-ups, full queues and a random operator.

The whole way is run: requests in the operators' pipe, session, core, real-time loop, link, simulated boards.
The commands that the link takes are checked by code that shares nothing with the gateway: it decodes the
frames by hand, and follows the state from the log entries alone.
"""

from __future__ import annotations

import re
from collections import Counter, deque
from pathlib import Path
from random import Random

import msgspec
import pytest
from support.gateway_bench import rig_text

from firmware_sim.plants.linear_plant import LinearPlant
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.core.gateway import Gateway
from hil.core.output import Cycle, LogEntry
from hil.host.controller_files import SHIPPED_CONTROLLERS
from hil.links import Received
from hil.operation.pipe import Asked, FromLoop, Replied, pipe
from hil.operation.protocol import (
    ArmCall,
    ControllerCall,
    DisarmCall,
    JogCall,
    LoopCall,
    ResetCall,
    SetpointCall,
    StartCall,
    StopCall,
)
from hil.recording.no_recorder import NoRecorder
from hil.shells import realtime
from hil.shells.observers import Observers
from hil.shells.operator_port import Described, OperatorPort
from hil.shells.run_plan import Ending, OperatorPlan, StopRequest
from hil.shells.run_setup import load_setup
from hil.shells.session import Session

PERIOD_NS = 11_200_000
COMMAND, SYNC = 0x220, 0x080
AXES = ("vertical", "horizontal", "rotation")
COUNT_V = 10.0 / 32768
CENTRE_V = 5.0
MIN_V, MAX_V, RATE_V_S = 2.0, 8.0, 25.0
RUN_S = 25.0
MAX_REFUSED = 5
STALLS = (0.1, 0.2, 0.4, 0.6, 0.7, 0.9, 1.2, 1.6, 2.6, 7.0)
"""Durations for which the machine may stall, in periods. The longest one is a fault."""
CONTROLLERS = [
    (SHIPPED_CONTROLLERS / f"{name}.json").read_text() for name in ("ppid", "horizontal", "rotation")
]


class Clock:
    def __init__(self) -> None:
        self.now_ns = 5_000_000_000

    def __call__(self) -> int:
        return self.now_ns

    def sleep(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9)


class CommandChecker:
    """Checks each command that the link takes. It is also an observer that follows the log."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.state = "offline"
        self.taken: list[tuple[float, float, float]] = [(CENTRE_V,) * 3]
        self._taken_ns = 0
        self._last_was_refused = False
        self.open_commands = 0
        self.is_jogging = False
        self.visited: Counter[str] = Counter()

    def refused(self) -> None:
        self._last_was_refused = True

    def check(self, frame: Frame) -> None:
        self._last_was_refused = False
        first, second, third = (
            int.from_bytes(frame.data[at : at + 2], "little", signed=True) * COUNT_V for at in (0, 2, 4)
        )
        volts, before = (first, second, third), self.taken[-1]
        elapsed_s = min((self._clock.now_ns - self._taken_ns) / 1e9, PERIOD_NS / 1e9)
        for sent_v, before_v in zip(volts, before, strict=True):
            assert MIN_V - 1e-9 <= sent_v <= MAX_V + 1e-9, "magnitude"
            if abs(sent_v - CENTRE_V) <= COUNT_V / 2:
                continue
            # A valve that leaves its centre may use the rate of one period, whenever it was centred.
            is_rest = abs(before_v - CENTRE_V) <= COUNT_V / 2
            allowed_s = PERIOD_NS / 1e9 if is_rest else elapsed_s
            assert abs(sent_v - before_v) <= RATE_V_S * allowed_s + COUNT_V, "rate"
            assert self.state == "running", "centre"
            self.open_commands += 1
        if self.is_jogging:
            assert sum(abs(sent_v - CENTRE_V) > COUNT_V / 2 for sent_v in volts) <= 1, "one axis at a time"
        self.taken.append(volts)
        self._taken_ns = self._clock.now_ns

    @property
    def is_centred(self) -> bool:
        return all(abs(volts - CENTRE_V) <= COUNT_V / 2 for volts in self.taken[-1])

    def log(self, entry: LogEntry) -> None:
        change = re.match(r"(\w+) -> (\w+) ", entry.text) if entry.source == "life cycle" else None
        if change is None:
            return
        assert change[1] == self.state
        self.state = change[2]
        self.is_jogging = entry.text.endswith("running (jog)")
        self.visited[change[0].strip()] += 1
        if change[1] == "running":
            # The command that centres has left before the entry was logged, unless the bus refused it.
            assert self.is_centred or self._last_was_refused

    def cycle(self, cycle: Cycle, gateway: Gateway) -> None:
        """Take a period."""


class RandomLink:
    """Simulated boards behind a link with random latency, a queue that is full at times, and stalls."""

    def __init__(self, boards: SimulatedRig, clock: Clock, checker: CommandChecker, random: Random) -> None:
        self.boards = boards
        self._clock = clock
        self._checker = checker
        self._random = random
        self._waiting: deque[tuple[int, Frame]] = deque()
        self._full_for = 0
        """Number of frames that the queue refuses from now on."""
        self.unreadable = 0
        self._push(boards.start(clock.now_ns))

    def send(self, frame: Frame) -> bool:
        if self._random.random() < 0.004:
            self.refuse(self._random.randint(1, 5))
        if self._full_for > 0:
            self._full_for -= 1
            if frame.id == COMMAND:
                self._checker.refused()
            return False
        if frame.id == COMMAND:
            self._checker.check(frame)
        self._push(self.boards.receive(frame, self._clock.now_ns))
        if frame.id == SYNC and self._random.random() < 0.01:
            self._stall()
        return True

    def refuse(self, frames: int) -> None:
        """Let the queue be full for this number of frames."""
        self._full_for = frames

    def receive(self, timeout_s: float) -> Received | None:
        end_ns = self._clock.now_ns + max(round(timeout_s * 1e9), 0)
        if self.boards.next_deadline_ns <= end_ns:
            due_ns = max(self.boards.next_deadline_ns, self._clock.now_ns)
            self._push(self.boards.on_deadline(due_ns))
        if self._waiting and self._waiting[0][0] <= end_ns:
            arrival_ns, frame = self._waiting.popleft()
            self._clock.now_ns = max(self._clock.now_ns, arrival_ns)
            return Received(frame, arrival_ns, "kernel")
        self._clock.now_ns = end_ns
        if timeout_s > 0 and self._random.random() < 0.01:
            self._stall()
        return None

    def reopen(self) -> None:
        raise LinkError("stays broken")

    def _stall(self) -> None:
        """Let this machine stop for some time, between a fraction of a period and some periods."""
        self._clock.now_ns += round(self._random.choice(STALLS) * PERIOD_NS)

    def _push(self, frames: tuple[Frame, ...]) -> None:
        latency_ns = round(self._random.uniform(0.1, 0.6) * 1e6)
        earliest_ns = self._waiting[-1][0] if self._waiting else 0
        at_ns = max(self._clock.now_ns + latency_ns, earliest_ns)
        self._waiting.extend((at_ns, frame) for frame in frames)


def random_call(random: Random, state: str) -> LoopCall:
    """Return a request of an operator. More than half of them lead to motion from ``state``."""
    axis = random.choice(AXES)
    jog = JogCall(axis=axis, offset_v=random.uniform(-1.2, 1.2), duration_s=random.uniform(0.01, 0.6))
    if random.random() < 0.6:
        match state:
            case "fault":
                return ResetCall()
            case "ready":
                return ArmCall()
            case "armed":
                return random.choice((StartCall(), StartCall(), jog))
    place = AXES.index(axis)
    match random.randrange(12):
        case 0:
            return StopCall()
        case 1:
            return DisarmCall()
        case 2 | 3:
            return ResetCall()
        case 4 | 5:
            return ArmCall()
        case 6 | 7:
            return StartCall()
        case 8:
            return JogCall(
                axis=axis, offset_v=random.uniform(-1.2, 1.2), duration_s=random.uniform(0.01, 0.6)
            )
        case 9 if random.random() < 0.2:
            return ControllerCall(axis=axis, name="c.json", document=CONTROLLERS[place])
    text = random.choice(("0.1", "-0.1", "0.02", "hold", "sine:0.05@0/2"))
    return SetpointCall(axis=axis, setpoint=text)


@pytest.mark.parametrize(
    ("seed", "apply"), [(seed, apply) for seed in range(4) for apply in ("at sync", "at once")]
)
def test_every_command_keeps_magnitude_rate_and_centre(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int, apply: str
) -> None:
    random, clock = Random(seed), Clock()
    monkeypatch.setattr(realtime, "monotonic_ns", clock)
    monkeypatch.setattr(realtime, "sleep", clock.sleep)
    rig_file = tmp_path / "rig.toml"
    valves = {
        f"axes.{axis}.valve.{key}": text
        for axis in AXES
        for key, text in (("min_v", f"{MIN_V}"), ("max_v", f"{MAX_V}"), ("max_rate_v_s", f"{RATE_V_S}"))
    }
    stale = {"adc.stale_after_periods": f"{MAX_REFUSED}", "dac.apply": f'"{apply}"'}
    rig_file.write_text(rig_text(valves | stale))
    setup = load_setup(rig_file, {}, dict.fromkeys(AXES, "hold"))
    checker = CommandChecker(clock)
    boards = SimulatedRig(setup.rig, LinearPlant(setup.rig))
    link = RandomLink(boards, clock, checker, random)
    ours, end = pipe()
    stop, plan = StopRequest(), OperatorPlan()
    described = Described("test", True, tuple((axis, "m") for axis in AXES), PERIOD_NS / 1e9, 10**18)
    port = OperatorPort(ours, described, {}, lambda: None, clock)
    session = Session(
        setup.gateway(clock.now_ns + PERIOD_NS),
        plan,
        link.send,
        clock,
        NoRecorder(),
        Observers(port, checker),
        MAX_REFUSED,
    )
    end_ns = clock.now_ns + round(RUN_S * 1e9)
    asked = accepted = 0

    def ask(call: LoopCall) -> None:
        nonlocal asked
        asked += 1
        end.send(msgspec.msgpack.encode(Asked(asked, "operator", call)))

    def serve(session: Session) -> None:
        nonlocal accepted
        if clock.now_ns >= end_ns:
            stop.set()
        if random.random() < 0.05 or plan.ending is not None:
            ask(random_call(random, checker.state))
        elif random.random() < 0.005:
            # A stop whose command the bus refuses, and a jog before the next deadline.
            link.refuse(1)
            ask(StopCall())
            ask(JogCall(axis=random.choice(AXES), offset_v=0.3, duration_s=0.2))
        port.serve(session)
        while True:
            try:
                message = msgspec.msgpack.decode(end.recv(1 << 20), type=FromLoop)
            except BlockingIOError:
                return
            accepted += isinstance(message, Replied) and message.accepted

    with ours, end:
        error = realtime.run(session, link, stop, serve)  # type: ignore[arg-type]
    assert error is None
    assert plan.ending in (Ending.INTERRUPTED, Ending.LINK)
    assert checker.open_commands > 20
    assert accepted > 10
    if plan.ending is Ending.INTERRUPTED:
        assert checker.is_centred
        assert set(boards.dac.valve_v) == {CENTRE_V}
