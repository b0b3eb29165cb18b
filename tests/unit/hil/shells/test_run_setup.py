"""The setup of a run: where its files are looked for, what is refused, and that texts alone rebuild it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from support.gateway_bench import rig_text

from hil.core.errors import DocumentError, HilError, SetpointError
from hil.core.life_cycle import LifeCycleState
from hil.host.controller_files import SHIPPED_CONTROLLERS, shipped_controllers
from hil.host.text_file import MAX_DOCUMENT_BYTES
from hil.shells.run_setup import RunSetup, load_setup, read_text, setup_from_texts

MINE: dict[str, Any] = json.loads((SHIPPED_CONTROLLERS / "ppid.json").read_text())


def written(path: Path, changes: Mapping[str, Any] | None = None) -> Path:
    """Write a controller file like the shipped PPID, with changes."""
    path.write_text(json.dumps(MINE | dict(changes or {})))
    return path


def rig_file(folder: Path, changes: Mapping[str, str] | None = None) -> Path:
    path = folder / "my.toml"
    path.write_text(rig_text(changes))
    return path


def refusal(*given: Any) -> str:
    with pytest.raises(HilError) as caught:
        load_setup(*given)
    return str(caught.value)


class TestLoading:
    def test_without_a_rig_file_the_shipped_rig_is_complete(self) -> None:
        setup = load_setup(None, {}, {})
        assert sorted(setup.texts) == [
            "arm.dbc",
            "controllers/horizontal.json",
            "controllers/rotation.json",
            "controllers/vertical.json",
            "rig.toml",
        ]
        for name, axis in setup.rig.axes.items():
            assert setup.controllers[name].name == axis.controller
            assert setup.setpoints[name].text == axis.setpoint
        assert setup.texts["arm.dbc"].startswith('VERSION "1"')

    def test_a_new_gateway_is_offline(self) -> None:
        setup = load_setup(None, {}, {})
        gateway = setup.gateway(123)
        assert (gateway.state, gateway.next_deadline_ns) == (LifeCycleState.OFFLINE, 123)
        assert setup.gateway(123) is not gateway

    def test_options_replace_what_the_rig_file_says(self) -> None:
        setup = load_setup(None, {"vertical": "zn"}, {"horizontal": "sine:0.01@0/5"})
        assert setup.controllers["vertical"].name == "zn"
        assert setup.controllers["horizontal"].name == setup.rig.axes["horizontal"].controller
        assert setup.setpoints["horizontal"].text == "sine:0.01@0/5"
        assert setup.setpoints["vertical"].text == setup.rig.axes["vertical"].setpoint

    def test_names_in_a_rig_file_are_relative_to_it(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (tmp_path / "rig").mkdir()
        (tmp_path / "elsewhere").mkdir()
        monkeypatch.chdir(tmp_path / "elsewhere")
        written(tmp_path / "rig" / "k.json", {"name": "beside the rig"})
        (tmp_path / "rig" / "r.csv").write_text("0,0.07\n")
        rig = rig_file(
            tmp_path / "rig",
            {"axes.vertical.controller": '"k.json"', "axes.vertical.setpoint": '"csv:r.csv"'},
        )
        setup = load_setup(rig, {}, {})
        assert setup.controllers["vertical"].name == "beside the rig"
        assert setup.setpoints["vertical"].at(0.0) == 0.07
        assert setup.texts["setpoints/vertical.csv"] == "0,0.07\n"

    def test_names_in_options_are_relative_to_the_working_directory(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (tmp_path / "rig").mkdir()
        (tmp_path / "here").mkdir()
        monkeypatch.chdir(tmp_path / "here")
        written(tmp_path / "here" / "k.json", {"name": "here"})
        (tmp_path / "here" / "r.csv").write_text("0,0.03\n")
        setup = load_setup(rig_file(tmp_path / "rig"), {"vertical": "k.json"}, {"vertical": "csv:r.csv"})
        assert setup.controllers["vertical"].name == "here"
        assert setup.setpoints["vertical"].at(0.0) == 0.03

    def test_a_shipped_name_wins_over_a_file_of_that_name(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)
        written(tmp_path / "zn", {"name": "not shipped"})
        assert load_setup(None, {"vertical": "zn"}, {}).controllers["vertical"].name == "zn"

    def test_a_byte_order_mark_is_dropped(self, tmp_path: Path) -> None:
        path = tmp_path / "r.csv"
        path.write_bytes("\ufeff0,0.1\n".encode())
        assert read_text(path) == "0,0.1\n"


class TestRefusals:
    @pytest.mark.parametrize(
        ("controllers", "setpoints", "option"),
        [({"z": "ppid"}, {}, "--controller"), ({}, {"z": "step:0@1"}, "--setpoint")],
    )
    def test_an_unknown_axis(
        self, controllers: Mapping[str, str], setpoints: Mapping[str, str], option: str
    ) -> None:
        assert refusal(None, controllers, setpoints) == (
            f"{option} z=…: the axes of the rig are vertical, horizontal, rotation"
        )

    def test_an_unknown_controller(self, tmp_path: Path) -> None:
        rig = rig_file(tmp_path, {"axes.vertical.controller": '"pppid"'})
        assert refusal(rig, {}, {}) == (
            f"{rig}: axes.vertical.controller: controller 'pppid': there is no file {tmp_path / 'pppid'}, "
            f"and no shipped controller has this name ({', '.join(shipped_controllers())}); "
            "did you mean ppid?"
        )

    def test_a_file_is_named_as_the_user_wrote_it(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)
        written(tmp_path / "k.json", {"law": {"kind": "pid", "kp": 1.0, "ki": 1.0, "kd": 1.0}})
        assert refusal(rig_file(tmp_path), {"vertical": "k.json"}, {}) == (
            "vertical: k.json: law.tau_d is 0 s with kd 1.0: the derivative is not filtered; give tau_d > 0"
        )

    def test_a_controller_for_another_sample_time_or_unit(self, tmp_path: Path) -> None:
        slow = written(tmp_path / "slow.json", {"sample_time_s": 0.1})
        assert refusal(None, {"horizontal": str(slow)}, {}).startswith(
            f"horizontal: {slow}: sample_time_s: 0.1 s is not the loop's 0.0112 s"
        )
        assert refusal(None, {"rotation": "ppid"}, {}) == (
            f"rotation: {SHIPPED_CONTROLLERS / 'ppid.json'}: input_unit is m, but the axis is in rad; give a "
            "controller that was designed for an axis in rad"
        )

    def test_a_law_without_a_stable_anti_windup_gain(self, tmp_path: Path) -> None:
        hidden = {"kind": "state_space", "A": [[1.0]], "B": [[1.0]], "C": [[0.0]], "D": [[1.0]]}
        path = written(tmp_path / "hidden.json", {"law": hidden})
        assert refusal(None, {"vertical": str(path)}, {}).startswith(
            f"vertical: {path}: law: a mode that does not decay is not seen in the output"
        )

    def test_a_setpoint_beyond_the_axis(self) -> None:
        assert refusal(None, {}, {"vertical": "step:0.2@1"}) == (
            "--setpoint vertical: setpoint 'step:0.2@1' reaches 0.2 m, beyond 0.15 m "
            "(rig: axes.vertical.max_y)"
        )

    def test_an_error_says_where_a_setpoint_or_controller_is_written(self, tmp_path: Path) -> None:
        rig = rig_file(tmp_path, {"axes.vertical.setpoint": '"hop:1"'})
        said = refusal(rig, {}, {})
        assert said.startswith(f"{rig}: axes.vertical.setpoint: setpoint 'hop:1' is neither a number")
        assert refusal(rig, {}, {"vertical": "hop"}).startswith(
            "--setpoint vertical: setpoint 'hop' is neither"
        )
        assert refusal(None, {"rotation": "k"}, {}).startswith(
            "--controller rotation: controller 'k': there is no file"
        )
        origins = {"setpoints.vertical": "scenario s.toml: setpoints.vertical"}
        assert refusal(None, {}, {"vertical": "hop"}, None, origins).startswith(
            "scenario s.toml: setpoints.vertical: setpoint 'hop' is neither a number"
        )

    def test_a_csv_beyond_the_axis(self, tmp_path: Path) -> None:
        (tmp_path / "r.csv").write_text("0,0\n1,-0.2\n")
        text = f"csv:{tmp_path / 'r.csv'}"
        assert refusal(None, {}, {"vertical": text}) == (
            f"--setpoint vertical: setpoint {text!r} reaches -0.2 m, beyond -0.15 m "
            "(rig: axes.vertical.min_y)"
        )

    def test_a_rig_file_is_named_by_its_path(self, tmp_path: Path) -> None:
        rig = rig_file(tmp_path, {"axes.vertical.valve.max_v": "11.0"})
        assert refusal(rig, {}, {}) == (f"{rig}: axes.vertical.valve.max_v is 11.0, but must be at most 10.0")

    @pytest.mark.parametrize("changes", [{"sample_time_s": 1.0}, {"law": {"kind": "lqr"}}])
    def test_a_controller_that_an_option_replaces_is_not_checked(
        self, tmp_path: Path, changes: Mapping[str, Any]
    ) -> None:
        written(tmp_path / "k.json", changes)
        rig = rig_file(tmp_path, {"axes.vertical.controller": '"k.json"'})
        assert refusal(rig, {}, {}).startswith(f"vertical: {tmp_path / 'k.json'}: ")
        assert load_setup(rig, {"vertical": "zn"}, {}).controllers["vertical"].name == "zn"
        (tmp_path / "k.json").unlink()
        assert load_setup(rig, {"vertical": "zn"}, {}).controllers["vertical"].name == "zn"

    def test_a_table_larger_than_a_document_is_read(self, tmp_path: Path) -> None:
        path = tmp_path / "r.csv"
        path.write_text("0,0\n" + "1,0.1\n" * (MAX_DOCUMENT_BYTES // 6 + 1))
        assert path.stat().st_size > MAX_DOCUMENT_BYTES
        setup = load_setup(None, {}, {"vertical": f"csv:{path}"})
        assert setup.setpoints["vertical"].at(2.0) == 0.1

    def test_a_controller_that_is_not_a_regular_file(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "k.json")
        said = "is a named pipe (FIFO), not a regular file"
        assert refusal(None, {"vertical": str(tmp_path / "k.json")}, {}) == f"{tmp_path / 'k.json'}: {said}"
        assert (
            refusal(None, {}, {"vertical": f"csv:{tmp_path / 'k.json'}"}) == f"{tmp_path / 'k.json'}: {said}"
        )

    def test_files_that_cannot_be_read(self, tmp_path: Path) -> None:
        missing, binary = tmp_path / "no.toml", tmp_path / "bin.toml"
        binary.write_bytes(b"\xff\xfe\x00")
        assert refusal(missing, {}, {}) == f"{missing}: cannot be read: No such file or directory"
        assert refusal(binary, {}, {}) == f"{binary}: is not text in UTF-8: byte 0 cannot be decoded"
        assert refusal(tmp_path, {}, {}) == f"{tmp_path}: is a directory, not a regular file"
        assert (
            refusal(None, {"vertical": str(tmp_path)}, {})
            == f"{tmp_path}: is a directory, not a regular file"
        )
        assert refusal(None, {}, {"vertical": f"csv:{missing}"}) == (
            f"{missing}: cannot be read: No such file or directory"
        )


class TestTexts:
    """The documents of a recording give the same gateway, as a replay needs it."""

    @staticmethod
    def rebuilt(setup: RunSetup) -> RunSetup:
        return setup_from_texts(setup.texts, {name: s.text for name, s in setup.setpoints.items()})

    def test_the_texts_of_a_setup_rebuild_it(self, tmp_path: Path) -> None:
        (tmp_path / "r.csv").write_text("time_s,setpoint\n0,0.01\n2,0.05\n")
        setup = load_setup(None, {"vertical": "hls"}, {"vertical": f"csv:{tmp_path / 'r.csv'}"})
        again = self.rebuilt(setup)
        assert again.rig == setup.rig
        assert again.controllers == setup.controllers
        assert again.texts == setup.texts
        assert again.fingerprint() == setup.fingerprint()
        assert again.setpoints["vertical"].at(1.0) == setup.setpoints["vertical"].at(1.0) == 0.03

    @pytest.mark.parametrize("name", ["rig.toml", "controllers/rotation.json"])
    def test_a_missing_document_is_named(self, name: str) -> None:
        setup = load_setup(None, {}, {})
        texts = {key: text for key, text in setup.texts.items() if key != name}
        with pytest.raises(DocumentError, match=f"^{name} is missing"):
            setup_from_texts(texts, {axis: s.text for axis, s in setup.setpoints.items()})

    def test_a_missing_table_or_setpoint_is_named(self) -> None:
        texts = load_setup(None, {}, {}).texts
        with pytest.raises(DocumentError, match=r"^setpoints/vertical\.csv is missing"):
            setup_from_texts(texts, dict.fromkeys(["vertical", "horizontal", "rotation"], "csv:r.csv"))
        with pytest.raises(SetpointError, match=r"^no setpoint for axis horizontal$"):
            setup_from_texts(texts, {"vertical": "step:0@1"})

    def test_the_fingerprint_depends_on_every_text_and_setpoint(self) -> None:
        setup = load_setup(None, {}, {})
        setpoints = {name: s.text for name, s in setup.setpoints.items()}
        prints = {setup.fingerprint(), load_setup(None, {}, {}).fingerprint()}
        assert len(prints) == 1
        for name, text in setup.texts.items():
            prints.add(setup_from_texts(setup.texts | {name: text + "\n"}, setpoints).fingerprint())
        prints.add(load_setup(None, {}, {"vertical": "step:0.1@1.0"}).fingerprint())
        assert len(prints) == 1 + len(setup.texts) + 1
