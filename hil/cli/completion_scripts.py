"""Completion scripts for bash, zsh and fish, written from a list of programs."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from enum import Enum, auto
from typing import NamedTuple


class Takes(Enum):
    """What follows an option, or what a positional argument is."""

    NOTHING = auto()
    CHOICE = auto()
    FILE = auto()
    TEXT = auto()


class Argument(NamedTuple):
    """One option, or a positional argument if it has no flags."""

    flags: tuple[str, ...]
    summary: str
    takes: Takes
    choices: tuple[str, ...]
    is_repeated: bool


class Command(NamedTuple):
    """One command of a program. The name is empty for a program without commands."""

    name: str
    summary: str
    arguments: tuple[Argument, ...]

    @property
    def flags(self) -> list[str]:
        """All options of the command."""
        return [flag for argument in self.arguments for flag in argument.flags]

    @property
    def options(self) -> list[Argument]:
        """The arguments that are options."""
        return [argument for argument in self.arguments if argument.flags]

    @property
    def positional(self) -> Argument | None:
        """The first positional argument."""
        return next((argument for argument in self.arguments if not argument.flags), None)


class Program(NamedTuple):
    """A program and its commands."""

    name: str
    commands: tuple[Command, ...]

    @property
    def has_commands(self) -> bool:
        """True if the first argument of the program is the name of a command."""
        return self.commands[0].name != ""


def bash(programs: Sequence[Program]) -> str:
    """Return the script for bash."""
    lines = [
        "# bash completion, written by `hil completion bash`",
        '_hil_words() { mapfile -t COMPREPLY < <(compgen -W "$1" -- "${COMP_WORDS[COMP_CWORD]}"); }',
    ]
    for program in programs:
        lines += _bash_function(program)
    return "\n".join(lines) + "\n"


def _bash_function(program: Program) -> Iterator[str]:
    function = _function_name(program)
    yield f"{function}() {{"
    yield '    local before="${COMP_WORDS[COMP_CWORD-1]}" word="${COMP_WORDS[COMP_CWORD]}" command=""'
    if program.has_commands:
        names = " ".join(command.name for command in program.commands)
        yield f'    if [[ $COMP_CWORD -eq 1 ]]; then _hil_words "{names} --help --version"; return; fi'
        yield '    command="${COMP_WORDS[1]}"'
    yield '    case "$command $before" in'
    for command in program.commands:
        for option in command.options:
            patterns = "|".join(f'"{command.name} {flag}"' for flag in option.flags)
            if option.takes is Takes.FILE:
                yield f"        {patterns}) compopt -o default; return ;;"
            elif option.takes is Takes.CHOICE:
                yield f'        {patterns}) _hil_words "{" ".join(option.choices)}"; return ;;'
            elif option.takes is Takes.TEXT:
                yield f"        {patterns}) return ;;"
    yield "    esac"
    yield '    case "$command $word" in'
    for command in program.commands:
        yield f'        "{command.name} -"*) _hil_words "{" ".join(command.flags)}" ;;'
        positional = command.positional
        if positional is not None and positional.takes is Takes.CHOICE:
            yield f'        "{command.name} "*) _hil_words "{" ".join(positional.choices)}" ;;'
    yield "        *) compopt -o default ;;"
    yield "    esac"
    yield "}"
    yield f"complete -F {function} {program.name}"


def zsh(programs: Sequence[Program]) -> str:
    """Return the script for zsh, a file ``_hil`` in a folder of ``$fpath``."""
    lines = [f"#compdef {' '.join(program.name for program in programs)}"]
    lines.append("# zsh completion, written by `hil completion zsh`")
    for program in programs:
        lines += _zsh_function(program)
    lines.append('case "$service" in')
    lines += [f"    {program.name}) {_function_name(program)} ;;" for program in programs]
    return "\n".join([*lines, "esac"]) + "\n"


def _zsh_function(program: Program) -> Iterator[str]:
    yield f"{_function_name(program)}() {{"
    if not program.has_commands:
        yield from _zsh_arguments(program.commands[0], "    ")
        yield "}"
        return
    yield "    local -a commands"
    yield "    commands=("
    yield from (f"        {_quoted(f'{c.name}:{c.summary}')}" for c in program.commands)
    yield "    )"
    yield "    if (( CURRENT == 2 )); then _describe command commands; return; fi"
    yield "    shift words; (( CURRENT-- ))"
    yield '    case "$words[1]" in'
    for command in program.commands:
        yield f"        {command.name})"
        yield from _zsh_arguments(command, "            ")
        yield "            ;;"
    yield "    esac"
    yield "}"


def _zsh_arguments(command: Command, indent: str) -> Iterator[str]:
    yield f"{indent}_arguments \\"
    for argument in command.arguments:
        value = {
            Takes.NOTHING: "",
            Takes.TEXT: ":value: ",
            Takes.FILE: ":file:_files",
            Takes.CHOICE: f":value:({' '.join(argument.choices)})",
        }[argument.takes]
        if not argument.flags:
            yield f"{indent}    {_quoted(('*' if argument.is_repeated else '1') + (value or ':value: '))} \\"
        for flag in argument.flags:
            repeated = "*" if argument.is_repeated else ""
            summary = re.sub(r"([\[\]:\\])", r"\\\1", argument.summary)
            yield f"{indent}    {_quoted(f'{repeated}{flag}[{summary}]{value}')} \\"
    yield f"{indent}    && return"


def fish(programs: Sequence[Program]) -> str:
    """Return the script for fish."""
    lines = ["# fish completion, written by `hil completion fish`"]
    for program in programs:
        lines.append(f"complete -c {program.name} -f")
        for command in program.commands:
            lines += _fish_lines(program, command)
    return "\n".join(lines) + "\n"


def _fish_lines(program: Program, command: Command) -> Iterator[str]:
    start = f"complete -c {program.name}"
    condition = ""
    if program.has_commands:
        yield f"{start} -n __fish_use_subcommand -a {command.name} -d {_quoted(command.summary)}"
        condition = f" -n {_quoted(f'__fish_seen_subcommand_from {command.name}')}"
    for argument in command.arguments:
        value = {
            Takes.NOTHING: "",
            Takes.TEXT: " -x",
            Takes.FILE: " -r -F",
            Takes.CHOICE: f" -x -a {_quoted(' '.join(argument.choices))}",
        }[argument.takes]
        if not argument.flags:
            value = value.replace(" -x", "").replace(" -r", "")
            if value:
                yield f"{start}{condition}{value}"
            continue
        flags = "".join(
            f" -l {flag[2:]}" if flag.startswith("--") else f" -s {flag[1:]}" for flag in argument.flags
        )
        yield f"{start}{condition}{flags}{value} -d {_quoted(argument.summary)}"


def _function_name(program: Program) -> str:
    return f"_{program.name.replace('-', '_')}"


def _quoted(text: str) -> str:
    return shlex.quote(text)


SCRIPTS: dict[str, Callable[[Sequence[Program]], str]] = {"bash": bash, "zsh": zsh, "fish": fish}
"""The script of each shell that is supported."""
