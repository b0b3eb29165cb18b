"""The pytest plugin in sessions of its own: fixtures, what a failed test keeps, tests that need vcan0."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import hil.testing.boards_alone
import hil.testing.gateway_alone
import hil.testing.lockstep_states
import hil.views.plots  # noqa: F401  # a session in this process must not import numpy a second time
from hil.core.errors import EnvironmentLackError
from hil.host import vcan

pytest_plugins = ["pytester"]

PLUGIN = "hil.testing.plugin"


@pytest.fixture
def folder(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a user's tests, which is the working directory."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    pytester.makeini("[pytest]\naddopts = -p no:cacheprovider --strict-markers\n")
    return pytester.path


Session = Callable[..., tuple[str, int]]


@pytest.fixture
def session(pytester: pytest.Pytester, folder: Path) -> Session:
    """A function that runs pytest in this process; it returns what pytest prints, and its exit status."""

    def run(*arguments: str) -> tuple[str, int]:
        result = pytester.runpytest_inprocess("-p", PLUGIN, *arguments)
        return result.stdout.str() + result.stderr.str(), int(result.ret)

    return run


def in_a_process(folder: Path, *arguments: str) -> tuple[str, int]:
    """Run pytest in ``folder`` in a process of its own; return what it prints, and its exit status."""
    done = subprocess.run(
        [sys.executable, "-P", "-m", "pytest", "-p", PLUGIN, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    return done.stdout + done.stderr, done.returncode


def write(folder: Path, text: str) -> None:
    (folder / "test_user.py").write_text(text)


def test_marks_and_parameters_configure_the_rig_and_a_failure_keeps_its_files(
    folder: Path, session: Session
) -> None:
    write(
        folder,
        """
import pytest

@pytest.mark.lockstep_rig(setpoints={"vertical": "step:0.05@0.2"}, seed=3)
def test_marked(lockstep_rig):
    lockstep_rig.run(0.5)
    assert lockstep_rig.signals["vertical"].setpoint == 0.05

@pytest.mark.lockstep_rig(state="armed")
@pytest.mark.parametrize("lockstep_rig", [{"seed": 1}, {"seed": 2}], indirect=True)
def test_indirect(lockstep_rig):
    assert lockstep_rig.state.name == "ARMED"

def test_failing(make_lockstep_rig):
    rigs = [make_lockstep_rig(faults=[fault]) for fault in ("hang:adc@0.1", "unplug@0.1")]
    for rig in rigs:
        rig.run(0.3)
    assert rigs[0].state is not rigs[1].state
""",
    )
    output, status = session("-q")
    assert status == 1, output
    assert "1 failed, 3 passed" in output
    kept = folder / "hil-failures" / "test_user.py-test_failing"
    assert {path.name for path in kept.iterdir()} == {
        f"{name}.{suffix}" for name in ("run", "run-2") for suffix in ("mcap", "png", "log")
    }
    for path in kept.iterdir():
        assert str(path) in output
    assert "kept by hil" in output
    log = (kept / "run.log").read_text()
    assert re.search(r"^ +\d+\.\d{4} s  FATAL   adc: no good sample", log, re.MULTILINE)
    assert re.search(r"^ +\d+\.\d{4} s  WARNING simulated fault: hang:adc", log, re.MULTILINE)


def test_an_option_chooses_the_folder_of_failed_tests_and_nothing_is_kept_of_others(
    folder: Path, session: Session
) -> None:
    write(
        folder,
        """
def test_failing(lockstep_rig):
    assert False

def test_passing(lockstep_rig):
    pass
""",
    )
    output, _ = session("-q", "--hil-failures", "kept")
    assert [path.name for path in (folder / "kept").iterdir()] == ["test_user.py-test_failing"]
    assert str(folder / "kept") in output


def test_gateway_and_boards_alone_and_cached_recordings(folder: Path, session: Session) -> None:
    write(
        folder,
        """
import pytest
from hil.core.frames import Frame
from hil.testing import BoardsAlone, GatewayAlone

def test_gateway(gateway_alone):
    assert isinstance(gateway_alone, GatewayAlone)
    gateway_alone.bring_up()
    gateway_alone.operate("arm")
    gateway_alone.operate("start")
    gateway_alone.period((5.0, 5.0, 5.0))
    assert gateway_alone.state.name == "RUNNING"
    assert gateway_alone.valve_v == pytest.approx((5.0, 5.0, 5.0), abs=0.5)
    gateway_alone.receive(Frame(0x080), after_s=0.001)
    assert "another master" in gateway_alone.core.fault_reason
    gateway_alone.begin_period(late_s=0.05)
    assert any("late" in entry.text for entry in gateway_alone.log)
    assert gateway_alone.cycles

@pytest.mark.lockstep_rig(faults=["lose:sample,1@0"])
def test_boards(boards_alone, inject_fault):
    assert isinstance(boards_alone, BoardsAlone)
    boards_alone.start_nodes()
    assert boards_alone.sync() == []
    boards_alone.command((6.0, 5.0, 5.0))
    assert len(boards_alone.sync()) == 1
    assert boards_alone.valve_v[0] == pytest.approx(6.0, abs=0.01)
    inject_fault("hang:adc@0")
    assert boards_alone.sync() == []

def test_fault(inject_fault, lockstep_rig):
    inject_fault("reset:adc@0")
    assert lockstep_rig.state.name == "FAULT"

@pytest.mark.parametrize("number", range(3))
def test_recordings(record_run, number, request):
    recording = record_run(0.2, seed=number // 2)
    assert recording.complete
    assert recording.path.stem == str(1 + number // 2)
""",
    )
    output, status = session("-q")
    assert (status, "6 passed" in output) == (0, True), output


@pytest.mark.parametrize(
    ("mark", "fixture", "said"),
    [
        (
            'lockstep_rig(setpoint={"vertical": "step:0.1@1"})',
            "lockstep_rig",
            "lockstep_rig (mark lockstep_rig) has the options state, rig, controllers, setpoints, ",
        ),
        ("lockstep_rig(sed=1)", "boards_alone", "'sed' is none; did you mean seed?"),
        ("lockstep_rig(seed=1)", "gateway_alone", "setpoints; 'seed' is none"),
        (
            "vcan_rig(board=[])",
            "vcan_gateway",
            "has the options rig, boards, gateway; 'board' is none; did you mean boards?",
        ),
    ],
)
def test_an_unknown_option_of_a_mark_names_the_nearest_one(
    folder: Path, session: Session, mark: str, fixture: str, said: str
) -> None:
    write(folder, f"import pytest\n\n@pytest.mark.{mark}\ndef test_it({fixture}):\n    pass\n")
    output, status = session("-q")
    assert status == 1
    assert said in output
    assert "TypeError" not in output


def test_a_state_that_does_not_exist_is_an_error(folder: Path, session: Session) -> None:
    write(
        folder,
        """
import pytest

@pytest.mark.lockstep_rig(state="walking")
def test_it(lockstep_rig):
    pass
""",
    )
    output, status = session("-q")
    assert status == 1
    assert "state is 'walking', but must be one of offline, ready, armed, running" in output


VCAN_TESTS = """
import os, pytest

def test_here():
    assert "HIL_VCAN_REPORTS" not in os.environ

@pytest.mark.vcan
def test_there():
    print("from the inner session")
    assert "HIL_VCAN_REPORTS" in os.environ
    assert 1 + 1 == 3

def test_by_fixture(vcan_interface):
    assert vcan_interface == "vcan0"
    assert "HIL_VCAN_REPORTS" in os.environ

@pytest.mark.vcan
class TestGroup:
    @pytest.mark.parametrize("text", ["a b", "c[d]"])
    def test_parameter(self, text):
        assert "HIL_VCAN_REPORTS" in os.environ
"""


RUN_COMMAND = """
import os, sys
if sys.orig_argv[2:5] == ["-m", "hil.cli", "vcan"]:
    with open(os.environ["VCAN_STARTS"], "a") as file:
        file.write("start\\n")
    os.execvp(sys.orig_argv[6], sys.orig_argv[6:])
"""


@pytest.fixture
def starts(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Replace `hil vcan` by a program that runs its command at once, and say that this host has no vcan0.

    The program writes a line into the returned file whenever it is started.
    """
    monkeypatch.setattr(vcan, "choose_way", lambda: vcan.Way.USER_MODE_LINUX)
    program = folder / "program"
    program.mkdir()
    (program / "sitecustomize.py").write_text(RUN_COMMAND)
    monkeypatch.setenv("PYTHONPATH", str(program))
    monkeypatch.setenv("VCAN_STARTS", str(folder / "starts"))
    return folder / "starts"


def test_tests_that_need_vcan_run_once_in_an_inner_session_and_are_reported_in_place(
    folder: Path, session: Session, starts: Path
) -> None:
    write(folder, VCAN_TESTS)
    output, status = session("-v", "--junitxml", "report.xml", "test_user.py")
    assert status == 1, output
    assert "hil: 4 tests with vcan0, in user-mode Linux" in output
    assert "1 failed, 4 passed" in output
    assert "test_user.py::TestGroup::test_parameter[c[d]] PASSED" in output
    assert "assert (1 + 1) == 3" in output
    assert "from the inner session" in output
    assert starts.read_text() == "start\n"
    assert (folder / "report.xml").read_text().count("<testcase ") == 5


def test_only_the_selected_tests_run_in_the_inner_session(
    folder: Path, session: Session, starts: Path
) -> None:
    write(folder, VCAN_TESTS)
    output, status = session("-q", "-k", "parameter")
    assert status == 0, output
    assert "hil: 2 tests with vcan0" in output
    assert "2 passed, 3 deselected" in output
    assert starts.exists()


def test_workers_of_xdist_share_one_inner_session(
    folder: Path, starts: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(folder, VCAN_TESTS)
    (folder / "conftest.py").write_text(
        "from hil.host import vcan\nvcan.choose_way = lambda: vcan.Way.USER_MODE_LINUX\n"
    )
    output, status = in_a_process(folder, "-p", "xdist.plugin", "-n", "2", "-q")
    assert status == 1, output
    assert "1 failed, 4 passed" in output
    assert starts.read_text() == "start\n"


def test_an_inner_session_that_ends_early_fails_the_tests_that_have_no_report(
    folder: Path, session: Session, starts: Path
) -> None:
    write(folder, VCAN_TESTS + "\n@pytest.mark.vcan\ndef test_exit():\n    os._exit(3)\n")
    output, status = session("-q")
    assert status == 1
    assert "2 failed, 4 passed" in output
    assert "the pytest that ran it where vcan0 exists ended early" in output
    assert "`hil doctor` shows what this machine offers" in output


def test_where_vcan_is_impossible_the_tests_fail_with_the_reason_and_the_remedy(
    folder: Path, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    def choose_way() -> vcan.Way:
        raise EnvironmentLackError("user-mode Linux is not complete")

    monkeypatch.setattr(vcan, "choose_way", choose_way)
    write(folder, VCAN_TESTS)
    output, status = session("-q")
    assert status == 1
    assert "4 failed, 1 passed" in output
    assert "there is no vcan0 for this test: user-mode Linux is not complete" in output
    assert "hil doctor" in output
    assert "skipped" not in output


def test_with_vcan0_of_this_host_the_tests_run_here(
    folder: Path, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(vcan, "choose_way", lambda: vcan.Way.NATIVE)
    write(
        folder, "import os\ndef test_it(vcan_interface):\n    assert 'HIL_VCAN_REPORTS' not in os.environ\n"
    )
    output, status = session("-q")
    assert (status, "1 passed" in output) == (0, True), output


def test_the_inner_session_writes_each_report_as_a_line(
    folder: Path, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(folder, "def test_it():\n    pass\n")
    monkeypatch.setenv("HIL_VCAN_REPORTS", str(folder / "reports"))
    session("-q")
    lines = [json.loads(line) for line in (folder / "reports").read_text().splitlines()]
    assert [(line["nodeid"], line["when"]) for line in lines] == [
        ("test_user.py::test_it", when) for when in ("setup", "call", "teardown")
    ]


@pytest.mark.parametrize("name", ["--hil-failures", "hil_failures"])
def test_help_lists_the_options(session: Session, name: str) -> None:
    output, _ = session("--help")
    assert name in output
