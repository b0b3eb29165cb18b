"""Campaigns: their file, their cases, their results on disk, and that any case can be run again alone."""

from __future__ import annotations

import csv
import json
import os
import pickle
import re
from pathlib import Path
from unittest import mock

import pytest
from support.board_bench import pdo
from support.shipped_rig import RIG_TEXT, SHIPPED_RIG

from hil.campaigns import result_files, runner
from hil.campaigns.campaign_file import Campaign, case_at, case_count, find_campaign, read_campaign
from hil.campaigns.case import CaseResult, commands_keep_limits, run_case
from hil.campaigns.page import worst_cases
from hil.campaigns.prepared import prepare
from hil.campaigns.result_files import ResultFolder
from hil.campaigns.summary import SHOWN_FAILURES, summarise_campaign
from hil.cli import main
from hil.cli.campaign import _PlainProgress
from hil.core.errors import DocumentError, HilError
from hil.core.frames import Frame
from hil.recording import open_recording
from hil.recording.recorder import FAULT_SOURCE
from hil.shells.replay import verify

TEXT = """
title = "two faults"
duration_s = 0.8
draws = 2
moments = ["running+0.2", "0.3"]
[[setups]]
setpoints = { vertical = "sine:0.1@0/2" }
[[faults]]
fault = "lose:sample"
expect = "fault"
max_periods = 6
[[faults]]
fault = "none"
expect = "running"
[arm]
"supply.gauge_kpa" = { from = 440.0, to = 460.0 }
"""


def campaign(text: str = TEXT) -> Campaign:
    return read_campaign(text, "two.toml")


def lines(folder: Path) -> list[bytes]:
    return (folder / "results.jsonl").read_bytes().splitlines()


def test_the_draw_changes_most_slowly_so_that_more_draws_only_add_cases() -> None:
    few, many = campaign(), campaign(TEXT.replace("draws = 2", "draws = 5"))
    assert (case_count(few), case_count(many)) == (8, 20)
    assert [case_at(few, number) for number in range(8)] == [case_at(many, number) for number in range(8)]
    assert [case_at(few, number).fault_text for number in (0, 1, 2, 4)] == [
        "lose:sample@running+0.2", "", "lose:sample@0.3", "lose:sample@running+0.2"
    ]  # fmt: skip
    assert run_case(prepare(few), 4) == run_case(prepare(many), 4)


def test_the_randomness_of_a_case_depends_on_seed_and_number() -> None:
    results = [run_case(prepare(campaign()), number) for number in (0, 2, 0)]
    assert results[0] == results[2]
    assert results[0].arm != results[1].arm
    assert run_case(prepare(campaign("seed = 1" + TEXT)), 0).arm != results[0].arm
    assert 440.0 <= json.loads(results[0].arm)["supply.gauge_kpa"] <= 460.0


def test_a_case_gives_reaction_and_verdict(tmp_path: Path) -> None:
    lost, good = run_case(prepare(campaign()), 0, tmp_path / "case.mcap"), run_case(prepare(campaign()), 1)
    assert (lost.verdict, lost.state, lost.centred_after_periods, lost.limits_held) == (
        "pass",
        "FAULT",
        5,
        True,
    )
    assert lost.reason.startswith("adc: no good sample for 5 periods")
    assert lost.begun_s == pytest.approx(0.3, abs=0.1)
    assert (good.verdict, good.state, good.fault, good.begun_s) == ("pass", "RUNNING", "", None)
    assert 0.0 < good.max_error < 0.3
    assert open_recording(tmp_path / "case.mcap").metadata["ending"]["fault"] == lost.reason


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (("max_periods = 6", "max_periods = 2"), "the valves were centred after 5 periods, limit 2 periods"),
        (("lose:sample", "lose:sample,1"), "expected a fault of the gateway, but it is RUNNING"),
        (("running+0.2", "vertical>0.14"), "the fault did not begin: its condition was not met in time"),
        (('expect = "fault"\nmax_periods = 6', 'expect = "running"'), "expected the gateway to keep running"),
    ],
)  # fmt: skip
def test_a_case_that_fails_says_why(change: tuple[str, str], problem: str) -> None:
    result = run_case(prepare(campaign(TEXT.replace(*change))), 0)
    assert result.verdict == "fail"
    assert problem in result.problem


CRITERIA = """
[[criteria]]
axis = "vertical"
overshoot = 0.0
settling_s = 0.1
steady_state_error = 1e-9
"""


def test_criteria_judge_the_step_response() -> None:
    result = run_case(prepare(campaign(TEXT.replace("sine:0.1@0/2", "step:0.05@0.1") + CRITERIA)), 1)
    assert "vertical: settling time in s" in result.problem
    assert "vertical: steady-state error" in result.problem
    assert result.overshoot is not None
    assert run_case(prepare(campaign(TEXT + CRITERIA)), 1).problem == "vertical: made no step from rest"


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (("lose:sample", "loose:sample"), "there is no fault 'loose'"),
        (("running+0.2", "soon"), "is neither a time nor a condition"),
        (('expect = "fault"', 'expect = "any"'), "max_periods is given, but expect is 'any'"),
        (("from = 440.0", "from = 470.0"), "arm.supply.gauge_kpa: from 470 is more than to 460"),
        (("draws = 2", "draws = 0"), "draws is 0"),
        (("title", "titel"), "titel"),
    ],
)
def test_an_error_of_the_file_is_found_before_any_case_runs(change: tuple[str, str], problem: str) -> None:
    with pytest.raises(DocumentError) as caught:
        campaign(TEXT.replace(*change, 1))
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (("sine:0.1@0/2", "sine:9@0/2"), "vertical"),
        (("[[setups]]\n", '[[setups]]\ncontrollers = { vertical = "pid" }\n'), "controller 'pid'"),
    ],
)
def test_an_error_of_a_set_up_is_found_before_any_case_runs(change: tuple[str, str], problem: str) -> None:
    with pytest.raises(HilError, match=problem):
        prepare(campaign(TEXT.replace(*change)))


def test_a_case_needs_no_file_after_the_campaign_is_prepared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.toml").write_text(RIG_TEXT)
    prepared = prepare(campaign('rig = "own.toml"\n' + TEXT))
    Path("own.toml").unlink()
    assert run_case(pickle.loads(pickle.dumps(prepared)), 1) == run_case(prepare(campaign()), 1)


def test_a_parameter_that_the_arm_does_not_have_is_an_error() -> None:
    with pytest.raises(DocumentError, match=r"arm\.supply\.gauge_bar: the arm file has no number"):
        run_case(prepare(campaign(TEXT.replace("gauge_kpa", "gauge_bar"))), 0)


def test_an_unknown_campaign_is_an_error_with_the_shipped_ones() -> None:
    with pytest.raises(
        DocumentError, match=r"none of the shipped bus, faults, robustness; did you mean faults\?"
    ):
        find_campaign("fault")


@pytest.mark.parametrize("name", ["bus", "faults", "robustness"])
def test_shipped_campaigns_can_be_read(name: str) -> None:
    shipped = read_campaign(find_campaign(name).read_text(), name)
    assert case_count(shipped) >= 200


def test_a_set_up_with_a_bit_rate_has_a_modelled_bus(tmp_path: Path) -> None:
    shipped = read_campaign(find_campaign("bus").read_text(), "bus")
    numbers = {case_at(shipped, number).fault_text: number for number in range(case_count(shipped) // 3)}
    destroyed = run_case(prepare(shipped), numbers["error-frames:10%@running+0.6"], tmp_path / "case.mcap")
    assert (destroyed.verdict, destroyed.state) == ("pass", "RUNNING")
    recording = open_recording(tmp_path / "case.mcap")
    assert int(recording.metadata["ending"]["frames destroyed on the bus"]) > 10
    (logged,) = [entry.text for _, entry in recording.log() if entry.source == FAULT_SOURCE]
    assert logged == "error-frames:10%@running+0.6 begins"
    assert verify(recording).complete
    flooded = run_case(prepare(shipped), numbers["flood:1,0.0002@running+0.6"])
    assert (flooded.verdict, flooded.state) == ("pass", "FAULT")


def test_commands_are_judged_by_magnitude_and_rate() -> None:
    def command(*volts: float) -> Frame:
        first, second, third = (round(value * 3276.8) for value in volts)
        return pdo(0x220, (first, second, third), 0)

    centre, far = command(5.0, 5.0, 5.0), command(9.0, 5.0, 5.0)
    assert commands_keep_limits(SHIPPED_RIG, [centre, far, centre])
    assert commands_keep_limits(SHIPPED_RIG, [far, command(4.6, 5.0, 5.0)])
    assert not commands_keep_limits(SHIPPED_RIG, [far, command(4.5, 5.0, 5.0)]), (
        "4.5 V in a period, limit 4.48 V"
    )
    assert not commands_keep_limits(SHIPPED_RIG, [command(5.0, 9.6, 5.0)])
    assert commands_keep_limits(SHIPPED_RIG, [command(9.0, 5.0, 5.0), centre]), "the centre may come at once"


def test_the_command_gives_the_same_bytes_with_any_number_of_processes_and_resumes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.campaigns.page.PLOTTED_CASES", 0)
    file = tmp_path / "two.toml"
    file.write_text(TEXT)
    with mock.patch.object(runner, "CASES_AT_ONCE", 3):
        for workers in ("1", "2"):
            options = ["--output", str(tmp_path / workers), "--workers", workers]
            assert main(["campaign", str(file), *options]) == 0
    assert lines(tmp_path / "1") == lines(tmp_path / "2")
    assert "8 cases, all passed; commands beyond a limit in 0" in capsys.readouterr().out
    complete = lines(tmp_path / "1")
    (tmp_path / "1" / "results.jsonl").write_bytes(b"\n".join(complete[:3]) + b"\n" + complete[3][:40])
    with mock.patch("hil.campaigns.runner.run_case", wraps=run_case) as runs:
        assert main(["campaign", str(file), "--output", str(tmp_path / "1"), "--workers", "1"]) == 0
    assert [call.args[1] for call in runs.mock_calls] == [3, 4, 5, 6, 7]
    assert lines(tmp_path / "1") == complete
    assert main(["campaign", str(file), "--output", str(tmp_path / "1"), "--draws", "1"]) == 0
    file.write_text(TEXT + "\n")
    assert main(["campaign", str(file), "--output", str(tmp_path / "1")]) == 2
    assert "has results of another campaign" in capsys.readouterr().err


def test_fewer_draws_than_the_results_show_only_their_own_cases(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.campaigns.page.PLOTTED_CASES", 0)
    monkeypatch.chdir(tmp_path)
    Path("two.toml").write_text(TEXT.replace("duration_s = 0.8", "duration_s = 0.1"))
    command = ["campaign", "two.toml", "--workers", "1", "--output", "out"]
    main([*command, "--draws", "3"])
    before = (tmp_path / "out" / "results.jsonl").read_bytes()
    capfd.readouterr()
    main([*command, "--draws", "2"])
    shown = capfd.readouterr()
    assert "8 cases" in shown.out
    assert "8/8" in shown.err and "12/8" not in shown.err
    assert (tmp_path / "out" / "results.jsonl").read_bytes() == before, "the results of more draws are kept"
    main([*command, "--draws", "4"])
    assert (tmp_path / "out" / "results.jsonl").read_bytes().startswith(before)
    assert "16 cases" in capfd.readouterr().out


def test_without_a_terminal_a_line_of_progress_is_printed_every_ten_seconds(
    capsys: pytest.CaptureFixture[str],
) -> None:
    times = iter([0.0, 4.0, 10.0, 19.0, 20.5])
    progress = _PlainProgress(100, lambda: next(times))
    for finished in (8, 16, 24, 32):
        progress.update(finished)
    assert capsys.readouterr().err == "16 of 100 cases are finished\n32 of 100 cases are finished\n"


def test_failed_cases_are_named_with_the_command_that_runs_them_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hil.campaigns.page.PLOTTED_CASES", 2)
    Path("bad.toml").write_text(
        TEXT.replace("max_periods = 6", "max_periods = 1").replace("draws = 2", "draws = 1")
    )
    assert main(["campaign", "bad.toml", "--workers", "1"]) == 1
    output = capsys.readouterr().out
    assert (
        "case 0 failed: lose:sample@running+0.2: the valves were centred after 5 periods, limit 1" in output
    )
    assert "hil campaign bad.toml --case 0 --record case-0.mcap" in output
    assert "4 cases, 2 failed" in output
    page = Path("campaigns/bad/report.html").read_text()
    assert page.index("Case 0:") < page.index("Case 2:"), "failed cases come first"
    assert "hil campaign bad.toml --case 0 --record case-0.mcap" in page
    assert page.count('<div class="wide"><table>') == page.count("<table>") == 2, (
        "a narrow page does not scroll"
    )
    assert {path.name for path in Path("campaigns/bad/cases").iterdir()} == {
        f"case-{number}.{suffix}" for number in (0, 2) for suffix in ("mcap", "png")
    }
    assert main(["campaign", "bad.toml", "--case", "0", "--record", "case-0.mcap"]) == 1
    printed = capsys.readouterr().out
    assert "centred_after_periods  5" in printed
    assert "limits_held            yes" in printed
    assert "overshoot              none" in printed
    assert re.search(r"max_error +0\.\d{1,6}\n", printed), "four significant digits"
    assert not re.search(r"None|True|False| $", printed, re.MULTILINE)
    assert main(["replay", "case-0.mcap"]) == 0
    assert main(["campaign", "bad.toml", "--case", "1"]) == 0
    assert main(["campaign", "bad.toml", "--case", "4"]) == 2
    assert "the campaign has the cases 0 to 3" in capsys.readouterr().err
    assert main(["campaign", "bad.toml", "--record", "x.mcap"]) == 2


def test_an_interrupted_campaign_says_how_to_go_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.campaigns.runner.run_group", mock.Mock(side_effect=KeyboardInterrupt))
    assert main(["campaign", "faults", "--output", str(tmp_path / "out"), "--workers", "1"]) == 130
    assert "interrupted after 0 cases; the same command goes on from there" in capsys.readouterr().out


def end_process(*_arguments: object) -> None:
    os._exit(3)


def test_a_process_that_ends_is_an_error_with_the_remedy() -> None:
    with (
        mock.patch.object(runner, "run_group", end_process),
        pytest.raises(HilError, match="run the same command again to go on"),
    ):
        list(runner.run_cases(prepare(campaign()), 0, 2))


def test_the_results_that_wait_are_few_however_many_cases_there_are() -> None:
    many = campaign(TEXT.replace("draws = 2", "draws = 1000000"))
    with mock.patch.object(runner, "ProcessPoolExecutor") as pool:
        results = runner.run_cases(prepare(many), 0, 2)
        submit = pool.return_value.submit
        assert submit.call_count == 8
        for number in range(5):
            next(results)
            assert submit.call_count == 9 + number


def result(number: int, verdict: str = "pass", periods: int | None = 3) -> CaseResult:
    return CaseResult(
        number, 0, 0, "lose:sample@1", verdict, "", "FAULT", "adc", 1.0, periods, True, 0.1, None, None, "{}"
    )


def test_tables_have_one_row_for_each_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pyarrow.parquet as pq

    folder = ResultFolder(tmp_path / "results", TEXT, 25)
    folder.append(result(number, periods=None if number else 3) for number in range(25))
    monkeypatch.setattr(result_files, "_ROWS_AT_ONCE", 10)
    table = pq.read_table(folder.write_table())
    assert table.column("number").to_pylist() == list(range(25))
    assert table.column("centred_after_periods").to_pylist() == [3] + [None] * 24
    assert table.schema.field("limits_held").type == "bool"
    monkeypatch.setattr(result_files, "find_spec", lambda name: None)
    with folder.write_table().open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert (len(rows), rows[0]["fault"], rows[1]["centred_after_periods"]) == (25, "lose:sample@1", "")


def test_failed_cases_are_worse_than_slow_ones() -> None:
    results = [result(0), result(1, periods=9), result(2, "fail", 1), result(3, periods=None)]
    assert [found.number for found in worst_cases(results, 3)] == [2, 1, 0]


def test_a_folder_that_cannot_be_created_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(HilError, match="cannot be created: Not a directory; see --output"):
        ResultFolder(tmp_path / "file" / "results", TEXT, 8)


def test_the_summary_has_the_worst_of_each_fault_and_the_first_failures() -> None:
    count = SHOWN_FAILURES + 5
    summary = summarise_campaign(result(number, "fail", number or None) for number in range(count))
    assert (summary.cases, summary.failed, len(summary.failures)) == (count, count, SHOWN_FAILURES)
    found = summary.by_fault["lose:sample"]
    assert (found.max_periods, found.never_centred, found.ended_in_fault) == (count - 1, 1, count)
