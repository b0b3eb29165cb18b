"""The rules on imports, derived from the folders and checked by a walk over the syntax trees.

Imports inside functions count too.
"""

import ast
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

PURE = (
    "hil.core",
    "hil.links.bus_model",
    "firmware_sim.boards",
    "firmware_sim.arm",
    "firmware_sim.plants",
    "firmware_sim.faults",
    "design.mathematics",
    "design.models",
    "design.identification",
    "design.robustness",
    "design.closed_loop",
    "design.search",
    "design.synthesis",
)
"""Packages that do no I/O, read no clock and start no thread."""

OUTSIDE = {"asyncio", "can", "mcap", "multiprocessing", "select", "selectors", "serial", "signal", "socket"}
OUTSIDE |= {"subprocess", "threading", "time"}
"""Modules that do I/O, read a clock or start a thread."""

MAY_IMPORT = {
    "hil.core": set(),
    "hil.shipped": set(),
    "hil.host": {"hil.core", "hil.links"},
    "hil.links": {"hil.core"},
    "hil.recording": {"hil.core", "hil.host"},
    "hil.conversion": {"hil.core", "hil.links", "hil.recording"},
    "hil.operation": {"hil.core", "hil.host"},
    "hil.shells": {"hil.core", "hil.host", "hil.links", "hil.operation", "hil.recording"},
    "hil.views": {"hil.core", "hil.host", "hil.recording"},
    "hil.cli": {
        "hil.core",
        "hil.host",
        "hil.links",
        "hil.recording",
        "hil.conversion",
        "hil.live",
        "hil.operation",
        "hil.shells",
        "hil.views",
        "hil.campaigns",
    },
    "hil.campaigns": {"hil", "hil.core", "hil.host", "hil.recording", "hil.shells", "hil.views"},
    "hil.live": {"hil.core", "hil.host", "hil.links", "hil.operation", "hil.recording", "hil.views"},
    "hil.testing": {
        "hil",
        "hil.core",
        "hil.host",
        "hil.links",
        "hil.operation",
        "hil.recording",
        "hil.shells",
        "hil.views",
    },
    "design.mathematics": set(),
    "design.search": {"design.mathematics"},
    "design.models": {"design.mathematics"},
    "design.identification": {"design.mathematics", "design.models"},
    "design.robustness": {"design.mathematics", "design.models"},
    "design.closed_loop": {"design.mathematics", "design.models", "design.robustness"},
    "design.synthesis": {
        "design.mathematics",
        "design.search",
        "design.models",
        "design.robustness",
        "design.closed_loop",
    },
    "design.paper": {
        "design.mathematics",
        "design.search",
        "design.models",
        "design.robustness",
        "design.closed_loop",
        "design.synthesis",
    },
    "design.output": {
        "design.mathematics",
        "design.search",
        "design.models",
        "design.robustness",
        "design.closed_loop",
        "design.synthesis",
        "design.identification",
        "design.paper",
    },
    "firmware_sim.boards": set(),
    "firmware_sim.plants": set(),
    "firmware_sim.arm": {"firmware_sim.plants"},
    "firmware_sim.faults": {"firmware_sim.boards", "firmware_sim.arm", "firmware_sim.plants"},
}
"""Folder to the folders of the same package that it may import, besides itself and the package's ``errors``.

Modules that lie directly in a package, such as ``design.cli``, are the outermost layer: they may import every
folder. A folder that names the package itself may import those modules.
"""

WITH_FIRMWARE = ("hil.cli", "hil.testing", "hil.campaigns")
"""Folders of ``hil`` that may import the simulated boards."""
FROM_HIL_FOR_DESIGN = (
    "hil.core",
    "hil.recording",
    "hil.host.text_file",
    "hil.host.command_parser",
    "hil.links.opening",
    "hil.views.summary",
    "hil.shells.real_bus",
    "hil.shells.run_setup",
)
FROM_HIL_FOR_FIRMWARE = {
    "hil.core.documents",
    "hil.core.errors",
    "hil.core.frames",
    "hil.core.rig",
    "hil.core.setpoints",
    "hil.core.suggestions",
}
"""No wire code, guard or limit is shared: the simulated boards must find the gateway's mistakes."""


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


def folder(module: str) -> str:
    """The folder of a module, two names deep; the package itself for a module that lies directly in it."""
    names = module.split(".")
    path = ROOT.joinpath(*names[:2])
    return ".".join(names[:2]) if path.is_dir() else names[0]


def is_in(module: str, packages: Iterable[str]) -> bool:
    return any(module == package or module.startswith(f"{package}.") for package in packages)


def outer(module: str) -> bool:
    """Whether the module lies directly in its package, as ``design.cli`` does."""
    return "." not in folder(module)


def test_every_folder_has_a_rule() -> None:
    folders = {folder(module) for module in ALL if not outer(module)}
    assert folders - {"firmware_sim.scenarios"} == set(MAY_IMPORT)


@pytest.mark.parametrize("module", sorted(module for module in ALL if not outer(module)))
def test_imports_follow_the_folders(module: str) -> None:
    package = module.partition(".")[0]
    own = folder(module)
    for imported in imports(OURS[package][module]):
        if imported not in OURS[package] or imported in (package, f"{package}.errors"):
            continue
        assert folder(imported) in {own, *MAY_IMPORT[own]}, f"{module} imports {imported}"


@pytest.mark.parametrize("module", sorted(module for module in ALL if is_in(module, PURE)))
def test_pure_folders_do_no_io_and_read_no_clock(module: str) -> None:
    package = module.partition(".")[0]
    roots = {imported.partition(".")[0] for imported in imports(OURS[package][module])}
    assert not roots & OUTSIDE


@pytest.mark.parametrize("module", sorted(OURS["hil"]))
def test_hil_never_imports_design_and_only_its_outer_layer_imports_the_firmware(module: str) -> None:
    roots = {imported.partition(".")[0] for imported in imports(OURS["hil"][module])}
    assert "design" not in roots
    assert "firmware_sim" not in roots or folder(module) in WITH_FIRMWARE or outer(module)


@pytest.mark.parametrize("module", sorted(OURS["firmware_sim"]))
def test_the_firmware_shares_no_wire_code_or_guard_with_the_gateway(module: str) -> None:
    for imported in imports(OURS["firmware_sim"][module]):
        assert not is_in(imported, ["design"])
        if is_in(imported, ["hil.core"]):
            assert imported in FROM_HIL_FOR_FIRMWARE, f"{module} imports {imported}"


@pytest.mark.parametrize("module", sorted(OURS["design"]))
def test_design_imports_the_core_and_recordings_of_hil_and_no_more(module: str) -> None:
    for imported in imports(OURS["design"][module]):
        assert not is_in(imported, ["firmware_sim"])
        if is_in(imported, ["hil"]) and imported != "hil":
            assert is_in(imported, FROM_HIL_FOR_DESIGN), f"{module} imports {imported}"


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
    assert "hil.core.rig" in loaded
    assert SLOW & set(loaded) == allowed


def test_pytest_starts_with_the_plugin_without_slow_libraries() -> None:
    """The plugin and its three parts are imported in every pytest session where the package is installed."""
    parts = [f"hil.testing.{name}" for name in ("plugin", "fixtures", "evidence", "vcan_session")]
    program = f"import sys, pytest, {', '.join(parts)}\nprint(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert set(parts) <= loaded
    assert not loaded & (SLOW | {"can", "numpy", "msgspec", "firmware_sim", "hil.core.gateway"})


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
