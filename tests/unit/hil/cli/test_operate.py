"""The commands for a running daemon, against a server with a made-up loop behind it."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.ending_daemon import ending
from support.operation_bench import MadeUpLoop, served, status

from hil.cli import OPERATION, command_module, main, operate
from hil.cli.status import show_json, show_live, show_text, status_lines
from hil.operation.client import Client
from hil.operation.pipe import Asked, Replied
from hil.operation.protocol import (
    ArmCall,
    AxisSetpoint,
    AxisStatus,
    ControllerCall,
    EventCall,
    JogCall,
    LogLine,
    SetpointsCall,
    Status,
)

Bench = tuple[MadeUpLoop, list[str]]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with served(tmp_path) as (loop, path):
        yield loop, ["--socket", str(path)]


@pytest.mark.parametrize("name", ["arm", "disarm", "start", "stop"])
def test_a_command_prints_what_the_daemon_says(
    bench: Bench, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    loop, at = bench
    loop.reply = lambda asked: Replied(asked.number, True, f"{name}: it happened")
    assert main([name, *at]) == 0
    assert capsys.readouterr().out == f"{name}: it happened\n"


def test_a_reset_says_that_the_boards_must_come_up_again(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    loop, at = bench
    loop.reply = lambda asked: Replied(asked.number, True, "fault -> offline (reset)")
    assert main(["reset", *at]) == 0
    assert capsys.readouterr().out == (
        "fault -> offline (reset); the boards are brought up again, and `hil status` says what is missing "
        "until the state is ready\n"
    )


def test_a_refusal_is_an_error_with_status_1(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    loop, at = bench
    loop.reply = lambda asked: Replied(asked.number, False, "arm refused in state offline")
    assert main(["arm", *at]) == 1
    assert capsys.readouterr().err == "hil arm: arm refused in state offline\n"


@pytest.mark.parametrize("name", [name for name in OPERATION if name not in ("daemon",)])
def test_without_a_daemon_each_command_says_what_to_start(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = {
        "setpoint": ["vertical=0.1"],
        "controller": ["vertical=ppid"],
        "jog": ["vertical=1"],
        "event": ["payload:3"],
        "record": ["new"],
    }
    assert main([name, *values.get(name, []), "--socket", str(tmp_path / "none")]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"hil {name}: no daemon runs at ")
    assert "start one with `hil daemon`" in error


def test_arm_sends_its_overrides(bench: Bench) -> None:
    loop, at = bench
    assert main(["arm", *at]) == 0
    assert main(["arm", "--override", "SCHED_FIFO", "memory-lock", *at]) == 0
    calls = [asked.call for asked in loop.asked]
    assert calls == [ArmCall(id=1), ArmCall(id=1, override=("SCHED_FIFO", "memory-lock"))]


def test_an_unknown_override_is_refused_before_the_loop_sees_it(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    loop, at = bench
    assert main(["arm", "--override", "position-vertica", *at]) == 1
    assert capsys.readouterr().err.endswith("did you mean position-vertical?\n")
    assert loop.asked == []


@pytest.mark.parametrize("command", [["run"], ["collect", "--axis", "vertical", "--dry-run"]])
def test_an_unknown_override_of_a_run_is_refused(
    command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command, "--lockstep", "--override", "foo"]) == 2
    assert "--override foo: no check has this name" in capsys.readouterr().err


def test_setpoints_are_numbers_or_texts(bench: Bench) -> None:
    loop, at = bench
    assert main(["setpoint", "vertical=0.05", "rotation=sine:0.1@0/4", *at]) == 0
    assert [asked.call for asked in loop.asked] == [
        SetpointsCall(
            id=1,
            setpoints=(
                AxisSetpoint("vertical", "step:0.05@0"),
                AxisSetpoint("rotation", "sine:0.1@0/4"),
            ),
        )
    ]


def test_the_table_of_a_setpoint_is_read_here_and_checked_by_the_server(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    loop, at = bench
    table = tmp_path / "t.csv"
    table.write_text("0,0\n1,0.05\n")
    assert main(["setpoint", f"vertical=csv:{table}", *at]) == 0
    (asked,) = loop.asked
    given = AxisSetpoint("vertical", f"csv:{table}", "0,0\n1,0.05\n")
    assert asked.call == SetpointsCall(id=1, setpoints=(given,))
    (read,) = asked.tables
    assert (read.times, read.values) == ((0.0, 1.0), (0.0, 0.05))
    table.write_text("0,0\n1,9\n")
    assert main(["setpoint", f"vertical=csv:{table}", *at]) == 1
    assert "setpoint refused: vertical: setpoint" in capsys.readouterr().err
    table.write_text("\n")
    assert main(["setpoint", f"vertical=csv:{table}", *at]) == 2
    assert "t.csv: the file is empty; write one or more rows of time_s,setpoint" in capsys.readouterr().err
    table.write_text("0,0\n")
    assert main(["setpoint", "elbow=csv:" + str(table), *at]) == 1
    assert "there is no axis 'elbow'" in capsys.readouterr().err
    assert main(["setpoint", f"vertical=csv:{tmp_path / 'none.csv'}", *at]) == 2
    assert "none.csv: cannot be read" in capsys.readouterr().err
    assert len(loop.asked) == 1


def test_a_controller_is_a_file_or_a_shipped_one(bench: Bench) -> None:
    loop, at = bench
    assert main(["controller", "vertical=ppid", *at]) == 0
    (call,) = [asked.call for asked in loop.asked]
    assert isinstance(call, ControllerCall)
    assert (call.axis, call.name) == ("vertical", "ppid.json")
    assert '"hil-controller"' in call.document


def test_controllers_of_several_axes_are_all_changed_or_none(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    loop, at = bench
    broken = tmp_path / "broken.json"
    broken.write_text("{}")
    assert main(["controller", "vertical=ppid", f"horizontal={broken}", *at]) == 1
    assert "controller refused: " in capsys.readouterr().err
    assert loop.asked == []
    assert main(["controller", "vertical=ppid", "horizontal=hls", *at]) == 0
    assert capsys.readouterr().out == "vertical: done\nhorizontal: done\n"
    assert [asked.call.axis for asked in loop.asked if isinstance(asked.call, ControllerCall)] == [
        "vertical",
        "horizontal",
    ]


def test_a_jog_is_one_request_if_it_is_short(bench: Bench) -> None:
    loop, at = bench
    assert main(["jog", "vertical=-0.5", "--for", "0.2s", *at]) == 0
    (call,) = [asked.call for asked in loop.asked]
    assert isinstance(call, JogCall)
    assert (call.axis, call.offset_v) == ("vertical", -0.5)
    assert 0.19 < call.duration_s <= 0.2


def test_a_jog_says_how_far_the_axis_moved(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    loop, at = bench
    loop.send_status()
    while main(["status", *at]) != 0:
        pass
    capsys.readouterr()
    assert main(["jog", "vertical=0.5", *at]) == 0
    assert capsys.readouterr().out == "vertical moved from +0.0123 to +0.0123 m; its valve is centred\n"


class StandingTime:
    """A clock that stands still, and on which nobody may sleep."""

    def monotonic(self) -> float:
        return 100.0

    def sleep(self, duration_s: float) -> None:
        raise AssertionError(f"slept for {duration_s} s")


def test_a_jog_waits_for_the_status_in_which_it_is_over(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    loop, at = bench
    loop.send_status(state="armed")
    while main(["status", *at]) != 0:
        pass
    capsys.readouterr()

    def begin(asked: Asked) -> Replied:
        loop.send_status(state="running")
        return Replied(asked.number, True, "jog begins")

    loop.reply = begin
    watched: list[str] = []

    def watch(client: Client, interval_s: float) -> Iterator[Status]:
        for look in real_watch(client, interval_s):
            watched.append(look.state)
            yield look
            if len(watched) == 3:
                loop.send_status(state="armed", axes=(AxisStatus("vertical", "m", 0.0, 0.02, 0.0, 0.0, 5.0),))

    real_watch = Client.watch
    monkeypatch.setattr(Client, "watch", watch)
    monkeypatch.setattr(operate, "time", StandingTime())
    assert main(["jog", "vertical=0.5", *at]) == 0
    assert capsys.readouterr().out == "vertical moved from +0.0123 to +0.0200 m; its valve is centred\n"
    assert watched[:3] == ["running"] * 3
    assert watched[-1] == "armed"


def test_a_jog_does_not_wait_for_controllers_that_somebody_else_started(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    loop, at = bench
    loop.send_status(state="running")
    while main(["status", *at]) != 0:
        pass
    capsys.readouterr()
    assert main(["jog", "vertical=0.5", *at]) == 0
    assert capsys.readouterr().out.endswith("m; the daemon is still running\n")


def test_a_jog_is_not_longer_than_a_person_can_watch(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["jog", "vertical=0.5", "--for", "60s"])
    assert "'60s' is longer than 10 s" in capsys.readouterr().err


def test_a_long_jog_is_repeated_in_parts(bench: Bench) -> None:
    """So the axis stops soon after this command ends."""
    loop, at = bench
    assert main(["jog", "vertical=0.5", "--for", "500ms", *at]) == 0
    durations = [asked.call.duration_s for asked in loop.asked if isinstance(asked.call, JogCall)]
    assert len(durations) >= 2
    assert max(durations) <= 0.3


class PausedTime:
    """A clock that sleeping advances. The third sleep lasts for an hour, because the process is stopped."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.sleeps = 0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        self.sleeps += 1
        self.now_s += 3600.0 if self.sleeps == 3 else duration_s


def test_a_jog_that_was_paused_does_not_begin_again(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    loop, at = bench
    monkeypatch.setattr(operate, "time", PausedTime())
    assert main(["jog", "vertical=0.5", "--for", "9s", *at]) == 1
    assert "paused for 3600.0 s and the axis has stopped" in capsys.readouterr().err
    assert sum(isinstance(asked.call, JogCall) for asked in loop.asked) == 3


def test_a_shutdown_of_a_daemon_that_ends_meanwhile_does_not_claim_that_the_valves_are_centred(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with ending(tmp_path / "s") as path:
        assert main(["shutdown", "--socket", str(path)]) == 1
    error = capsys.readouterr().err
    assert error.startswith("hil shutdown: the daemon has ended without an answer")
    assert "Its log says whether it centred the valves" in error
    with ending(tmp_path / "s") as path:
        assert main(["arm", "--socket", str(path)]) == 1
    assert capsys.readouterr().err == f"hil arm: {path}: the daemon closed the connection\n"


def test_a_shutdown_says_that_a_daemon_does_not_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(operate, "SHUTDOWN_TIMEOUT_S", 0.0)
    with served(tmp_path) as (loop, path):  # has the socket until the end of this block

        def reply(asked: Asked) -> None:
            loop.send(Replied(asked.number, True, "the daemon ends"))
            loop.end.shutdown(2)

        loop.reply = reply
        assert main(["shutdown", "--socket", str(path)]) == 1
    error = capsys.readouterr().err
    assert "the daemon has taken the request, but" in error
    assert "is still in use after 0 s, the limit" in error


def test_an_event_is_checked_by_the_daemon(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    loop, at = bench
    assert main(["event", "payload:3", *at]) == 1
    assert "only simulated boards have events" in capsys.readouterr().err
    assert not any(isinstance(asked.call, EventCall) for asked in loop.asked)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["jog", "vertical"], "the axis or the value is missing; write vertical=+0.5"),
        (["jog", "vertical=fast"], "'fast' is not a number of volts"),
        (["setpoint", "vertical"], "the axis or the value is missing; write vertical=0.05"),
        (["setpoint", "horizontal="], "the value is missing; write horizontal=0.05"),
        (["setpoint", "0.05"], "the axis is missing; write vertical=0.05"),
        (["setpoint", "vertical", "0.1"], "'vertical' and '0.1' belong together; write vertical=0.1"),
        (["controller", "vertical=nosuch"], "there is no file nosuch"),
    ],
)
def test_wrong_values_have_status_2(
    bench: Bench, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*arguments, *bench[1]]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["setpoint", "--setpoint", "vertical=0.1"],
            "is an option of `hil run`; write hil setpoint vertical=0.1",
        ),
        (["controller", "--controller", "vertical=hls"], "write hil controller vertical=hls"),
        (["event", "--event"], "write hil event payload:3"),
        (["record"], "required: new|stop"),
    ],
)
def test_wrong_arguments_say_what_to_write(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("text", ["0", "0ms", "soon", "s", "nan", "1min"])
def test_wrong_durations(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["jog", "vertical=1", "--for", text])
    assert text in capsys.readouterr().err


@pytest.mark.parametrize("name", OPERATION)
def test_help_fits_80_columns(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert command_module(name) is not None
    with pytest.raises(SystemExit) as caught:
        main([name, "--help"])
    assert caught.value.code == 0
    assert all(len(line) <= 80 for line in capsys.readouterr().out.splitlines())


def test_the_status_as_a_text(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    loop, at = bench
    loop.send_status()
    main(["arm", *at])  # so that the status has arrived
    capsys.readouterr()
    assert main(["status", *at]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "ready     can7, period 100 of 11.2 ms",
        "timing    late up to 0.12 ms in the last 0.1 s, up to 6.50 ms since the start",
        "counts    since the start: 2 periods missed, 0 frames rejected, 0 samples lost",
        "  vertical      +0.0123 m    setpoint  +0.0500 m    valve  6.20 V",
        "  rotation      unknown rad  setpoint  unknown rad  valve  5.00 V",
        "record    runs/one.mcap",
    ]


def test_the_status_as_json_and_a_fault(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    loop, at = bench
    loop.send_status(state="fault", fault="adc: lost")
    main(["arm", *at])
    capsys.readouterr()
    assert main(["status", "--json", *at]) == 1
    shown = json.loads(capsys.readouterr().out)
    assert (shown["fault"], shown["axes"][1]["position"]) == ("adc: lost", None)


def test_status_lines_name_what_is_wrong() -> None:
    lines = status_lines(status(state="fault", fault="adc: lost", recording=None))
    assert lines[-3:] == [
        "record    nothing is recorded",
        "fault     adc: lost",
        "          remove the cause, then `hil reset`",
    ]
    offline = status_lines(status(state="offline", readiness="adc silent"))
    assert offline[-1] == "boards    adc silent"


def looks() -> list[Status]:
    return [status(log=(LogLine(0, 30, "loop", "late"),)), status(state="armed")]


def test_watching_shows_the_log_above_the_status(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert show_live(looks()) == status(state="armed")
    shown = capsys.readouterr().out
    assert "warning  loop: late\nready " in shown
    assert "\x1b" not in shown
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    show_live(looks())
    assert "\x1b[6F\x1b[Jarmed" in capsys.readouterr().out


def test_each_look_is_a_line_of_json(capsys: pytest.CaptureFixture[str]) -> None:
    show_json(looks())
    assert [json.loads(line)["state"] for line in capsys.readouterr().out.splitlines()] == ["ready", "armed"]
    show_text(looks())
    assert "armed" in capsys.readouterr().out


def test_watch_ends_with_the_daemon(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with served(tmp_path) as (loop, path):
        loop.send_status()
        loop.end.shutdown(2)
        assert main(["status", "--watch", "--interval", "0.05", "--socket", str(path)]) in (0, 1)


def test_the_status_shows_overridden_checks() -> None:
    lines = status_lines(status(overridden_checks=("SCHED_FIFO", "memory-lock")))
    assert "override  armed although these checks fail: SCHED_FIFO, memory-lock" in lines
    assert not any(line.startswith("override") for line in status_lines(status()))


def test_the_status_says_that_positions_are_old() -> None:
    assert "samples   the last good one is 12.3 s old: positions are those of then" in status_lines(
        status(sample_age_s=12.34)
    )
    for age_s in (None, 0.0224):
        assert not any(line.startswith("samples") for line in status_lines(status(sample_age_s=age_s)))


def test_a_long_fault_does_not_push_the_status_up_on_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "80")
    fault = "adc: no good sample for 5 periods, limit 5 ; " + "check the cable " * 20
    show_live([status(state="fault", fault=fault), status(state="fault", fault=fault)])
    first, second = capsys.readouterr().out.split("\x1b[", 1)
    rows = first.splitlines()
    assert max(map(len, rows)) <= 80
    assert second.startswith(f"{len(rows)}F"), "up to the first row"
    assert "fault     adc: no good sample" in first
    assert any(row.startswith("          check the cable") for row in rows)
