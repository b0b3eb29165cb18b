"""The names that a user imports: what is exported, that it is imported lazily, and that the examples run."""

import doctest
import importlib
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import design
import design.margin_summary
import firmware_sim
import hil
import hil.lockstep_rig
import hil.testing
import hil.testing.boards_alone
import hil.testing.gateway_alone

PACKAGES = (hil, firmware_sim, design)
WITH_NAMES = (*PACKAGES, hil.testing)
EXPORTED = {
    "hil.testing": [
        "BoardsAlone",
        "GatewayAlone",
        "VcanBoards",
        "VcanGateway",
        "VcanRig",
        "assert_step_response",
        "assert_within_limits",
    ],
    "hil": [
        "Client",
        "ControlLaw",
        "ControllerFile",
        "Frame",
        "Gateway",
        "HilError",
        "LockstepRig",
        "Recording",
        "Rig",
        "connect",
        "load_controller",
        "load_rig",
        "open_link",
        "open_recording",
        "run_experiment",
    ],
    "firmware_sim": [
        "AdcFaults",
        "Arm",
        "DacFaults",
        "FaultyRig",
        "LinearModel",
        "LinearPlant",
        "Plant",
        "SimulatedRig",
        "find_scenario",
        "parse_event",
        "parse_fault",
        "read_arm",
        "read_plant_file",
        "read_scenario",
        "shipped_arm",
        "wiring",
    ],
    "design": [
        "Design",
        "DesignError",
        "DesignFile",
        "Experiment",
        "Identification",
        "LoopMargins",
        "Plant",
        "Record",
        "RecordRefusedError",
        "Sampling",
        "controller_to_control",
        "design_controller",
        "identify",
        "identify_experiments",
        "load_design",
        "load_plant",
        "loop_margins",
        "model_to_control",
        "paper_plant",
        "plant_from_control",
        "plant_to_control",
        "read_record",
        "write_design",
    ],
}


@pytest.mark.parametrize("package", WITH_NAMES, ids=lambda package: package.__name__)
def test_each_exported_name_exists_and_is_described(package: ModuleType) -> None:
    for name in package.__all__:
        assert getattr(package, name) is not None
        assert f"``{name}``" in (package.__doc__ or "") or f":class:`{name}`" in (package.__doc__ or ""), name
    assert set(package.__all__) <= set(dir(package))


@pytest.mark.parametrize("name", EXPORTED)
def test_the_exported_names_are_these(name: str) -> None:
    assert sorted(importlib.import_module(name).__all__) == EXPORTED[name]


@pytest.mark.parametrize("package", WITH_NAMES, ids=lambda package: package.__name__)
def test_an_unknown_name_is_an_attribute_error(package: ModuleType) -> None:
    with pytest.raises(AttributeError, match=f"module '{package.__name__}' has no attribute 'nonsense'"):
        package.nonsense  # noqa: B018


def test_importing_the_packages_imports_nothing_else() -> None:
    program = (
        "import sys; import hil, design, firmware_sim; "
        "print(*{'numpy', 'scipy', 'msgspec', 'can'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_each_package_says_that_it_is_typed(package: ModuleType) -> None:
    assert package.__file__ is not None
    assert (Path(package.__file__).parent / "py.typed").exists()


@pytest.mark.parametrize(
    "module",
    [
        *PACKAGES,
        hil.lockstep_rig,
        hil.testing.boards_alone,
        hil.testing.gateway_alone,
        design.margin_summary,
    ],
    ids=lambda module: module.__name__,
)
def test_the_examples_in_the_docstrings_run(
    module: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = doctest.testmod(module, optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    assert result.attempted > 0
    assert result.failed == 0
