"""The state of a core: complete, exact, and refused if it is not one."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.constants import PERIOD_S
from support.gateway_bench import RigBench, SteppedGateway, make_gateway, make_rig, sample_frame

from hil.core.core_state import restore, state_of
from hil.core.errors import DocumentError
from hil.core.excited_loop import Fence
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import LogThrottle, Output, Severity
from hil.core.requests import ControllerRequest, JogRequest, Request, SetpointRequest
from hil.core.wire import codec

PID = json.dumps(
    {
        "format": "hil-controller",
        "version": 1,
        "name": "test",
        "description": "",
        "sample_time_s": PERIOD_S,
        "input_unit": "m",
        "output_unit": "V",
        "law": {"kind": "pid", "kp": 12.0, "ki": 5.0, "kd": 0.2, "tau_d": 0.05},
        "origin": {},
    }
)
REQUESTS: list[Request] = [
    Trigger.ARM,
    Trigger.START,
    Trigger.STOP,
    Trigger.DISARM,
    Trigger.RESET,
    SetpointRequest("vertical", "0.1"),
    SetpointRequest("vertical", "minimum-jerk:0.1@0.1/1"),
    SetpointRequest("horizontal", "sine:0.02@0/1"),
    SetpointRequest("rotation", "hold"),
    SetpointRequest("rotation", "ladder:0.1,-0.1@0.1/0.2"),
    SetpointRequest("elbow", "0.1"),
    ControllerRequest("vertical", "new.json", PID),
    ControllerRequest("rotation", "new.json", PID),
    JogRequest("vertical", 0.5, 0.3),
    JogRequest("rotation", -0.5, 0.1),
]
SETPOINTS = {"vertical": "step:0.05@0.1", "horizontal": "hold", "rotation": "ramp:0.2@0.1/1"}


def new_gateway() -> Gateway:
    return make_gateway(make_rig(), setpoints=SETPOINTS)


def copy_of(core: Gateway) -> Gateway:
    """A core that was built from the same documents, with the state of ``core`` as a text carries it."""
    fresh = new_gateway()
    restore(fresh, json.loads(json.dumps(state_of(core), allow_nan=False)))
    return fresh


class Twin:
    """A gateway that a test steps, and after ``split`` a copy that gets the same calls."""

    def __init__(self) -> None:
        self.bench = SteppedGateway(make_rig(), new_gateway())
        self.copy: Gateway | None = None

    def split(self) -> None:
        self.copy = copy_of(self.bench.core)

    def call(self, function: Callable[[Gateway], Output]) -> None:
        output = function(self.bench.core)
        if self.copy is not None:
            assert function(self.copy) == output

    def period(self, volts: list[float], fate: str) -> None:
        bench = self.bench
        bench.now_ns = bench.core.next_deadline_ns + (9_000_000 if fate == "late" else 0)
        now_ns = bench.now_ns
        self.call(lambda core: core.on_deadline(now_ns))
        for board in (codec.HEARTBEAT_ADC, codec.HEARTBEAT_DAC):
            frame = sample_frame(volts, 0)._replace(id=board, data=b"\x05")
            self.call(lambda core, frame=frame: core.receive(frame, now_ns))
        if fate == "lost":
            bench.counter += 1
            return
        frame = sample_frame(volts, bench.counter)
        bench.counter += 1
        if fate == "damaged":
            frame = frame._replace(data=frame.data[:-1] + bytes([frame.data[-1] ^ 1]))
        self.call(lambda core: core.receive(frame, now_ns + 1_000_000))


fates = st.sampled_from(["good"] * 12 + ["lost", "late", "damaged"])
steps = st.lists(st.tuples(st.sampled_from(REQUESTS), st.lists(fates, max_size=12)), min_size=1, max_size=12)


@settings(max_examples=60, deadline=None)
@given(steps, steps, st.booleans())
def test_a_copy_answers_as_the_original(
    before: list[tuple[Request, list[str]]], after: list[tuple[Request, list[str]]], is_armed: bool
) -> None:
    twin = Twin()
    number = 0

    def go(script: list[tuple[Request, list[str]]]) -> None:
        nonlocal number
        for request, fates in script:
            now_ns = twin.bench.now_ns + 2_000_000
            twin.call(lambda core, request=request, now_ns=now_ns: core.operate(request, now_ns))
            for fate in fates:
                number += 1
                shift = 0.05 * math.sin(0.3 * number)
                twin.period([5.0 + shift, 5.0 - shift, 5.0], fate)

    for _ in range(8):
        twin.period([5.0, 5.0, 5.0], "good")
    if is_armed:
        go([(Trigger.ARM, ["good"]), (Trigger.START, ["good"] * 3)])
    go(before)
    twin.split()
    go(after)
    assert twin.copy is not None
    assert state_of(twin.copy) == state_of(twin.bench.core)


def test_a_copy_of_a_running_rig_sends_the_same_frames() -> None:
    bench = RigBench(make_rig(), setpoints=SETPOINTS)
    bench.gateway = new_gateway()
    bench.run()
    bench.operate(SetpointRequest("vertical", "0.1"))
    bench.periods(10)
    fork = copy_of(bench.gateway)
    assert fork is not bench.gateway
    assert fork.state is LifeCycleState.RUNNING
    assert state_of(fork) == state_of(bench.gateway)


class Part:
    """An object outside the core."""


class TestValues:
    @pytest.mark.parametrize(
        "value",
        [
            {"a": 1, 2: [0.1, None, True]},
            (1.0, math.inf, -math.inf),
            deque([1, 2], maxlen=4),
            deque([(1, 2.5)]),
            {1, 2},
            frozenset({"a"}),
            b"\x00\xff",
            Severity.WARNING,
            Trigger.ARM,
            Fence(0.1, 0.2),
            0.1 + 0.2,
            5e-324,
        ],
    )
    def test_values_come_back_with_their_type(self, value: Any) -> None:
        throttle = LogThrottle()
        throttle._counts = value
        fresh = LogThrottle()
        restore(fresh, json.loads(json.dumps(state_of(throttle), allow_nan=False)))
        assert fresh._counts == value
        assert type(fresh._counts) is type(value)
        if isinstance(value, deque):
            assert fresh._counts.maxlen == value.maxlen

    def test_nan_comes_back(self) -> None:
        throttle, fresh = LogThrottle(), LogThrottle()
        throttle._counts = math.nan  # type: ignore[assignment]
        restore(fresh, state_of(throttle))
        assert math.isnan(fresh._counts)  # type: ignore[arg-type]

    def test_a_value_that_the_core_does_not_define_cannot_be_written(self) -> None:
        throttle = LogThrottle()
        throttle._counts = Part()  # type: ignore[assignment]
        with pytest.raises(TypeError, match=r"test_core_state\.Part cannot be written"):
            state_of(throttle)

    def test_shared_objects_stay_shared(self) -> None:
        core = copy_of(new_gateway())
        assert core._rejections._throttle is core._throttle
        assert core._state._throttle is core._throttle


class TestRefusals:
    @pytest.mark.parametrize(
        "value",
        [
            {"class": "os.path", "id": 9, "attributes": {}},
            {"class": "subprocess.Popen", "id": 9, "attributes": {}},
            {"class": "hil.core.core_state.deque", "id": 9, "attributes": {}},
            {"class": "hil.core.nothing.Nothing", "id": 9, "attributes": {}},
            {"enum": "hil.core.output.LogEntry", "name": "INFO"},
            {"enum": "hil.core.output.Severity", "name": "NONE"},
            {"values": [1], "of": "hil.core.output.LogEntry"},
            {"values": [1], "of": "builtins.tuple"},
            {"object": 99},
            {"unknown": 1},
        ],
    )
    def test_a_value_that_is_none_of_the_core_is_refused(self, value: Any) -> None:
        state = state_of(LogThrottle())
        state["attributes"]["_counts"] = value
        with pytest.raises(DocumentError, match=r"the state of the core does not fit this program"):
            restore(LogThrottle(), state)

    def test_a_missing_and_a_further_attribute_are_named(self) -> None:
        state = state_of(LogThrottle())
        state["attributes"]["_other"] = state["attributes"].pop("_counts")
        with pytest.raises(DocumentError, match=r"LogThrottle differs in _counts, _other"):
            restore(LogThrottle(), state)
