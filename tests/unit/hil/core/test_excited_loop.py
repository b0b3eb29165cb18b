"""The loop of an excited axis: its phases, on a plant that a test steps by hand."""

import math
from collections.abc import Sequence

import pytest

from hil.core.control_law import ControlLaw
from hil.core.controller_file import PidLaw
from hil.core.excitation import Prbs
from hil.core.excited_loop import ExcitedLoop, Fence
from hil.core.experiment import Experiment
from hil.core.phase import Phase

TS = 0.0112
FENCE = Fence(-0.1, 0.1)
SIGNAL = Prbs(amplitude=0.4, duration_s=1.0)


class Axis:
    """y' = gain (u - standstill_v), under the loop; keeps all that happened."""

    def __init__(
        self, mode: str, values: Sequence[float], *, y: float = 0.05, standstill_v: float = 0.0
    ) -> None:
        experiment = Experiment(
            format="hil-experiment",
            version=1,
            axis="vertical",
            mode=mode,
            signal=SIGNAL,
            approach_s=1.0,
            settle_s=6.0,
        )
        law = ControlLaw(PidLaw(kp=10.0, ki=8.0), TS)
        self.loop = ExcitedLoop(law, experiment, values, FENCE)
        self.y = y
        self.standstill_v = standstill_v
        self.t = 0.0
        self.history: list[tuple[Phase, float, float, float]] = []
        self.loop.begin(0.0, y)

    def step(self) -> None:
        r, u = self.loop.output(self.t, self.y)
        self.history.append((self.loop.phase, r, self.y, u))
        self.loop.advance(u)
        self.y += TS * 0.25 * (u - self.standstill_v)
        self.t += TS

    def run(self, limit_s: float = 60.0) -> None:
        while not self.loop.is_done:
            assert self.t < limit_s
            self.step()

    def phases(self) -> list[Phase]:
        found = [phase for phase, *_ in self.history]
        return [phase for k, phase in enumerate(found) if k == 0 or phase is not found[k - 1]]


VALUES = [0.3 if k // 20 % 2 == 0 else -0.3 for k in range(200)]


@pytest.mark.parametrize("mode", ["open loop", "controller output", "setpoint"])
def test_the_axis_is_centred_excited_and_returned(mode: str) -> None:
    scale = 0.1 if mode == "setpoint" else 1.0
    axis = Axis(mode, [scale * value for value in VALUES])
    axis.run()
    assert axis.phases() == [Phase.APPROACH, Phase.SETTLE, Phase.EXCITED, Phase.RETURN, Phase.DONE]
    assert sum(phase is Phase.EXCITED for phase, *_ in axis.history) == len(VALUES)
    assert axis.y == pytest.approx(0.0, abs=2e-3)
    assert axis.loop.fence_crossings == 0


def test_it_begins_without_a_bump() -> None:
    axis = Axis("open loop", VALUES)
    axis.step()
    (_, r, y, u), *_ = axis.history
    assert (r, u) == (pytest.approx(y), pytest.approx(0.0, abs=1e-9))


def test_open_loop_gives_the_valve_its_offset_plus_the_excitation() -> None:
    axis = Axis("open loop", VALUES, standstill_v=0.15)
    axis.run()
    assert axis.loop.offset_v == pytest.approx(0.15, abs=5e-3)
    given = [u for phase, _, _, u in axis.history if phase is Phase.EXCITED]
    assert given == [axis.loop.offset_v + value for value in VALUES]


def test_the_setpoint_is_excited_about_the_centre() -> None:
    axis = Axis("setpoint", [0.01] * 50)
    axis.run()
    assert {r for phase, r, _, _ in axis.history if phase is Phase.EXCITED} == {0.01}


def test_the_fence_takes_the_axis_back_and_the_excitation_goes_on_where_it_stopped() -> None:
    values = [0.5] * 120 + [-0.5] * 60
    axis = Axis("open loop", values)
    axis.run()
    assert axis.loop.fence_crossings >= 1
    assert axis.phases()[2:6] == [Phase.EXCITED, Phase.RECOVER, Phase.SETTLE, Phase.EXCITED]
    assert sum(phase is Phase.EXCITED for phase, *_ in axis.history) == len(values)
    given = [u - axis.loop.offset_v for phase, _, _, u in axis.history if phase is Phase.EXCITED]
    assert given == pytest.approx(values)
    assert max(abs(y) for _, _, y, _ in axis.history) < 0.105


def test_beyond_the_fence_no_sample_counts_as_excited() -> None:
    axis = Axis("open loop", [0.5] * 200)
    axis.run()
    assert all(FENCE.min_y <= y <= FENCE.max_y for phase, _, y, _ in axis.history if phase is Phase.EXCITED)


def test_taken_back_from_open_loop_the_valve_begins_at_its_offset() -> None:
    axis = Axis("open loop", [0.5] * 200, standstill_v=0.15)
    axis.run()
    first = next(u for phase, _, _, u in axis.history if phase is Phase.RECOVER)
    assert first == pytest.approx(axis.loop.offset_v, abs=0.02)


def test_the_offset_is_that_of_the_first_settling() -> None:
    axis = Axis("open loop", [0.5] * 300, standstill_v=0.15)
    while axis.loop.phase is not Phase.EXCITED:
        axis.step()
    first = axis.loop.offset_v
    axis.run()
    assert axis.loop.fence_crossings >= 2
    assert axis.loop.offset_v == first


def test_a_limited_output_is_told_to_the_law_without_the_excitation() -> None:
    """Anti-windup sees what the limits took from the law, not the excitation."""
    axis = Axis("controller output", VALUES)
    while axis.loop.phase is not Phase.EXCITED:
        axis.step()
    law_output = axis.loop._law.output(0.0, axis.y)
    _, u = axis.loop.output(axis.t, axis.y)
    assert u == pytest.approx(law_output + VALUES[1])
    state = list(axis.loop._law._x)
    axis.loop.advance(u)
    free = ControlLaw(PidLaw(kp=10.0, ki=8.0), TS)
    free._x = state
    free.advance(free.output(0.0, axis.y))
    assert axis.loop._law._x == pytest.approx(free._x)


def test_begun_again_it_starts_from_the_beginning() -> None:
    axis = Axis("open loop", VALUES)
    axis.run()
    axis.loop.begin(axis.t, axis.y)
    assert not axis.loop.is_done
    before = len(axis.history)
    axis.run()
    assert sum(phase is Phase.EXCITED for phase, *_ in axis.history[before:]) == len(VALUES)
    assert math.isfinite(axis.y)
