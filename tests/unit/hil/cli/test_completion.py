"""Completion scripts have every command and option of the parsers; the one for bash is run."""

from __future__ import annotations

import shlex
import subprocess
from pathlib import Path

import pytest

from hil.cli import command_names, main
from hil.cli.completion import arguments_of, programs
from hil.cli.completion_scripts import SCRIPTS, Takes
from hil.cli.run import parser as run_parser

PROGRAMS = programs()
BASH = SCRIPTS["bash"](PROGRAMS)


def completed(*words: str, cwd: Path | None = None) -> list[str]:
    """Return what bash offers for the last of ``words``; ``FILES`` where it completes file names."""
    function = "_hil" if words[0] == "hil" else "_firmware_sim"
    program = (
        f"{BASH}\n"
        "compopt() { COMPREPLY=(FILES); }\n"
        f"COMP_WORDS=({shlex.join(words)}); COMP_CWORD={len(words) - 1}; COMPREPLY=()\n"
        f'{function}; printf "%s\\n" "${{COMPREPLY[@]}}"\n'
    )
    done = subprocess.run(["bash", "-eu", "-c", program], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("hil", "ru"), ["run"]),
        (("hil", "--v"), ["--version"]),
        (("hil", "run", "--se"), ["--setpoint", "--seed"]),
        (("hil", "run", "--lockstep", "--re"), ["--record"]),
        (("hil", "run", "--rig", ""), ["FILES"]),
        (("hil", "run", "--duration", ""), []),
        (("hil", "replay", ""), ["FILES"]),
        (("hil", "rig", "--i"), ["--init"]),
        (("hil", "completion", ""), ["bash", "zsh", "fish"]),
        (("hil", "design", "--axis-unit", ""), ["m", "rad"]),
        (("hil", "vcan", "--", "candump", ""), ["FILES"]),
        (("firmware-sim", "--w"), ["--watch"]),
        (("firmware-sim", "--arm", ""), ["FILES"]),
    ],
)
def test_bash_offers_what_fits(words: tuple[str, ...], offered: list[str]) -> None:
    assert completed(*words) == offered


def test_all_commands_are_offered() -> None:
    assert completed("hil", "") == [*command_names(), "--help", "--version"]


@pytest.mark.parametrize("shell", SCRIPTS)
def test_a_script_has_every_command_and_option(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    for program in PROGRAMS:
        assert program.name in script
        for command in program.commands:
            assert command.name in script
            for flag in command.flags:
                written = f"-l {flag[2:]}" if flag.startswith("--") else f"-s {flag[1:]}"
                assert (written if shell == "fish" else flag) in script


def test_hidden_options_are_not_offered() -> None:
    assert "--verify" not in BASH


def test_files_and_repetitions_are_recognised() -> None:
    by_flag = {flag: argument for argument in arguments_of(run_parser()) for flag in argument.flags}
    assert by_flag["--rig"].takes is by_flag["--controller"].takes is Takes.FILE
    assert by_flag["--lockstep"].takes is Takes.NOTHING
    assert by_flag["--duration"].takes is Takes.TEXT
    assert by_flag["--setpoint"].is_repeated and not by_flag["--rig"].is_repeated
    assert by_flag["--record"].summary == "recording"


def test_an_unknown_shell_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["completion", "ksh"])
    assert caught.value.code == 2
    assert "choose from 'bash', 'zsh', 'fish'" in capsys.readouterr().err
