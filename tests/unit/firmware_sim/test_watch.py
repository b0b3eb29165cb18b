"""The live picture of the arm (``firmware-sim --watch``)."""

from __future__ import annotations

import pytest
from rich.console import Console

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.arm_file import shipped_arm
from firmware_sim.arm.event_text import parse_event
from firmware_sim.watch import UPDATE_INTERVAL_NS, ArmWatch, picture


class RecordedViews:
    def __init__(self) -> None:
        self.views: list[dict[str, object]] = []

    def send(self, message: dict[str, object]) -> None:
        self.views.append(message)


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> RecordedViews:
    shown = RecordedViews()
    monkeypatch.setattr("firmware_sim.watch.DisplayProcess", lambda _module: shown)
    return shown


def test_the_watch_sends_a_state_ten_times_a_second(shown: RecordedViews) -> None:
    watch = ArmWatch(Arm(shipped_arm(), seed=0))
    for now_ns in range(0, 1_000_000_000, 5_000_000):
        watch.update(now_ns)
    assert len(shown.views) == 1_000_000_000 // UPDATE_INTERVAL_NS


def drawn(view: dict[str, object], width: int) -> list[str]:
    console = Console(width=width, color_system=None)
    with console.capture() as capture:
        console.print(picture(view, width))
    return [line.rstrip() for line in capture.get().splitlines()]


@pytest.mark.parametrize("width", [80, 100, 200])
def test_the_picture_follows_the_arm(shown: RecordedViews, width: int) -> None:
    arm = Arm(shipped_arm(), seed=0)
    watch = ArmWatch(arm)
    watch.update(0)
    arm.advance(1_000_000_000, [6.0, 5.0, 4.5])
    watch.update(1_000_000_000)
    marks = []
    for view in shown.views:
        lines = drawn(view, width)
        assert "supply" in lines[0]
        assert len(lines) == 8
        assert [line.split()[0] for line in lines[2::2]] == ["vertical", "horizontal", "rotation"]
        marks.append([line.index("█") for line in lines[3::2]])
    before, after = marks
    assert after[0] > before[0] + 2, "the vertical axis moved up"
    assert after[1] == before[1], "the horizontal axis did not move"
    assert after[2] < before[2] - 2, "the rotation moved back"
    assert "waiting for a gateway" in drawn(shown.views[0], width)[0]
    assert "waiting" not in drawn(shown.views[1], width)[0]


def test_80_columns_hold_every_number(shown: RecordedViews) -> None:
    arm = Arm(shipped_arm(), seed=0)
    watch = ArmWatch(arm)
    arm.advance(40_000_000_000, [10.0, 0.0, 0.0])
    watch.update(0)
    (view,) = shown.views
    view["time_s"], view["payload_kg"], view["supply_pa"] = 86399.9, 12.125, 11e5
    for axis in view["axes"]:  # type: ignore[attr-defined]
        axis["position"], axis["velocity"], axis["spool"], axis["pressure_pa"] = (
            -1.2345,
            -12.345,
            -1.0,
            [1e6, 1e6],
        )
    lines = drawn(view, 80)
    assert max(map(len, lines)) <= 79  # the last column is for the cursor
    assert lines[0].startswith("86399.9 s   supply 11.00 bar   payload 12.125 kg")
    for line, unit in zip(lines[2::2], ("m", "m", "rad"), strict=True):
        words = line.split()
        assert words[1:6] == ["-1.2345", unit, "-12.345", f"{unit}/s", "-100%"]
        assert words[7] == words[9] == "10.00"
    assert lines[7].split()[0] == "-1.650"
    assert lines[7].split()[-1] == "+1.650"
    wide = drawn(view, 132)
    assert max(map(len, wide)) == 131


def test_abnormal_conditions_are_shown(shown: RecordedViews) -> None:
    events = ["stuck-spool:vertical@0", "friction:rotation,2@0", "leak:horizontal,2,1e-8@0"]
    events += ["broken-wire:rotation@0", "temperature:35@0", "payload:3@0"]
    arm = Arm(shipped_arm(), seed=0, events=map(parse_event, events))
    watch = ArmWatch(arm)
    watch.update(0)
    arm.advance(1, [5.0, 5.0, 5.0])
    watch.update(UPDATE_INTERVAL_NS)
    normal, abnormal = (drawn(view, 200) for view in shown.views)
    assert len(normal) == 8
    assert abnormal[8:] == [
        "air 35 °C",
        "vertical: spool stuck",
        "horizontal: chamber 2 leaks",
        "rotation: friction x 2",
        "rotation: wire broken",
    ]
