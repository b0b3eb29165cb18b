"""The pytest plugin. It registers its parts when pytest is configured; each part imports the rest later."""

from __future__ import annotations

import pytest

MARKS = (
    "vcan: the test needs the CAN interface vcan0; where this kernel has none, it runs through `hil vcan`",
    "lockstep_rig(state='running', **options): options of hil.LockstepRig for the fixture lockstep_rig",
    "vcan_rig(**options): options of the fixtures vcan_rig, vcan_boards and vcan_gateway",
)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option for the folder of failed tests."""
    text = "folder for recording, plot and log of failed tests"
    parser.getgroup("hil").addoption("--hil-failures", metavar="DIR", help=f"{text} (default: hil-failures)")
    parser.addini("hil_failures", text, default="hil-failures")


def pytest_configure(config: pytest.Config) -> None:
    """Register the marks and the parts of the plugin."""
    from hil.testing import evidence, fixtures
    from hil.testing.vcan_session import VcanSession, report_writer

    for mark in MARKS:
        config.addinivalue_line("markers", mark)
    manager = config.pluginmanager
    manager.register(fixtures, "hil-fixtures")
    manager.register(evidence, "hil-evidence")
    manager.register(report_writer(config) or VcanSession(config), "hil-vcan")
