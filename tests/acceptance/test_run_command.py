"""``hil run`` as a user calls it: the simulated rig in real time, files, signals, and errors."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from hil.cli import main, run_parts
from hil.core.life_cycle import LifeCycleState
from hil.core.output import LogEntry, Severity
from hil.recording.reader import Recording
from hil.shells.replay import verify
from hil.views.summary import StepResponse, summarise

HIL = [sys.executable, "-m", "hil.cli"]


@pytest.mark.real_time
def test_simulated_rig_in_real_time(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    setpoints = ["--setpoint", "vertical=step:0.05@0.1", "--setpoint", "rotation=minimum-jerk:0.3@0.1/1"]
    command = [*HIL, "run", "--duration", "3", "--record", str(path), *setpoints]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    for word in ("vertical", "over-", "shoot", "settling", str(path)):
        assert word in done.stdout.lower().replace("\n", "")
    recording = Recording(path)
    assert recording.complete
    assert verify(recording).frames_compared > 200
    vertical = recording.axis("vertical")
    assert vertical["position"][vertical["state"] == LifeCycleState.RUNNING][-1] == pytest.approx(
        0.05, abs=0.002
    )
    assert path.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    assert set(recording.metadata["rights"]) >= {"SCHED_FIFO", "memory lock"}


@pytest.mark.real_time
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_the_run_with_centred_valves(tmp_path: Path, number: signal.Signals) -> None:
    path = tmp_path / "run.mcap"
    command = [*HIL, "run", "--duration", "600", "--record", str(path), "--setpoint", "vertical=sine:0.1@0/1"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as run:
        assert run.stderr is not None
        for line in run.stderr:
            if "-> running" in line:
                break
        run.send_signal(number)
        out, _ = run.communicate(timeout=60)
    assert run.returncode == 0
    assert "recording" in out
    recording = Recording(path)
    assert recording.metadata["ending"]["reason"] == "interrupted"
    last = recording.axis("vertical")[-1]
    assert last["state"] == LifeCycleState.ARMED
    assert last["command_v"] == 5.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--setpoint", "vertical=step:0.2@1"], ["0.2 m", "0.15 m", "axes.vertical.max_y"]),
        (["--setpoint", "vertical=jump:1"], ["jump:1", "step:SIZE@TIME"]),
        (["--setpoint", "step:0.1@1"], ["--setpoint 'step:0.1@1'", "write --setpoint vertical=step:0.1@1"]),
        (["--setpoint", "0.07"], ["--setpoint '0.07'", "write --setpoint vertical=0.07"]),
        (["--controller", "ppid"], ["--controller 'ppid'", "write --controller vertical=ppid"]),
        (["--setpoint", "elbow=step:0.1@1"], ["elbow", "vertical, horizontal, rotation"]),
        (["--setpoint", "vertical"], ["--setpoint 'vertical'", "write --setpoint vertical=step:0.1@1"]),
        (
            ["--setpoint", "vertical=step:0@1", "--setpoint", "vertical=step:0@2"],
            ["--setpoint vertical is given twice", "step:0@2"],
        ),
        (
            ["--scenario", "bad.toml"],
            ["scenario bad.toml: setpoints.rotation: setpoint 'hop' is neither a number, such as 0.05"],
        ),
        (["--bus", "pty"], ["firmware-sim --bus pty"]),
        (["--bus", "inproc:x"], ["'inproc:x' is a bus inside one process", "slcan:DEVICE"]),
        (["--rig", "bad.toml"], ["bad.toml: this is a scenario, not a rig file", "hil run --scenario FILE"]),
        (["--rig", "pipe"], ["pipe: is a named pipe (FIFO), not a regular file"]),
        (["--arm", "/dev/zero"], ["/dev/zero: is a device, not a regular file"]),
        (["--controller", "vertical=nosuch.json"], ["nosuch.json", "ppid"]),
        (["--controller", "rotation=zn"], ["rotation", "input_unit", "rad"]),
        (["--rig", "nosuch.toml"], ["nosuch.toml", "No such file"]),
        (["--bus", "vcan77"], ["vcan77"]),
        (["--bus", "carrier pigeon"], ["carrier pigeon", "slcan:"]),
    ],
)
def test_wrong_arguments_are_explained(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    words: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    Path("bad.toml").write_text('title = "bad"\nduration_s = 1.0\nsetpoints.rotation = "hop"\n')
    assert main(["run", "--duration", "1", *arguments]) == 2
    error = capsys.readouterr().err
    assert "Traceback" not in error
    for word in words:
        assert word in error
    assert not list(tmp_path.rglob("*.mcap"))


def test_a_number_alone_is_a_setpoint_that_stays(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    given = ["--record", str(path), "--setpoint", "vertical=0.05", "--no-plot"]
    assert main(["run", "--lockstep", "--duration", "2", *given]) == 0
    vertical = Recording(path).axis("vertical")
    running = vertical[vertical["state"] == LifeCycleState.RUNNING]
    assert len(running) > 100
    assert set(running["setpoint"]) == {0.05}
    assert verify(Recording(path)).frames_compared > 0


def test_an_existing_recording_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"precious")
    assert main(["run", "--lockstep", "--duration", "1", "--record", str(path)]) == 2
    assert "run.mcap" in capsys.readouterr().err
    assert path.read_bytes() == b"precious"


@pytest.mark.real_time
def test_silent_bus_is_explained(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    command = [*HIL, "run", "--bus", "udp:43999", "--duration", "1", "--record", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "boards did not come up" in done.stdout.lower().replace("\n", " ")


def test_a_file_that_another_run_has_just_created_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two runs without a given name may begin within one second."""
    monkeypatch.chdir(tmp_path)
    taken = Path("runs/20260101-000000.mcap")
    names = iter([taken, taken, Path("runs/20260101-000000-2.mcap")])
    taken.parent.mkdir()
    taken.write_bytes(b"precious")
    monkeypatch.setattr("hil.cli.run.recording_path", lambda *_args, **_kwargs: next(names))
    assert main(["run", "--lockstep", "--linear", "--duration", "0.1"]) == 0
    assert Recording(Path("runs/20260101-000000-2.mcap")).complete
    assert taken.read_bytes() == b"precious"
    names = iter([taken])
    assert main(["run", "--lockstep", "--duration", "0.1", "--record", str(taken)]) == 2


def test_planned_events_are_recorded_and_one_after_the_end_is_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    events = ["--event", "payload:1@0.2", "--event", "payload:2@1", "--event", "payload:3@9"]
    assert main(["run", "--lockstep", *events, "--duration", "1", "--record", str(path)]) == 0
    recording = Recording(path)
    assert [event for _, event in recording.log() if event.source == "arm"] == [
        LogEntry(Severity.INFO, "arm", "planned: payload:1@0.2 (seconds from the first sample on)"),
        LogEntry(
            Severity.WARNING,
            "arm",
            "payload:2@1 may not happen: the run ends about 1 s after the first sample",
        ),
        LogEntry(
            Severity.WARNING,
            "arm",
            "payload:3@9 may not happen: the run ends about 1 s after the first sample",
        ),
        LogEntry(Severity.INFO, "arm", "payload:1@0.2 begins"),
        LogEntry(Severity.INFO, "arm", "payload:2@1 begins"),
        LogEntry(
            Severity.WARNING,
            "arm",
            "payload:3@9 did not begin: the run ended before 9 s had passed since the first sample",
        ),
    ]
    assert recording.metadata["arm events"] == {
        "payload:1@0.2": "0.2",
        "payload:2@1": "1.0",
        "payload:3@9": "9.0",
    }
    first_ns = next(at_ns for at_ns, event in recording.log() if event.text == "payload:1@0.2 begins")
    second_ns = next(at_ns for at_ns, event in recording.log() if event.text == "payload:2@1 begins")
    assert second_ns - first_ns == 800_000_000
    assert verify(recording).complete


def test_each_axis_of_the_shipped_rig_follows_its_step(tmp_path: Path) -> None:
    """The rotation moves the horizontal axis too. Their steps are apart, so that the readings do not mix."""
    path = tmp_path / "run.mcap"
    assert main(["run", "--lockstep", "--record", str(path)]) == 0
    axes = summarise(Recording(path)).axes
    assert list(axes) == ["vertical", "horizontal", "rotation"]
    for axis in axes.values():
        assert isinstance(axis, StepResponse)
        assert axis.overshoot_percent < 1.0
        assert axis.settling_s is not None
        assert axis.settling_s < 1.6


def test_rejected_samples_are_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    assert main(["run", "--lockstep", "--event", "broken-wire:vertical@0", "--record", str(path)]) == 1
    output = capsys.readouterr().out
    assert "adc operational; dac operational; last sample rejected: vertical: potentiometer 0.000 V" in output
    assert "Check the bus" not in output


@pytest.mark.real_time
@pytest.mark.parametrize("is_wanted", [False, True])
def test_an_internal_error_ends_the_run_and_is_reported_without_a_traceback(
    tmp_path: Path, is_wanted: bool
) -> None:
    path = tmp_path / "run.mcap"
    program = (
        "import sys; from hil.cli import main; from hil.shells import realtime\n"
        "realtime._receive = lambda *_: 1 / 0\n"
        f"sys.exit(main(['run', '--bus', 'udp:43998', '--record', {str(path)!r}]))\n"
    )
    environment = os.environ | ({"HIL_TRACEBACK": "1"} if is_wanted else {})
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment, check=False)
    assert done.returncode == 1
    assert "internal error: ZeroDivisionError: division by zero" in done.stdout.replace("\n", " ")
    assert "Please report it" in done.stdout
    assert ("Traceback" in done.stderr) == is_wanted
    recording = Recording(path)
    assert "ZeroDivisionError" in recording.metadata["error"]["traceback"]
    assert recording.metadata["ending"]["reason"] == "internal error"
    assert recording.log()[-1][1].severity is Severity.FATAL
    assert verify(recording).complete


def test_signals_end_the_program_only_after_the_recording_is_closed() -> None:
    """A second Ctrl-C ends summary and plots, which may take long."""
    given = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    try:
        with run_parts.stop_on_signals() as stop:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)
            assert stop.is_set
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, given)


def test_the_plot_is_drawn_even_if_nobody_reads_the_output(tmp_path: Path) -> None:
    """For example ``hil run | head -1``."""
    path = tmp_path / "run.mcap"
    command = [*HIL, "run", "--lockstep", "--duration", "1", "--record", str(path)]
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    os.close(writer)
    assert done.stderr == ""
    assert path.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("arguments", [["--help"], ["rig"], ["run", "--lockstep", "--duration", "0.1"]])
def test_output_that_finds_no_room_is_an_error(tmp_path: Path, arguments: list[str]) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*HIL, *arguments], stdout=full, stderr=subprocess.PIPE, text=True, check=False, cwd=tmp_path
        )
    assert done.returncode == 1
    assert done.stderr == "hil: output: No space left on device\n"


@pytest.mark.real_time
@pytest.mark.parametrize(("run", "closed"), [("--lockstep", ">&-"), ("--linear", "<&- >&- 2>&-")])
def test_a_run_with_closed_descriptors(tmp_path: Path, run: str, closed: str) -> None:
    path = tmp_path / "run.mcap"
    command = f"{sys.executable} -m hil.cli run {run} --duration 0.5 --record {path} {closed}"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=60, check=False)
    assert "Traceback" not in done.stdout + done.stderr
    assert done.returncode == 0
    assert verify(Recording(path)).complete
    assert path.with_suffix(".png").exists()


def test_a_terminal_without_unicode_gets_what_it_can_show(tmp_path: Path) -> None:
    done = subprocess.run(
        [*HIL, "run", "--lockstep", "--duration", "1.5", "--record", str(tmp_path / "run.mcap")],
        capture_output=True,
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
        check=True,
    )
    assert b"0?0.1 m" in done.stdout


def test_a_recording_with_the_name_of_a_picture_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", "--record", "run.png"]) == 2
    assert "run.png: a recording's name ends in .mcap" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


HOSTILE = "from pathlib import Path; Path(r'{log}').open('a').write(__name__ + ' '); raise SystemExit(3)"


@pytest.mark.real_time
@pytest.mark.parametrize("options", [["--duration", "0.5"], ["--lockstep", "--duration", "0.5"]])
def test_no_process_of_a_run_imports_modules_from_the_working_directory(
    tmp_path: Path, options: list[str]
) -> None:
    """Boards, display and recorder are processes of their own, and are started in the working directory."""
    log, here = tmp_path / "imported", tmp_path / "here"
    here.mkdir()
    for name in ("json", "socket", "signal", "argparse", "rich", "msgspec", "struct", "typing", "hil"):
        (here / f"{name}.py").write_text(HOSTILE.format(log=log))
    command = [sys.executable, "-P", "-m", "hil.cli", "run", *options, "--record", "run.mcap"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=here, check=False)
    assert not log.exists(), log.read_text()
    assert done.returncode == 0, done.stderr
    assert ("-> running" in done.stderr) == ("--lockstep" not in options), "the display ran"
    assert verify(Recording(here / "run.mcap")).complete


FAST_PID = (
    '{{"format": "hil-controller", "version": 1, "name": "fast", "description": "", "sample_time_s": 0.001, '
    '"input_unit": "{unit}", "output_unit": "V", "law": {{"kind": "pid", "kp": 11.0, "ki": 5.6}}, '
    '"origin": {{}}}}'
)


class TestLinear:
    """``--linear`` puts eq. (15) on every axis."""

    @staticmethod
    def names(path: Path) -> dict[str, str]:
        attachments = Recording(path).attachments
        return {
            Path(name).stem: json.loads(text)["name"]
            for name, text in attachments.items()
            if name.startswith("controllers/")
        }

    def test_without_a_rig_file_the_controllers_are_those_for_eq_15(self, tmp_path: Path) -> None:
        path = tmp_path / "run.mcap"
        arguments = ["run", "--lockstep", "--linear", "--duration", "0.1", "--record", str(path)]
        assert main([*arguments, "--controller", "horizontal=zn"]) == 0
        assert self.names(path) == {"vertical": "ppid", "horizontal": "zn", "rotation": "ppid_rad"}

    def test_the_controllers_of_a_rig_file_are_kept(self, tmp_path: Path) -> None:
        rig, path = tmp_path / "rig.toml", tmp_path / "run.mcap"
        assert main(["rig", "--init", str(rig)]) == 0
        rig.write_text(rig.read_text().replace('controller = "ppid"', 'controller = "hls"'))
        arguments = ["--lockstep", "--linear", "--rig", str(rig), "--duration", "0.1", "--record", str(path)]
        assert main(["run", *arguments]) == 0
        assert self.names(path) == {"vertical": "hls", "horizontal": "horizontal", "rotation": "rotation"}

    def test_a_loop_of_1_khz_with_controllers_of_its_own(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """The time-outs of the shipped file hold at any period; its controllers are not checked."""
        monkeypatch.chdir(tmp_path)
        assert main(["rig", "--init"]) == 0
        rig = Path("rig.toml")
        rig.write_text(rig.read_text().replace("period_s = 0.0112", "period_s = 0.001"))
        for unit in ("m", "rad"):
            Path(f"{unit}.json").write_text(FAST_PID.format(unit=unit))
        controllers = ["vertical=m.json", "horizontal=m.json", "rotation=rad.json"]
        options = [part for controller in controllers for part in ("--controller", controller)]
        arguments = ["run", "--lockstep", "--linear", "--rig", "rig.toml", "--duration", "3", *options]
        assert main([*arguments, "--record", "run.mcap"]) == 0
        recording = Recording(Path("run.mcap"))
        assert recording.metadata["ending"]["reason"] == "completed"
        assert recording.metadata["ending"]["fault"] == ""
        assert recording.axis("vertical")["position"][-1] == pytest.approx(0.1, abs=0.01)
        assert verify(recording).complete


@pytest.mark.parametrize(
    ("setpoint", "first"),
    [("step:0.05@0", "0.05 m"), ("csv:r.csv", "-0.02 m"), ("step:0.05@0.5", None), ("sine:0.05@0/1", None)],
)
def test_a_setpoint_that_does_not_begin_at_0_is_a_warning(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    setpoint: str,
    first: str | None,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("r.csv").write_text("0,-0.02\n0.5,0.05\n")
    arguments = ["run", "--lockstep", "--duration", "0.2", "--record", "run.mcap"]
    assert main([*arguments, "--setpoint", f"vertical={setpoint}"]) == 0
    warnings = [
        entry.text for _, entry in Recording(Path("run.mcap")).log() if entry.severity > Severity.INFO
    ]
    if first is None:
        assert warnings == []
        return
    (warning,) = warnings
    assert warning.startswith(f"the setpoint begins at {first}: control begins without a jump of the valve")
    assert f"vertical: {warning}" in capsys.readouterr().err


def test_a_folder_whose_name_looks_like_markup(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", "--lockstep", "--duration", "0.2", "--record", "a[/b] [red]/run 1.mcap"]) == 0
    output = capsys.readouterr()
    assert output.err == "hil run: created the folder a[/b] [red]\n"
    assert "recording  a[/b] [red]/run 1.mcap" in output.out
    assert "next       hil replay 'a[/b] [red]/run 1.mcap'" in output.out


def test_a_recording_is_verified_without_an_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.mcap"
    assert main(["run", "--lockstep", "--duration", "0.2", "--record", str(path)]) == 0
    capsys.readouterr()
    for arguments in (["replay", str(path)], ["replay", "--verify", str(path)]):
        assert main(arguments) == 0
        assert capsys.readouterr().out.startswith(f"identical  {path}: ")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0", "'0' must be more than 0 s"),
        ("-1", "'-1' must be more than 0 s"),
        (
            "nan",
            "'nan' is not a time; write seconds, or a number with the unit ms, s, min or h, such as 0.2s",
        ),
        ("1e300", "'1e300' is more than the limit 86400000 s (1000 days)"),
        ("24001h", "'24001h' is more than the limit 86400000 s (1000 days)"),
    ],
)
def test_an_impossible_duration_is_refused(text: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["run", "--duration", text])
    assert caught.value.code == 2
    assert f"hil run: argument --duration: {said}\n" in capsys.readouterr().err


def test_a_run_of_1000_days_that_finds_no_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "statvfs", lambda _path: SimpleNamespace(f_bavail=10**6, f_frsize=1000))
    assert main(["run", "--duration", "86400000", "--record", "run.mcap"]) == 2
    error = capsys.readouterr().err
    assert "1 GB are free on this disk, but 1000 days may need 4.32 TB" in error
