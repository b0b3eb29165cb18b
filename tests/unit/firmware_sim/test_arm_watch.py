"""The live picture of the arm."""

from __future__ import annotations

import pytest
from rich.console import Console

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.parameters import shipped_arm
from firmware_sim.watch import BETWEEN_LOOKS_NS, TRACK_CELLS, ArmWatch, picture


class Told:
    def __init__(self) -> None:
        self.views: list[dict[str, object]] = []

    def tell(self, message: dict[str, object]) -> None:
        self.views.append(message)


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Told:
    told = Told()
    monkeypatch.setattr("firmware_sim.watch.Onlooker", lambda _module: told)
    return told


def test_it_looks_ten_times_a_second(told: Told) -> None:
    watch = ArmWatch(Arm(shipped_arm(), seed=0))
    for now_ns in range(0, 1_000_000_000, 5_000_000):
        watch.look(now_ns)
    assert len(told.views) == 1_000_000_000 // BETWEEN_LOOKS_NS


def test_the_picture_follows_the_arm(told: Told) -> None:
    arm = Arm(shipped_arm(), seed=0)
    watch = ArmWatch(arm)
    watch.look(0)
    arm.advance(1_000_000_000, [6.0, 5.0, 4.5])
    watch.look(1_000_000_000)
    marks = []
    for view in told.views:
        console = Console(width=160, color_system=None)
        with console.capture() as capture:
            console.print(picture(view))
        lines = capture.get().splitlines()
        assert "supply" in lines[0]
        marks.append([line.index("█") - 12 for line in lines[2:]])
        assert [line.split()[0] for line in lines[2:]] == ["vertical", "horizontal", "rotation"]
        assert lines[2].count("bar") == 2
    before, after = marks
    assert all(abs(mark - TRACK_CELLS // 2) <= 1 for mark in before)
    assert after[0] > before[0] + 3, "up"
    assert after[1] == before[1], "still"
    assert after[2] < before[2] - 3, "back"
