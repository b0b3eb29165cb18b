"""``hil rig``: the shipped rig file and the boards' EDS files, printed, copied and checked."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.cli.rig import EDS_NAMES, main
from hil.core.errors import DocumentError
from hil.core.input_settings import InputSettings
from hil.core.rig import read_rig
from hil.shells.run_setup import SHIPPED


def uncommented(text: str) -> str:
    """The shipped rig file with its optional protection switched on, as a user would do it."""
    lines, is_table = [], False
    for line in text.splitlines():
        is_table = (is_table or line.startswith(("# [emergency_stop]", "# [enable]"))) and line.startswith(
            "#"
        )
        is_key = line.startswith("# read_back")
        lines.append(line.removeprefix("# ") if is_table or is_key else line)
    return "\n".join(lines) + "\n"


def test_the_protection_in_the_shipped_rig_file_is_valid_as_it_stands_there(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main([]) == 0
    rig = read_rig(uncommented(capsys.readouterr().out), "rig.toml")
    assert rig.dac.read_back
    assert (rig.dac.read_back_tolerance_v, rig.dac.read_back_periods) == (0.05, 3)
    assert rig.emergency_stop == InputSettings(frame=0x290, byte=0, bit=0, timeout_s=0.1)
    assert rig.enable == InputSettings(frame=0x290, byte=0, bit=1, timeout_s=0.1)


def test_the_values_in_comments_are_the_defaults() -> None:
    rig = read_rig((SHIPPED / "rig.toml").read_text(), "rig.toml")
    assert (rig.dac.read_back_tolerance_v, rig.dac.read_back_periods) == (0.05, 3)
    assert rig.inputs == {} and not rig.dac.read_back


def test_the_eds_files_are_written_to_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--eds", str(tmp_path)]) == 0
    for name in EDS_NAMES:
        assert (tmp_path / name).read_bytes() == (SHIPPED / name).read_bytes()
    assert "open them with a CANopen tool" in capsys.readouterr().out


def test_without_a_folder_they_are_written_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["--eds"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(EDS_NAMES)


def test_existing_files_are_kept(tmp_path: Path) -> None:
    (tmp_path / "adc.eds").write_text("mine")
    with pytest.raises(DocumentError, match=r"adc\.eds: exists already and is kept"):
        main(["--eds", str(tmp_path)])
    assert (tmp_path / "adc.eds").read_text() == "mine"


def test_a_rig_file_is_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--init", str(tmp_path / "rig.toml")]) == 0
    assert main(["--check", str(tmp_path / "rig.toml")]) == 0
    assert "valid; axes vertical, horizontal, rotation" in capsys.readouterr().out


def test_the_folder_of_the_eds_files_is_created(tmp_path: Path) -> None:
    assert main(["--eds", str(tmp_path / "new" / "eds")]) == 0
    assert (tmp_path / "new" / "eds" / "dac.eds").exists()
    with pytest.raises(DocumentError, match=r"dac\.eds: is a file, not a folder; name a folder"):
        main(["--eds", str(tmp_path / "new" / "eds" / "dac.eds")])
    with pytest.raises(DocumentError, match=r"adc\.eds: exists already and is kept; name another folder"):
        main(["--eds", str(tmp_path / "new" / "eds")])


def checked(tmp_path: Path, bit_rate: int) -> Path:
    path = tmp_path / "rig.toml"
    text = (SHIPPED / "rig.toml").read_text()
    path.write_text(text.replace("# bit_rate = 500000", f"bit_rate = {bit_rate}"))
    return path


@pytest.mark.parametrize(("bit_rate", "percent"), [(500_000, 6), (125_000, 25)])
def test_the_check_prints_the_load_by_the_own_frames(
    tmp_path: Path, bit_rate: int, percent: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--check", str(checked(tmp_path, bit_rate))]) == 0
    printed = capsys.readouterr()
    assert f"the rig's own frames use up to {percent} % of {bit_rate} bit/s" in printed.out
    assert printed.err == ""


def test_the_check_warns_of_a_high_load(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--check", str(checked(tmp_path, 40_000))]) == 0
    assert "more than 70 %: there is little room" in capsys.readouterr().err


@pytest.mark.parametrize("bit_rate", [10_000, 30_000])
def test_the_check_refuses_a_bus_that_cannot_carry_the_own_frames(tmp_path: Path, bit_rate: int) -> None:
    with pytest.raises(DocumentError, match=rf"% of {bit_rate} bit/s, but the limit is below 100 %"):
        main(["--check", str(checked(tmp_path, bit_rate))])
