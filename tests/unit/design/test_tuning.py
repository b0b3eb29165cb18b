"""The steps of a tuning that move nothing: results folders, setpoints of the verification, processes."""

from __future__ import annotations

import io
import math
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import msgspec
import pytest
from support.constants import PERIOD_S
from support.recorded_runs import following, lag, record_run, step

from design import tune_command, tuning, tuning_experiments
from design.output.tuning_results import Condition, Job, Model
from design.tuning import claim_folder, last_step
from design.tuning_experiments import APPROACH_S, REST_S, start_position, step_command, step_setpoint
from hil.cli import main
from hil.core.errors import DocumentError, HilError
from hil.core.setpoints import parse_setpoint
from hil.recording import open_recording
from hil.views.summary import StepResponse

NOMINAL = Condition(name="nominal")
JOB = Job("vertical", 0.4, 60.0, "OE(1,3,1)", [NOMINAL])
REAL = msgspec.structs.replace(JOB, bus="can0")


def with_experiment(folder: Path, job: Job = JOB) -> Path:
    claim_folder(folder, job)
    (folder / "nominal-1.mcap").write_bytes(b"")
    return folder


class TestResultsFolder:
    def test_an_empty_folder_is_claimed_and_the_same_job_resumes(self, tmp_path: Path) -> None:
        assert not claim_folder(tmp_path / "out", JOB)
        assert claim_folder(with_experiment(tmp_path / "out"), JOB)

    def test_every_option_that_differs_is_named_with_both_values(self, tmp_path: Path) -> None:
        other = msgspec.structs.replace(JOB, amplitude=0.3, bus="can0")
        with pytest.raises(DocumentError) as refused:
            claim_folder(with_experiment(tmp_path), other)
        text = str(refused.value)
        assert "holds the results of another tuning" in text
        assert "--amplitude was 0.4, and is 0.3 now; --bus was not given, and is can0 now" in text
        assert "another --out" in text

    def test_other_conditions_and_other_contents_are_named(self, tmp_path: Path) -> None:
        folder = with_experiment(tmp_path, msgspec.structs.replace(JOB, digests={"rig.toml": "0"}))
        other = msgspec.structs.replace(JOB, conditions=[Condition(name="other")], digests={"rig.toml": "1"})
        with pytest.raises(DocumentError, match=r"names other conditions; rig\.toml has other content now"):
            claim_folder(folder, other)

    def test_a_folder_without_a_complete_experiment_is_taken_over(self, tmp_path: Path) -> None:
        claim_folder(tmp_path, JOB)
        (tmp_path / "partial-nominal-1.mcap").write_bytes(b"")
        other = msgspec.structs.replace(JOB, amplitude=0.3)
        assert not claim_folder(tmp_path, other)
        assert claim_folder(with_experiment(tmp_path, other), other)

    def test_unreadable_options_are_refused_with_the_reason(self, tmp_path: Path) -> None:
        (tmp_path / "tune.json").write_text("{}")
        with pytest.raises(DocumentError, match=r"whose options cannot be read.*axis.*another --out"):
            claim_folder(tmp_path, JOB)

    def test_a_folder_with_other_files_is_left_alone(self, tmp_path: Path) -> None:
        (tmp_path / "thesis.tex").write_text("")
        with pytest.raises(DocumentError, match="holds no tuning; give another --out"):
            claim_folder(tmp_path, JOB)


class TestWhatIsCheckedFirst:
    """A wrong value ends the command with status 2 before a folder exists."""

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (["--lockstep", "--duration", "-5"], "--duration: -5 s is not over 0 s"),
            (["--lockstep", "--duration", "0.001"], "duration 0.001 s is 0 periods"),
            (["--lockstep", "--duration", "1e8"], "give 2 to 2000000 periods"),
            (["--lockstep", "--amplitude", "0"], "--amplitude: 0 V is not over 0 V"),
            (
                ["--lockstep", "--amplitude", "50"],
                "hil tune: --amplitude: the excitation reaches 50 V, limit 4.9996 V",
            ),
            (["--lockstep", "--step", "0"], "--step: a step of 0 shows no response"),
            (["--bus", "can9", "--yes"], "can9: this machine has no interface can9"),
            (["--bus", "foo:bar", "--yes"], "'foo:bar' names no bus"),
        ],
    )
    def test_a_wrong_value_leaves_no_folder(
        self, options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        out = tmp_path / "out"
        assert main(["tune", "--axis", "vertical", *options, "--out", str(out)]) == 2
        assert message in capsys.readouterr().err
        assert not out.exists()

    def test_a_wrong_value_is_reported_before_the_difference_to_an_earlier_tuning(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        folder = with_experiment(tmp_path)
        arguments = ["tune", "--axis", "vertical", "--lockstep", "--duration", "-5", "--out", str(folder)]
        assert main(arguments) == 2
        assert capsys.readouterr().err == "hil tune: --duration: -5 s is not over 0 s\n"

    @pytest.mark.parametrize("is_recorded", [False, True])
    def test_a_failure_names_the_recording_only_if_it_exists(
        self, is_recorded: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def fail(_arguments: list[str], *, captured: bool) -> tuple[int, str]:
            if is_recorded:
                (tmp_path / "partial-1.mcap").write_bytes(b"")
            return 2, "no bus"

        monkeypatch.setattr(tuning_experiments, "_run", fail)
        with pytest.raises(tuning_experiments.ExperimentError) as failed:
            tuning_experiments.run_experiment(tmp_path / "1.mcap", ["collect", "--lockstep"])
        named = f"; its recording is {tmp_path}/partial-1.mcap" if is_recorded else ""
        assert str(failed.value) == f"`hil collect --lockstep` ended with exit status 2{named}:\nno bus"


class TestSetpointOfAVerification:
    SETTLING_S = 1.2
    STEP_S = APPROACH_S + REST_S + SETTLING_S

    def test_it_begins_where_the_axis_is_and_rests_before_the_step(self) -> None:
        setpoint = parse_setpoint("csv:step.csv", step_setpoint(-0.09, 0.08, 0.1, self.SETTLING_S))
        assert setpoint.at(0.0) == pytest.approx(-0.09)
        assert setpoint.at(APPROACH_S) == setpoint.at(self.STEP_S - 1e-6) == pytest.approx(0.08)
        assert setpoint.at(self.STEP_S) == setpoint.at(99.0) == pytest.approx(0.1)
        assert setpoint.max_speed == pytest.approx(1.875 * 0.17 / APPROACH_S, rel=0.01)

    def test_the_run_lasts_until_the_step_has_settled(self) -> None:
        command = step_command(JOB, NOMINAL, Path("c.json"), Path("s.csv"), self.SETTLING_S)
        duration_s = float(command[command.index("--duration") + 1])
        assert duration_s >= self.STEP_S + 3.0 * self.SETTLING_S
        assert "vertical=csv:s.csv" in command
        assert {"horizontal=hold", "rotation=hold", "--lockstep"} <= set(command)

    def test_the_simulated_arm_starts_as_before(self, tmp_path: Path) -> None:
        signals = following(step(0.1, 1.0), lag(0.1, 1.0, 0.2))
        record_run(tmp_path / "nominal-1.mcap", round(3.0 / PERIOD_S), signals)
        found = start_position(JOB, NOMINAL, Path("c.json"), tmp_path)
        assert found == pytest.approx(0.0, abs=1e-3)

    def test_on_a_bus_the_position_is_measured_while_every_axis_holds(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """The newest recording ended at 0.1 m, and the arm has been moved by hand since then."""
        record_run(tmp_path / "nominal-1.mcap", 300, following(step(0.1, 1.0), lag(0.1, 1.0, 0.2)))
        commands: list[list[str]] = []

        def hold(path: Path, command: list[str]) -> None:
            commands.append(command)
            record_run(path, 50, following(lambda _t: -0.02, lambda _t: -0.02))

        monkeypatch.setattr(tuning_experiments, "run_experiment", hold)
        found = start_position(REAL, NOMINAL, Path("c.json"), tmp_path)
        assert found == pytest.approx(-0.02, abs=1e-3)
        (command,) = commands
        assert command[:3] == ["run", "--controller", "vertical=c.json"]
        assert {"vertical=hold", "horizontal=hold", "rotation=hold", "can0"} <= set(command)


def test_the_readings_are_those_of_the_step_and_not_of_the_path_to_it(tmp_path: Path) -> None:
    settling_s, tau_s = 1.2, 0.2
    step_s = APPROACH_S + REST_S + settling_s
    setpoint = parse_setpoint("csv:step.csv", step_setpoint(0.0, 0.08, 0.1, settling_s))
    response = lag(0.02, step_s, tau_s)

    def position(t: float) -> float:
        return setpoint.at(t) if t < step_s else 0.08 + response(t)

    path = tmp_path / "nominal-step.mcap"
    record_run(path, round((step_s + 4.0) / PERIOD_S), following(setpoint.at, position))
    found = last_step(open_recording(path).axis("vertical"))
    assert isinstance(found, StepResponse)
    assert (found.step_from, found.step_to) == (pytest.approx(0.08), pytest.approx(0.1))
    assert found.settling_s == pytest.approx(tau_s * math.log(50.0), abs=2.0 * PERIOD_S)


class TestQuestionsOnABus:
    def test_each_excitation_is_shown_and_confirmed_before_it_begins(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        done: list[str] = []
        monkeypatch.setattr(tuning, "show", lambda command: done.append(" ".join(command[-1:])))
        monkeypatch.setattr(tuning, "run_experiment", lambda path, _command: done.append(path.name))
        tuning.collect(REAL, tmp_path, lambda _text: None, done.append)
        question = (
            "Condition nominal. vertical on can0 will be excited for 60 s, as predicted. Is its range free "
            "of people?"
        )
        assert done == ["--dry-run", question, "nominal-1.mcap", "--dry-run", question, "nominal-2.mcap"]

    def test_a_step_is_confirmed_before_it_begins(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        for name in ("start_position", "run_experiment"):
            monkeypatch.setattr(tuning, name, lambda *_given: pytest.fail("moved without a yes"))
        controller = tmp_path / "controller.json"
        controller.write_text("{}")
        model = cast("Model", SimpleNamespace(condition=NOMINAL, plant=SimpleNamespace(output_unit="m")))

        def refuse(question: str) -> None:
            raise HilError(question)

        with pytest.raises(HilError) as asked:
            tuning.verify(
                REAL, [model], tuning.default_design(), controller, tmp_path, lambda _text: None, refuse
            )
        assert str(asked.value) == (
            "Condition nominal. vertical on can0 will move with the new controller from where it is to "
            "-0.05 m, and will then step to 0.05 m. Is its range free of people?"
        )

    @pytest.mark.parametrize("command", ["collect", "run"])
    def test_a_command_of_a_tuning_does_not_ask_again(
        self, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        given: list[str] = []

        def run(arguments: list[str], *, captured: bool) -> tuple[int, str]:
            assert not captured
            given.extend(arguments)
            (tmp_path / "partial-1.mcap").write_bytes(b"")
            return 0, ""

        monkeypatch.setattr(tuning_experiments, "_run", run)
        tuning_experiments.run_experiment(tmp_path / "1.mcap", [command, "--bus", "can0"])
        assert given[0] == command
        assert given.count("--yes") == 1

    def test_without_a_terminal_it_refuses_before_anything_else(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.chdir(tmp_path)
        assert main(["tune", "--axis", "vertical", "--bus", "can0"]) == 2
        assert capsys.readouterr().err == (
            "hil tune: each motion on can0 must be confirmed, and there is no terminal to ask on; give --yes "
            "to move vertical without questions\n"
        )
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("answer", ["", "no\n", "y\n"])
    def test_anything_but_a_yes_ends_the_tuning(
        self, answer: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setattr("sys.stdin", io.StringIO(answer))
        with pytest.raises(HilError, match="not confirmed; nothing more is moved"):
            tune_command._confirm("Move?")
        monkeypatch.setattr("sys.stdin", io.StringIO("yes\n"))
        tune_command._confirm("Move?")
        assert capsys.readouterr().out == "Move? Type yes: " * 2


def test_an_experiment_does_not_outlive_a_tuning_that_was_killed() -> None:
    script = """
import os, signal, subprocess, sys
from design.tuning_experiments import end_with_parent
subprocess.Popen([sys.executable, "-c", "import signal; signal.pause()"], preexec_fn=end_with_parent)
os.kill(os.getpid(), signal.SIGKILL)
"""
    # The experiment shares the output: it is closed when both have ended.
    subprocess.run([sys.executable, "-c", script], stdout=subprocess.PIPE, timeout=60)
