"""``hil export`` and ``hil import``: options, files beside the recording, messages and exit status."""

from __future__ import annotations

import os
from pathlib import Path

import can
import pandas
import pytest
from mcap.writer import Writer
from support.recorded_runs import record_run

from hil.cli import main
from hil.cli.export import FRAME_FORMATS, SIGNAL_FORMATS, parser
from hil.conversion.export import Format
from hil.core.life_cycle import LifeCycleState
from hil.core.phase import Phase
from hil.recording import open_recording


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, with a recording run.mcap of 300 periods under control."""
    record_run(tmp_path / "run.mcap", 300)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def failed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that must fail with exit status 2, and return its only line of error."""
    try:
        status = main(list(arguments))
    except SystemExit as ended:
        status = int(str(ended.code))
    assert status == 2
    return capsys.readouterr().err.splitlines()[0]


def test_the_formats_of_the_help_are_all_formats() -> None:
    assert (*SIGNAL_FORMATS, *FRAME_FORMATS) == tuple(Format)
    assert {name for name in Format if name.has_frames} == set(FRAME_FORMATS)


def test_the_help_names_every_state_and_phase() -> None:
    text = " ".join(parser().format_help().split())
    assert ", ".join(f"{state.value} {state.name.lower()}" for state in LifeCycleState) in text
    assert ", ".join(f"{phase.value} {phase.name.lower()}" for phase in Phase) in text
    assert "output_v output of the controller before the limits" in text
    assert "command_v valve voltage after the limits" in text


def test_the_file_is_beside_the_recording(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "run.mcap", "--to", "csv"]) == 0
    assert capsys.readouterr().out == "run.csv: 306 periods\n"
    assert len(pandas.read_csv("run.csv")) == 306
    for kind, name in (("candump", "run.log"), ("mf4-bus", "run-bus.mf4"), ("mf4", "run.mf4")):
        assert main(["export", "run.mcap", "--to", kind]) == 0
        assert Path(name).is_file()


def test_to_takes_the_format_and_the_end(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["export", "run.mcap", "--from", "1", "--to", "csv", "--to", "2", "--axis", "rotation"]
    assert main([*command, "--resample", "0.1", "-o", "part.csv"]) == 0
    assert capsys.readouterr().out == "part.csv: 10 rows\n"
    table = pandas.read_csv("part.csv")
    assert table["time_s"].between(1.0, 2.0).all()
    assert "rotation.position_rad" in table
    assert "vertical.position_m" not in table


def test_force_overwrites(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("run.csv").write_text("mine")
    assert "run.csv: exists already" in failed(capsys, "export", "run.mcap", "--to", "csv")
    assert Path("run.csv").read_text() == "mine"
    assert main(["export", "run.mcap", "--to", "csv", "--force"]) == 0
    assert len(pandas.read_csv("run.csv")) == 306


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run.mcap"], "required: --to"),
        (["run.mcap", "--to", "3"], "--to names no format; for example: --to csv"),
        (["run.mcap", "--to", "csv", "--to", "mat"], "2 formats (csv, mat); export one at a time"),
        (["run.mcap", "--to", "csv", "--to", "1", "--to", "2"], "--to gives 2 times"),
        (["run.mcap", "--to", "cvs"], "did you mean csv?"),
        (["run.mcap", "--to", "csv", "--from", "3", "--to", "2"], "--from 3 s is not before --to 2 s"),
        (["run.mcap", "--to", "asc", "--axis", "vertical"], "--axis is for signals, but asc takes frames"),
        (["run.mcap", "--to", "blf", "--resample", "1"], "--resample is for signals"),
        (["run.mcap", "--to", "csv", "--resample", "0"], "--resample 0 s is under the limit"),
        (["run.mcap", "--to", "csv", "--resample", "nan"], "'nan' is not a time"),
        (["none.mcap", "--to", "csv"], "none.mcap: cannot be read: No such file"),
        (["empty.mcap", "--to", "csv"], "empty.mcap: "),
        (["s.csv", "--to", "csv"], "s.csv: not an MCAP file"),
        (["run.mcap", "--to", "csv", "-o", "run.mcap"], "is the file that is being read"),
        (["fifo.mcap", "--to", "csv"], "fifo.mcap: not a regular file"),
        (["theirs.mcap", "--to", "csv"], "theirs.mcap: not the recording of a run"),
        (["run.mcap", "--to", "csv", "-o", "none/run.csv"], "there is no directory none"),
        (["run.mcap", "--to", "csv", "-o", "run.mcap", "--force"], "is the file that is being read"),
        (["run.mcap", "--to", "csv", "--axis", "elbow"], "no axis 'elbow'"),
        (["run.mcap", "--to", "csv", "--from", "100"], "has no periods from 100 s to the end"),
    ],
)
def test_what_is_wrong_is_said_in_one_line_and_leaves_no_file(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    os.mkfifo("fifo.mcap")
    Path("empty.mcap").touch()
    Path("s.csv").write_text("time_s,setpoint\n0,0\n")
    with Path("theirs.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/any", "json", schema), 1, b"{}", 1)
        writer.finish()
    before = sorted(folder.iterdir())
    assert message in failed(capsys, "export", *arguments)
    assert sorted(folder.iterdir()) == before


def test_a_recording_that_was_cut_off_is_exported_as_far_as_it_goes(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = Path("run.mcap").read_bytes()
    Path("cut.mcap").write_bytes(content[: len(content) * 2 // 3])
    assert main(["export", "cut.mcap", "--to", "csv"]) == 0
    assert "cut.mcap: was cut off, so its end is missing" in capsys.readouterr().err
    assert 100 < len(pandas.read_csv("cut.csv")) < 306


class TestImport:
    def test_a_log_becomes_a_recording_that_cannot_be_verified(
        self, folder: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert main(["export", "run.mcap", "--to", "candump"]) == 0
        assert main(["import", "run.log", "-o", "back.mcap"]) == 0
        assert capsys.readouterr().out.splitlines()[-1] == (
            "back.mcap: 306 frames received, 612 sent, 306 periods"
        )
        assert len(open_recording("back.mcap").frames("sent")) == 612
        assert main(["replay", "back.mcap"]) == 2
        error = capsys.readouterr().err
        assert "refused    back.mcap: was imported from run.log" in error
        assert "cannot be verified" in error
        assert main(["replay", "back.mcap", "--with-controller", "vertical=ppid"]) == 2
        assert "was imported from a bus log, which has no setpoints" in capsys.readouterr().err

    def test_the_recording_is_beside_the_log_by_default(
        self, folder: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        with can.BLFWriter("other.blf") as writer:
            writer.on_message_received(can.Message(timestamp=1e9, arbitration_id=0x7, is_extended_id=False))
        assert main(["import", "other.blf"]) == 0
        first, second = capsys.readouterr().out.splitlines()
        assert first == "other.mcap: 1 frames received, 0 sent, 0 periods"
        assert second.startswith("no period: the log has neither SYNC nor a sample")

    def test_what_was_left_out_is_said(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        Path("odd.log").write_text("(1.0) can0 080#\n(0.9) can0 080#\n(1.1) can0 080##1\n")
        assert main(["import", "odd.log"]) == 0
        output = capsys.readouterr().out
        assert "1 frames were left out: not classic CAN, or corrupt" in output
        assert "1 frames were out of order" in output

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["none.log"], "none.log: cannot be read: No such file"),
            (["run.mcap", "-o", "new.mcap"], "is a recording (MCAP) already"),
            (["a.log", "-o", "run.mcap"], "run.mcap: exists already"),
            (["a.log", "-o", "run.log"], "a recording's name ends in .mcap"),
            (["a.log", "--rig", "none.toml"], "none.toml: cannot be read"),
            (["a.log", "--dbc", "a.log"], "a.log: has no message (BO_), so it is no DBC file"),
            (["a.log", "--channel", "can9"], "no frame of bus 'can9' (--channel); its buses are can0"),
        ],
    )
    def test_errors(
        self, folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
    ) -> None:
        Path("a.log").write_text("(1.0) can0 080#\n")
        before = sorted(folder.iterdir())
        assert message in failed(capsys, "import", *arguments)
        assert sorted(folder.iterdir()) == before
