"""The summary, with responses whose overshoot and settling time are known in closed form."""

from __future__ import annotations

import io
import json
import math
import random
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from rich.console import Console
from support.recorded_runs import (
    CENTRED,
    PERIOD_S,
    RUN_HEADER,
    Signals,
    following,
    in_memory,
    lag,
    record_periods,
    record_run,
    step,
)
from support.shipped_rig import RIG_TEXT

from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import Cycle
from hil.recording.reader import Recording
from hil.recording.recorder import Recorder
from hil.views.summary import Quantiles, StepResponse, Summary, Tracking, summarise


def summary_of(tmp_path: Path, signals: Signals, seconds: float = 5.0) -> Summary:
    path = tmp_path / "run.mcap"
    record_run(path, round(seconds / PERIOD_S), signals)
    return summarise(Recording(path))


def step_response(tmp_path: Path, signals: Signals, seconds: float = 5.0) -> StepResponse:
    axis = summary_of(tmp_path, signals, seconds).axes["vertical"]
    assert isinstance(axis, StepResponse)
    return axis


def tracking(tmp_path: Path, signals: Signals, seconds: float = 5.0) -> Tracking:
    axis = summary_of(tmp_path, signals, seconds).axes["vertical"]
    assert isinstance(axis, Tracking)
    return axis


def second_order(size: float, at_s: float, zeta: float, omega: float) -> Callable[[float], float]:
    damped = omega * math.sqrt(1 - zeta**2)

    def at(t: float) -> float:
        t = max(t - at_s, 0.0)
        decay = math.exp(-zeta * omega * t)
        return size * (1 - decay * (math.cos(damped * t) + zeta * omega / damped * math.sin(damped * t)))

    return at


@pytest.mark.parametrize("tau_s", [0.05, 0.2, 0.5])
@pytest.mark.parametrize("size", [0.1, -0.04])
def test_a_first_order_lag_settles_in_tau_ln_50(tmp_path: Path, size: float, tau_s: float) -> None:
    response = step_response(tmp_path, following(step(size, 1.0), lag(size, 1.0, tau_s)))
    assert (response.step_from, response.step_to, response.unit) == (0.0, size, "m")
    assert response.overshoot_percent == 0.0
    assert response.settling_s == pytest.approx(tau_s * math.log(50), abs=PERIOD_S)
    assert response.steady_state_error == pytest.approx(0.0, abs=abs(size) * 1e-2)


@pytest.mark.parametrize("zeta", [0.3, 0.5, 0.7])
@pytest.mark.parametrize("size", [0.1, -0.04])
def test_the_overshoot_of_a_second_order_system(tmp_path: Path, size: float, zeta: float) -> None:
    response = step_response(tmp_path, following(step(size, 1.0), second_order(size, 1.0, zeta, 8.0)))
    expected = 100 * math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))
    assert response.overshoot_percent == pytest.approx(expected, rel=0.01)


def test_a_constant_offset_is_the_steady_state_error(tmp_path: Path) -> None:
    response = step_response(tmp_path, following(step(0.1, 1.0), lag(0.099, 1.0, 0.1)))
    assert response.steady_state_error == pytest.approx(0.001, rel=1e-3)
    assert response.settling_s is not None


def test_a_response_that_does_not_settle_has_no_settling_time(tmp_path: Path) -> None:
    response = step_response(tmp_path, following(step(0.1, 1.0), lag(0.09, 1.0, 0.1)))
    assert response.settling_s is None
    assert response.steady_state_error == pytest.approx(0.01, rel=1e-3)


def test_the_last_step_of_a_slow_ladder_is_read(tmp_path: Path) -> None:
    ladder = lambda t: 0.05 * min(int(t), 3)  # noqa: E731
    climb = lambda t: sum(lag(0.05, at_s, 0.1)(t) for at_s in (1.0, 2.0, 3.0))  # noqa: E731
    response = step_response(tmp_path, following(ladder, climb))
    assert response.step_from == pytest.approx(0.1)
    assert response.step_to == pytest.approx(0.15)
    assert response.settling_s == pytest.approx(0.1 * math.log(50), abs=2 * PERIOD_S)


@pytest.mark.parametrize(("size", "kind"), [(0.00145, Tracking), (0.00155, StepResponse)])
@pytest.mark.parametrize("at_s", [0.0, 1.0])
def test_a_step_is_at_least_half_a_percent_of_the_range(
    tmp_path: Path, at_s: float, size: float, kind: type
) -> None:
    """The vertical axis has a range of 0.3 m; the step at 0 s is the first setpoint under control."""
    rig = {"rig.toml": ("application/toml", RIG_TEXT.encode())}
    header = msgspec.structs.replace(RUN_HEADER, attachments={**RUN_HEADER.attachments, **rig})
    path = tmp_path / "run.mcap"
    record_run(path, 300, following(step(size, at_s), lag(size, at_s, 0.1)), header)
    assert type(summarise(Recording(path)).axes["vertical"]) is kind


def fast_ladder(t: float) -> float:
    """Changes every 0.3 s, long before a lag of 0.2 s has settled."""
    return (0.0, 0.05, 0.1, 0.02)[min(int(t / 0.3), 3)]


def random_binary(t: float) -> float:
    """Changes at random after 0.1 s or a multiple of it; the last change is 2 s before the end."""
    return 0.01 * random.Random(min(int(t / 0.1), 30)).choice((-1, 1))


@pytest.mark.parametrize("setpoint", [fast_ladder, random_binary])
def test_a_step_before_the_axis_is_at_rest_has_tracking_errors(
    tmp_path: Path, setpoint: Callable[[float], float]
) -> None:
    """Its response cannot be separated from those to the earlier steps."""
    position, positions = 0.0, []
    for number in range(round(5.0 / PERIOD_S) + 1):
        position += (setpoint(number * PERIOD_S) - position) * -math.expm1(-PERIOD_S / 0.2)
        positions.append(position)
    result = tracking(tmp_path, following(setpoint, lambda t: positions[round(t / PERIOD_S)]))
    assert result.max_error > 0.009


def test_a_step_in_the_last_periods_has_tracking_errors(tmp_path: Path) -> None:
    """A response of four periods has no overshoot, settling time or steady state."""
    late = following(step(0.1, 5.0 - 4.5 * PERIOD_S), lambda t: 0.0)
    assert tracking(tmp_path, late).max_error == pytest.approx(0.1)


def test_a_step_in_the_first_period_counts_from_where_the_axis_was(tmp_path: Path) -> None:
    response = step_response(tmp_path, following(lambda t: 0.1, lag(0.1, 0.0, 0.2)))
    assert (response.step_from, response.step_to) == (0.0, 0.1)
    assert response.settling_s == pytest.approx(0.2 * math.log(50), abs=2 * PERIOD_S)


def test_holding_a_position_is_no_step(tmp_path: Path) -> None:
    """The setpoint changes from the position before the run to the held position: that is no step."""
    assert tracking(tmp_path, following(lambda t: 0.0, lambda t: 0.00004)).max_error == pytest.approx(4e-5)


@pytest.mark.parametrize(
    "setpoint",
    [
        lambda t: 0.1 * math.sin(math.tau * t),
        lambda t: 0.02 * t,
        lambda t: 0.1 * min(max(t - 1.0, 0.0), 1.0),
    ],
    ids=["sine", "ramp to the end", "ramp and hold"],
)
def test_a_setpoint_without_a_step_has_tracking_errors(
    tmp_path: Path, setpoint: Callable[[float], float]
) -> None:
    result = tracking(tmp_path, following(setpoint, lambda t: setpoint(t) - 0.003))
    assert result.rms_error == pytest.approx(0.003)
    assert result.max_error == pytest.approx(0.003)


def test_the_error_of_a_sine_by_its_root_mean_square(tmp_path: Path) -> None:
    result = tracking(tmp_path, following(lambda t: 0.1 * math.sin(math.tau * t), lambda t: 0.0))
    assert result.rms_error == pytest.approx(0.1 / math.sqrt(2), rel=2e-3)
    assert result.max_error == pytest.approx(0.1, rel=2e-3)


def test_the_range_of_the_valve_voltage_is_that_under_control(tmp_path: Path) -> None:
    response = step_response(tmp_path, following(step(0.1, 1.0), lag(0.1, 1.0, 0.2)))
    assert response.min_valve_v == 5.0
    assert response.max_valve_v == pytest.approx(6.0, abs=0.06)


def test_quantiles_are_values_that_occurred(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    record_periods(
        recorder,
        1000,
        lateness_ns=lambda k: 1000 * (k + 1),
        response_ns=lambda k: 2_070_000 if k == 500 else 470_000,
        sync_ns=70_000,
    )
    record_periods(recorder, 10, first=1003, lateness_ns=lambda k: 0)
    recorder.close({})
    summary = summarise(Recording(path))
    assert summary.lateness == Quantiles(p50_us=495.0, p99_us=990.0, p99_9_us=999.0, max_us=1000.0)
    assert summary.response == Quantiles(p50_us=400.0, p99_us=400.0, p99_9_us=400.0, max_us=2000.0)
    assert (summary.periods, summary.missed_periods, summary.periods_without_sample) == (1010, 3, 0)
    assert (summary.frames_received, summary.frames_sent) == (1010, 2020)


def test_a_run_that_never_got_running_has_timing_alone(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    record_periods(recorder, 50, state=LifeCycleState.READY)
    recorder.close({})
    summary = summarise(Recording(path))
    assert summary.axes == {}
    assert summary.periods == 50


def test_periods_before_the_boards_are_up_are_no_losses(tmp_path: Path) -> None:
    """Later periods without a sample are, although the gateway may then be offline again."""
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    for state, fresh, periods in (
        (LifeCycleState.OFFLINE, False, 25),
        (LifeCycleState.OFFLINE, True, 3),
        (LifeCycleState.READY, True, 2),
        (LifeCycleState.RUNNING, True, 100),
        (LifeCycleState.RUNNING, False, 2),
        (LifeCycleState.OFFLINE, False, 5),
    ):
        for _ in range(periods):
            cycle = Cycle(0, 0, 0, 0, state, fresh, (CENTRED,) * 3)
            recorder.cycle(cycle, 0, 0)
    recorder.close({})
    summary = summarise(Recording(path))
    assert (summary.periods, summary.bring_up_periods, summary.periods_without_sample) == (137, 28, 7)
    assert "137 periods (28 before the boards were up), " in printed(summary)
    assert ", 7 without a sample\n(without a sample: the gateway sent no SYNC" in printed(summary)
    assert max(map(len, printed(summary).splitlines())) <= 80


def test_a_run_without_a_period_is_summed_up(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    recorder.operated(Trigger.ARM, 1)
    recorder.close({})
    summary = summarise(Recording(path))
    assert (summary.periods, summary.missed_periods, summary.lateness) == (0, 0, None)
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(summary.table())
    rows = [line.split() for line in console.export_text().splitlines() if "unknown" in line]
    unknown = ["unknown"] * 4
    assert rows == [["lateness", *unknown], ["response", *unknown]], "no time is not a time of zero"


def test_the_table_fits_a_terminal_and_shows_what_the_dict_holds(tmp_path: Path) -> None:
    summary = summary_of(tmp_path, following(step(0.1, 1.0), lag(0.1, 1.0, 0.2)))
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(summary.table())
    text = console.export_text()
    assert all(len(line.rstrip()) <= 80 for line in text.splitlines())
    row = next(line for line in text.splitlines() if line.strip().startswith("rotation"))
    assert "0→0.1 rad" in row
    assert "0.00 %" in row
    assert "5.00…" in row
    plain = json.loads(json.dumps(summary.as_dict()))
    assert plain["axes"]["rotation"]["unit"] == "rad"
    assert f"{plain['axes']['rotation']['settling_s']:.2f} s" in row
    assert plain["lateness"]["max_us"] == 100.0


def printed(summary: Summary, width: int = 80) -> str:
    """Print as ``hil run`` does: lines are not wrapped by rich."""
    console = Console(width=width, record=True, file=io.StringIO(), soft_wrap=True)
    console.print(summary.table())
    return console.export_text()


WIDE = following(step(-0.1499, 1.0), lambda t: 12.3456 * (t > 1.0))
WIDE_CELLS = ("rotation", "0→-0.1499 rad", "not settled", "-12495.50 mrad", "-119.95…5.00 V")


@pytest.mark.parametrize("width", [20, 80])
def test_a_table_that_is_piped_is_as_wide_as_its_text(tmp_path: Path, width: int) -> None:
    text = printed(summary_of(tmp_path, WIDE), width)
    assert "steady-state" in text
    (row,) = [line for line in text.splitlines() if line.strip().startswith("rotation")]
    for cell in WIDE_CELLS:
        assert cell in row


@pytest.mark.parametrize("width", [30, 60, 80])
def test_a_narrow_terminal_shows_all_text_on_more_lines(tmp_path: Path, width: int) -> None:
    summary = summary_of(tmp_path, WIDE)
    console = Console(width=width, force_terminal=True, color_system=None, record=True, file=io.StringIO())
    console.print(summary.table(), soft_wrap=True)
    shown, whole = (
        text[: text.index("periods")].replace("─", "") for text in (console.export_text(), printed(summary))
    )
    assert max(map(len, shown.splitlines()[:-1])) <= width
    assert shown != whole
    assert Counter("".join(shown.split())) == Counter("".join(whole.split()))


LOSSES = {
    "frames dropped by the kernel": "frames_dropped",
    "frames unreadable": "frames_unreadable",
    "frames not sent": "frames_not_sent",
    "rejected frames": "frames_rejected",
    "lost samples": "samples_lost",
    "error frames": "error_frames",
    "frames destroyed on the bus": "frames_destroyed",
}


def summary_and_text(tmp_path: Path, ending: dict[str, str]) -> tuple[Summary, str]:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    record_periods(recorder, 300)
    recorder.close({"ending": ending})
    summary = summarise(Recording(path))
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(summary.table())
    return summary, console.export_text()


@pytest.mark.parametrize("key", LOSSES)
def test_losses_are_printed_strikingly(tmp_path: Path, key: str) -> None:
    summary, text = summary_and_text(tmp_path, dict.fromkeys(LOSSES, "0") | {key: "17"})
    assert {name: summary.as_dict()[name] for name in LOSSES.values()} == dict.fromkeys(
        LOSSES.values(), 0
    ) | {LOSSES[key]: 17}
    (line,) = [line for line in text.splitlines() if line.startswith("ATTENTION: 17 ")]
    assert line.count(",") == 0


def test_a_run_without_losses_says_so(tmp_path: Path) -> None:
    _, text = summary_and_text(tmp_path, dict.fromkeys(LOSSES, "0"))
    assert "nothing dropped, rejected or lost" in text
    assert "ATTENTION" not in text


def test_unknown_counts_are_none(tmp_path: Path) -> None:
    summary, text = summary_and_text(tmp_path, {"frames dropped by the kernel": "unknown"})
    assert summary.frames_dropped is None
    assert summary.frames_rejected is None
    assert "ATTENTION" not in text


def test_messages_that_were_not_recorded_are_printed_strikingly(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    record_periods(recorder, 300)
    recorder._pipe.dropped.update({1: 5, 4: 2})
    recorder.close({})
    summary = summarise(Recording(path))
    assert summary.messages_dropped == 7
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(summary.table())
    assert "ATTENTION: 7 messages not recorded" in console.export_text()


def test_a_cut_off_recording_says_so(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    record_run(path, 300)
    path.write_bytes(path.read_bytes()[:-40])
    summary = summarise(Recording(path))
    assert not summary.complete
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(summary.table())
    assert "cut off" in console.export_text()


def test_an_interrupted_run_says_so_and_others_do_not(tmp_path: Path) -> None:
    ending = {"reason": "interrupted", "duration asked for, s": "600"}
    summary, text = summary_and_text(tmp_path, ending)
    assert summary.controlled_s == pytest.approx(299 * PERIOD_S)
    assert f"interrupted after {299 * PERIOD_S:.0f} s of 600" in text
    (tmp_path / "run.mcap").unlink()
    assert "interrupted" not in summary_and_text(tmp_path, ending | {"reason": "completed"})[1]


@pytest.mark.parametrize("tau_s", [0.1, 0.3])
def test_a_first_order_lag_rises_in_tau_ln_9(tmp_path: Path, tau_s: float) -> None:
    response = step_response(tmp_path, following(step(0.1, 1.0), lag(0.1, 1.0, tau_s)))
    assert response.rise_s == pytest.approx(tau_s * math.log(9), abs=PERIOD_S)


def test_a_response_that_stops_halfway_has_no_rise_time(tmp_path: Path) -> None:
    response = step_response(tmp_path, following(step(0.1, 1.0), lag(0.08, 1.0, 0.1)))
    assert response.rise_s is None


@pytest.mark.parametrize("periods", [0, 7, 40])
def test_the_delay_of_a_position_that_repeats_the_setpoint(tmp_path: Path, periods: int) -> None:
    def setpoint(t: float) -> float:
        return 0.05 * math.sin(2.0 * t) + 0.02 * math.sin(5.0 * t)

    found = tracking(tmp_path, following(setpoint, lambda t: setpoint(t - periods * PERIOD_S)))
    assert found.delay_s == pytest.approx(periods * PERIOD_S)


def test_a_constant_setpoint_has_no_delay(tmp_path: Path) -> None:
    assert tracking(tmp_path, following(lambda t: 0.0, lambda t: 0.001)).delay_s is None


@pytest.mark.parametrize("periods_after", [1, 3])
def test_a_setpoint_that_changes_in_the_last_periods_has_no_delay(tmp_path: Path, periods_after: int) -> None:
    """The rows end before the position could answer, so that no shift of the setpoint has a meaning."""
    signals = following(step(0.1, 5.0 - (periods_after + 1.5) * PERIOD_S), lambda t: 1e-4 * math.sin(9.0 * t))
    assert tracking(tmp_path, signals).delay_s is None


def test_an_excitation_whose_last_change_happens_to_be_from_rest_has_tracking_errors(tmp_path: Path) -> None:
    """A table of levels changes while the axis is on its way, and at its end after a rest."""
    levels = [0.05, -0.05, 0.08, 0.0, -0.03]

    def setpoint(t: float) -> float:
        return 0.0 if t < 1.0 else levels[int((t - 1.0) / 0.2)] if t < 2.0 else 0.0 if t < 3.5 else 0.1

    def position(t: float) -> float:
        return 0.5 * setpoint(t) if t < 2.0 else setpoint(t)

    assert isinstance(summary_of(tmp_path, following(setpoint, position)).axes["vertical"], Tracking)
