"""The checks of a rig before it is operated."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support.doctor_checks import check_named
from support.gateway_bench import EXAMPLE_RIG, rig_text

from hil.cli import doctor as command
from hil.core.errors import DocumentError
from hil.core.rig import read_rig
from hil.host.controller_files import SHIPPED_CONTROLLERS
from hil.host.doctor import Check, CheckVerdict, can_interface
from hil.host.doctor.can_interface import bus_of_rig, link_details
from hil.host.doctor.check import check
from hil.host.realtime_rights import Right, Rights
from hil.shells import preflight as module
from hil.shells.preflight import missing_rights, preflight
from hil.shells.run_setup import load_setup

UP = {"flags": ["UP"], "linkinfo": {"info_data": {"bittiming": {"bitrate": 500000}, "state": "ERROR-ACTIVE"}}}


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A machine without SCHED_FIFO, with can0. Returns the polling times that were asked for."""
    asked: list[float] = []

    def rights(*poll_s: float) -> list[Check]:
        asked.extend(poll_s)
        return [check("SCHED_FIFO", "Operation not permitted", "add rtprio"), check("timer slack", "1 ns")]

    monkeypatch.setattr(module, "rights_and_wake_ups", rights)
    monkeypatch.setattr(can_interface, "link_details", lambda name: UP if name == "can0" else None)
    return asked


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(EXAMPLE_RIG)
    return path


class TestPreflight:
    def test_the_shipped_rig_can_be_operated(self, rig_file: Path, machine: list[float]) -> None:
        checks = preflight(rig_file)
        assert not [found for found in checks if found.verdict is CheckVerdict.MISSING]
        names = [found.name for found in checks]
        assert names[:4] == [
            "rig file",
            "controller vertical",
            "controller horizontal",
            "controller rotation",
        ]
        assert check_named(checks, "controller vertical").found.endswith("11.2 ms; setpoint step:0.1@1")
        assert check_named(checks, "bus").found == "sim: simulated boards on this machine"
        assert "emergency_stop" not in names
        assert machine == [0.0002, 0.001]

    @pytest.mark.usefixtures("machine")
    def test_a_real_bus_demands_rights_and_advises_buttons(self, rig_file: Path) -> None:
        checks = preflight(rig_file, "can0")
        assert check_named(checks, "SCHED_FIFO").verdict is CheckVerdict.MISSING
        assert check_named(checks, "timer slack").verdict is CheckVerdict.GOOD
        assert check_named(checks, "emergency_stop").verdict is CheckVerdict.FAIR
        assert check_named(checks, "CAN controller").found == "error-active"

    @pytest.mark.usefixtures("machine")
    def test_disabled_checks_and_buttons_are_named(self, tmp_path: Path) -> None:
        rig = tmp_path / "rig.toml"
        button = "\n[emergency_stop]\nframe = 0x290\nbyte = 0\nbit = 1\ntimeout_s = 0.05\n"
        disabled = '\n[axes.vertical.envelope]\ndisabled = ["max_error"]\n'
        rig.write_text(EXAMPLE_RIG + button + disabled)
        checks = preflight(rig)
        assert check_named(checks, "emergency_stop").found == "frame 0x290, byte 0, bit 1"
        vertical = check_named(checks, "envelope vertical")
        assert (vertical.verdict, vertical.found) == (CheckVerdict.FAIR, "disabled: max_error")

    @pytest.mark.usefixtures("machine")
    def test_a_controller_for_another_sample_time_is_missing(self, tmp_path: Path) -> None:
        rig = tmp_path / "rig.toml"
        rig.write_text(rig_text({"loop.period_s": "0.01"}))
        (found,) = preflight(rig)
        assert (found.name, found.verdict) == ("rig file", CheckVerdict.MISSING)
        assert "sample" in found.found


def unstable(folder: Path) -> Path:
    """A rig file whose controller for the vertical axis has an unstable loop with the plant in its file."""
    controller = json.loads((SHIPPED_CONTROLLERS / "horizontal.json").read_text())
    controller["law"] = {"kind": "pid", "kp": -50.0, "ki": 0.0}
    (folder / "wrong.json").write_text(json.dumps(controller))
    rig = folder / "rig.toml"
    rig.write_text(EXAMPLE_RIG.replace('controller = "ppid"', 'controller = "wrong.json"', 1))
    return rig


class TestArming:
    @pytest.mark.usefixtures("machine")
    def test_an_unstable_loop_is_missing_and_refuses_to_arm(self, tmp_path: Path) -> None:
        rig = unstable(tmp_path)
        found = check_named(preflight(rig), "controller vertical")
        assert found.verdict is CheckVerdict.MISSING
        assert found.found.startswith("horizontal: the closed loop with the plant of the file")
        assert load_setup(rig, {}, {}).controller_failures == {"vertical": found.found}

    @pytest.mark.parametrize(
        ("required", "bus", "missing"),
        [
            (None, "can0", ["SCHED_FIFO", "memory-lock"]),
            (None, "slcan:/dev/ttyACM0", ["SCHED_FIFO", "memory-lock"]),
            (None, "sim", []),
            (None, "vcan0", []),
            ("[]", "can0", []),
            ('["memory lock"]', "sim", ["memory-lock"]),
        ],
    )
    def test_the_rig_says_which_rights_the_loop_needs(
        self, required: str | None, bus: str, missing: list[str]
    ) -> None:
        text = EXAMPLE_RIG
        if required is not None:
            text = text.replace("[loop]\n", f"[loop]\nrequired_rights = {required}\n", 1)
        refused = [Right(name, False, "not permitted") for name in ("memory lock", "SCHED_FIFO", "polling")]
        found = missing_rights(read_rig(text, "rig.toml"), bus, Rights(refused))
        assert sorted(failure.check for failure in found) == missing
        assert all("not permitted" in f.text and "loop.required_rights" in f.text for f in found)
        granted = Rights(right._replace(is_granted=True) for right in refused)
        assert missing_rights(read_rig(text, "rig.toml"), bus, granted) == ()


class TestBus:
    @pytest.mark.parametrize(
        ("details", "verdict", "found"),
        [
            (None, CheckVerdict.MISSING, "can0: there is no such interface"),
            ({"flags": []}, CheckVerdict.MISSING, "can0: the interface is down"),
            ({"flags": ["UP"]}, CheckVerdict.GOOD, "can0: up, a virtual interface"),
            (
                {"flags": ["UP"], "linkinfo": {"info_data": {"bittiming": {"bitrate": 250000}}}},
                CheckVerdict.FAIR,
                "can0: up, 250 kbit/s",
            ),
        ],
    )
    def test_an_interface(
        self,
        details: dict[str, Any] | None,
        verdict: CheckVerdict,
        found: str,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.setattr(can_interface, "link_details", lambda _name: details)
        first = next(bus_of_rig("socketcan:can0"))
        assert (first.verdict, first.found) == (verdict, found)

    def test_a_controller_that_is_error_passive(self, monkeypatch: pytest.MonkeyPatch) -> None:
        data = {"bittiming": {"bitrate": 500000}, "state": "ERROR-PASSIVE"}
        details = {"flags": ["UP"], "linkinfo": {"info_data": data}}
        monkeypatch.setattr(can_interface, "link_details", lambda _name: details)
        controller = check_named(bus_of_rig("can0"), "CAN controller")
        assert controller.verdict is CheckVerdict.FAIR
        assert "termination" in controller.advice

    def test_a_serial_adapter(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        device = tmp_path / "ttyACM0"
        assert next(bus_of_rig(f"slcan:{device}")).verdict is CheckVerdict.MISSING
        device.touch()
        assert next(bus_of_rig(f"slcan:{device}@921600")).verdict is CheckVerdict.GOOD
        monkeypatch.setattr("os.access", lambda *_arguments: False)
        assert "dialout" in next(bus_of_rig(f"slcan:{device}")).advice

    def test_what_ip_says_is_read(self, monkeypatch: pytest.MonkeyPatch) -> None:
        outputs = iter([json.dumps([UP]), "", "no JSON"])
        monkeypatch.setattr(
            subprocess, "run", lambda *_arguments, **_options: SimpleNamespace(stdout=next(outputs))
        )
        assert [link_details("can0") for _ in range(3)] == [UP, None, None]

        def absent(*_arguments: object, **_options: object) -> None:
            raise FileNotFoundError(2, "No such file", "ip")

        monkeypatch.setattr(subprocess, "run", absent)
        assert link_details("can0") is None


class TestCommand:
    @pytest.mark.usefixtures("machine")
    def test_the_status_says_whether_something_is_missing(
        self, rig_file: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert command.main(["--rig", str(rig_file)]) == 0
        assert command.main(["--rig", str(rig_file), "--bus", "can0", "--json"]) == 1
        assert "SCHED_FIFO" in capsys.readouterr().out

    def test_a_bus_without_a_rig_is_refused(self) -> None:
        with pytest.raises(DocumentError, match="--bus belongs to --rig"):
            command.main(["--bus", "can0"])


def test_an_advice_is_filled_to_the_width_and_a_command_stays_whole() -> None:
    prose = "the kernel kills a loop that is busy for longer, so open another session"
    long_command = "sudo ip link set can0 up type can bitrate 500000 restart-ms 100 txqueuelen 1000 fd off"
    assert command.advice_lines(f"{long_command}\n{prose}", 60) == [
        f"  {long_command}",
        "  the kernel kills a loop that is busy for longer, so open",
        "  another session",
    ]
