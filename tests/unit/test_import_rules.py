"""The house's rules on imports, held by a walk over the syntax trees. Imports inside functions count too."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

FLOORS = {
    "hil": 0,
    "hil.errors": 0,
    "hil.events": 0,
    "hil.frames": 0,
    "hil.axis_loops": 1,
    "hil.controller_file": 1,
    "hil.documents": 1,
    "hil.guards": 1,
    "hil.laws": 1,
    "hil.life_cycle": 1,
    "hil.limits": 1,
    "hil.rig": 1,
    "hil.setpoints": 1,
    "hil.supervision": 1,
    "hil.wire": 1,
    "hil.wire.codec": 1,
    "hil.wire.compile_dbc": 1,
    "hil.wire.crc8": 1,
    "hil.gateway": 2,
    "hil.doctor": 3,
    "hil.links.*": 3,
    "hil.plots": 3,
    "hil.processes": 3,
    "hil.recording.*": 3,
    "hil.rights": 3,
    "hil.onlooker": 3,
    "hil.run_setup": 3,
    "hil.shells.*": 3,
    "hil.summary": 3,
    "hil.vcan.*": 3,
    "hil.cli.*": 4,
}
"""The floor of every module; ``.*`` stands for a package with all that is in it."""

CORE = 2
"""Up to this floor: no I/O, no clock."""
OUTSIDE = {"asyncio", "can", "mcap", "multiprocessing", "select", "selectors", "serial", "signal", "socket"}
OUTSIDE |= {"subprocess", "threading", "time"}
COMMAND_LINE = 4

FROM_HIL_FOR_DESIGN = {
    "controller_file",
    "documents",
    "errors",
    "laws",
    "recording",
    "rig",
    "run_setup",
    "setpoints",
}


def modules(package: str) -> dict[str, Path]:
    """Dotted name to file, of every module of ``package``."""
    found = {}
    for path in (ROOT / package).rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


OURS = {package: modules(package) for package in ("hil", "firmware_sim", "design")}
ALL = {name for package in OURS.values() for name in package}


def imports(path: Path) -> Iterator[str]:
    """Every module that the file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module is not None
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in ALL else node.module


def floor(module: str) -> int:
    if module in FLOORS:
        return FLOORS[module]
    packages = [module, *(module.rsplit(".", depth)[0] for depth in range(1, module.count(".") + 1))]
    floors = [FLOORS[f"{package}.*"] for package in packages if f"{package}.*" in FLOORS]
    assert floors, f"{module} is on no floor yet: add it to FLOORS"
    return floors[0]


@pytest.mark.parametrize("module", OURS["hil"])
def test_every_module_of_hil_has_a_floor_and_imports_go_down(module: str) -> None:
    own_floor = floor(module)
    for imported in imports(OURS["hil"][module]):
        if imported in OURS["hil"]:
            assert floor(imported) <= own_floor, f"{module} imports {imported}"


@pytest.mark.parametrize(
    "module", [module for module in OURS["hil"] if FLOORS.get(module, COMMAND_LINE) <= CORE]
)
def test_the_core_does_no_io_and_reads_no_clock(module: str) -> None:
    roots = {imported.partition(".")[0] for imported in imports(OURS["hil"][module])}
    assert not roots & OUTSIDE


@pytest.mark.parametrize("module", OURS["hil"])
def test_hil_knows_nothing_of_design_and_only_its_command_line_of_the_firmware(module: str) -> None:
    roots = {imported.partition(".")[0] for imported in imports(OURS["hil"][module])}
    assert "design" not in roots
    assert "firmware_sim" not in roots or floor(module) == COMMAND_LINE


@pytest.mark.parametrize("module", OURS["firmware_sim"])
def test_the_firmware_has_a_codec_and_rules_of_its_own(module: str) -> None:
    for imported in imports(OURS["firmware_sim"][module]):
        assert not imported.startswith(("hil.wire", "hil.gateway", "hil.guards", "hil.limits", "design"))


@pytest.mark.parametrize("module", OURS["design"])
def test_design_takes_documents_and_laws_from_hil_and_no_more(module: str) -> None:
    for imported in imports(OURS["design"][module]):
        package, _, rest = imported.partition(".")
        assert package != "firmware_sim"
        if package == "hil" and rest:
            assert rest.partition(".")[0] in FROM_HIL_FOR_DESIGN, imported


def test_the_table_lists_no_module_that_is_gone() -> None:
    assert {name.removesuffix(".*") for name in FLOORS} <= set(OURS["hil"])


SLOW = {"scipy", "control", "matplotlib", "rich", "mcap", "zstandard"}
"""What only a summary, a picture or another process needs."""

AT_THE_FIRST_PERIOD = """
import sys
from hil.cli import main
from hil.shells.session import Session

on_deadline = Session.on_deadline

def first(self, now_ns):
    print("loaded", *sorted(sys.modules))
    Session.on_deadline = on_deadline
    on_deadline(self, now_ns)

Session.on_deadline = first
sys.exit(main(sys.argv[1:]))
"""

AS_THE_BOARDS_BEGIN = """
import sys
from firmware_sim import cli

cli.simulate = lambda *_: print("loaded", *sorted(sys.modules))
sys.exit(cli.main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    ("program", "arguments", "allowed"),
    [
        (AT_THE_FIRST_PERIOD, ["run", "--duration", "0.1", "--record", "run.mcap"], set()),
        (
            AT_THE_FIRST_PERIOD,
            ["run", "--lockstep", "--scenario", "fig14", "--duration", "0.1", "--record", "run.mcap"],
            {"rich"},
        ),
        (AS_THE_BOARDS_BEGIN, ["--bus", "pty"], set()),
        (AS_THE_BOARDS_BEGIN, ["--bus", "pty", "--linear"], set()),
    ],
    ids=["hil run", "hil run --lockstep", "firmware-sim", "firmware-sim --linear"],
)
def test_a_daemon_is_ready_without_the_slow_libraries(
    tmp_path: Path, program: str, arguments: list[str], allowed: set[str]
) -> None:
    """On the way to its first period, as it really goes."""
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    (loaded,) = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("loaded ")]
    assert "hil.rig" in loaded
    assert SLOW & set(loaded) == allowed


@pytest.mark.parametrize("command", ["hil.cli", "firmware_sim.cli"])
def test_help_comes_without_the_slow_libraries(command: str) -> None:
    arguments = ["run", "--help"] if command == "hil.cli" else ["--help"]
    program = (
        f"import sys, {command}\n"
        f"try: {command}.main({arguments})\n"
        "except SystemExit: pass\n"
        f"print(sorted({SLOW | {'can'}} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
