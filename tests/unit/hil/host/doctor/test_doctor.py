"""All questions of the doctor, answered by this machine, and what ``hil doctor`` prints."""

import contextlib
import io
import json
import subprocess
import sys
from collections.abc import Iterator

import pytest
from support.doctor_checks import check_named

from hil.cli import doctor as command
from hil.core.rig import POLL_BEFORE_DEADLINE_S, POLL_FOR_SAMPLE_S
from hil.host.doctor import Check, CheckVerdict, doctor
from hil.host.realtime_rights import real_time_rights


@pytest.fixture(scope="module")
def activities() -> list[str]:
    return []


@pytest.fixture(scope="module")
def checks(activities: list[str]) -> list[Check]:
    @contextlib.contextmanager
    def show(activity: str) -> Iterator[None]:
        activities.append(f"{activity} begins")
        yield
        activities.append(f"{activity} ends")

    return doctor(show)


class TestThisMachine:
    def test_every_question_is_answered_once_and_has_advice_unless_it_is_good(
        self, checks: list[Check]
    ) -> None:
        names = [check.name for check in checks]
        assert len(names) == len(set(names))
        for check in checks:
            assert check.found
            assert (check.verdict is CheckVerdict.GOOD) == (not check.advice)

    def test_the_rights_are_those_that_the_loop_would_get(self, checks: list[Check]) -> None:
        with real_time_rights(POLL_BEFORE_DEADLINE_S, POLL_FOR_SAMPLE_S) as rights:
            expected = [(right.name, right.detail) for right in rights]
        assert [(name, check_named(checks, name).found) for name, _ in expected] == expected

    def test_virtual_can_works(self, checks: list[Check]) -> None:
        assert check_named(checks, "hil vcan").verdict is CheckVerdict.GOOD

    @pytest.mark.usefixtures("checks")
    def test_a_waiting_user_is_shown_what_takes_long(self, activities: list[str]) -> None:
        text = "trying hil vcan (user-mode Linux takes about 3 s to start)"
        assert activities == [f"{text} begins", f"{text} ends"]

    def test_the_command_prints_the_findings_and_its_status_says_that_the_simulated_rig_runs(
        self, checks: list[Check], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setattr(command, "doctor", lambda _show: checks)
        assert command.main(["--json"]) == 0
        rows = json.loads(capsys.readouterr().out)
        assert len(rows) == len(checks)
        assert {
            "name": "UDP multicast",
            "verdict": "good",
            "found": "frames arrive inside this host",
            "advice": "",
        } in rows


def test_without_the_loopback_interface_the_simulated_rig_cannot_run() -> None:
    program = "import sys; from hil.cli.doctor import main; sys.exit(main([]))"
    done = subprocess.run(["unshare", "-rn", sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert "UDP multicast        missing " in done.stdout
    assert "\nUDP multicast:\n  sudo ip link set lo up\n" in done.stdout
    assert done.stderr == ""


def test_commands_to_copy_stay_on_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    advice = "sudo " + "x" * 200
    command.print_checks([Check("a name", CheckVerdict.FAIR, "found [brackets]", advice)])
    output = capsys.readouterr().out
    assert f"\na name:\n  {advice}\n" in output
    assert "found [brackets]" in output


def test_on_a_terminal_the_activity_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr(sys, "stderr", Terminal())
    with command._show("trying hil vcan"):
        pass
    assert "trying hil vcan" in sys.stderr.getvalue()  # type: ignore[attr-defined]
