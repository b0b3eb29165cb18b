"""Runs the tests that need ``vcan0`` through ``hil vcan`` where this process has none.

The session that the user started (the outer one) begins a second pytest for these tests, once, where
``vcan0`` exists. The second pytest (the inner one) writes the reports of its tests to a file, as pytest-xdist
sends them between processes. The outer session reports them in the places of its own tests. With
pytest-xdist, the first worker that comes here runs the inner pytest, and the others wait for its reports.
"""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any, Final

import pytest

REPORTS_VARIABLE: Final = "HIL_VCAN_REPORTS"
"""Environment variable with the file to which the inner pytest writes its reports."""
_SHOWN_LINES: Final = 30
_ADVICE: Final = "`hil doctor` shows what this machine offers for virtual CAN and what to install"


def needs_vcan(item: pytest.Item) -> bool:
    """Return whether a test needs the interface ``vcan0``, by its mark or its fixtures."""
    return item.get_closest_marker("vcan") is not None or "vcan_interface" in getattr(
        item, "fixturenames", ()
    )


def report_writer(config: pytest.Config) -> ReportWriter | None:
    """Return the plugin of the inner pytest; None in any other session."""
    path = os.environ.get(REPORTS_VARIABLE)
    return None if path is None else ReportWriter(config, Path(path))


class ReportWriter:
    """In the inner pytest: writes every report as one line of JSON."""

    def __init__(self, config: pytest.Config, path: Path) -> None:
        self._config = config
        self._path = path

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Write a report."""
        data = self._config.hook.pytest_report_to_serializable(config=self._config, report=report)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(data, default=str) + "\n")


class VcanSession:
    """In the outer session: runs the inner pytest and reports its tests."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._reports: dict[str, list[Any]] | None = None
        """Serialised reports of the inner pytest by node id; None if the tests run in this process."""
        self._problem = ""
        """Reason why a test has no report."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> None:
        """Run the inner pytest before the tests of this session, outside the time limit of any test."""
        node_ids = [item.nodeid for item in session.items if needs_vcan(item)]
        if not node_ids or session.testsfailed or self._config.option.collectonly:
            return
        from hil.core.errors import EnvironmentLackError
        from hil.host.vcan import Way, choose_way

        try:
            way = choose_way()
        except EnvironmentLackError as error:
            self._reports, self._problem = {}, f"there is no vcan0 for this test: {error}\n{_ADVICE}"
            return
        if way is Way.NATIVE:
            return
        self._announce(f"hil: {len(node_ids)} tests with vcan0, in {way}")
        self._reports = self._run_once(node_ids)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> bool | None:
        """Report a test that ran in the inner pytest, in place of running it here."""
        if self._reports is None or not needs_vcan(item):
            return None
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for report in self._reports_of(item):
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def _reports_of(self, item: pytest.Item) -> list[Any]:
        assert self._reports is not None
        hook = self._config.hook
        reports = [
            hook.pytest_report_from_serializable(config=self._config, data=data)
            for data in self._reports.get(item.nodeid, [])
        ]
        if reports and reports[-1].when == "teardown":
            return reports
        problem = pytest.TestReport(
            nodeid=item.nodeid,
            location=item.location,
            keywords=dict.fromkeys(item.keywords, 1),
            outcome="failed",
            longrepr=self._problem,
            when="call",
        )
        return [*reports, problem]

    def _run_once(self, node_ids: list[str]) -> dict[str, list[Any]]:
        """Run the inner pytest, or wait until another worker of pytest-xdist has run it; read its reports."""
        worker_input = getattr(self._config, "workerinput", None)
        if worker_input is None:
            with tempfile.TemporaryDirectory(prefix="hil-vcan-reports-") as temporary:
                return self._run(Path(temporary), node_ids)
        folder = Path(tempfile.gettempdir()) / f"hil-vcan-reports-{worker_input['testrunuid']}"
        folder.mkdir(exist_ok=True)
        with (folder / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            return self._run(folder, node_ids)

    def _run(self, folder: Path, node_ids: list[str]) -> dict[str, list[Any]]:
        reports, output = folder / "reports", folder / "output"
        if not output.exists():
            environment = {
                name: value for name, value in os.environ.items() if not name.startswith("PYTEST_XDIST")
            }
            environment[REPORTS_VARIABLE] = str(reports)
            shows_output = self._config.getoption("capture") == "no"
            with output.open("wb") as file:
                subprocess.run(
                    self._command(node_ids),
                    cwd=self._config.invocation_params.dir,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=None if shows_output else file,
                    stderr=subprocess.STDOUT,
                )
        lines = output.read_text(encoding="utf-8", errors="replace").splitlines()
        self._problem = "\n".join(
            [
                "the test has no complete report: the pytest that ran it where vcan0 exists ended early. It "
                "printed:",
                *lines[-_SHOWN_LINES:],
                _ADVICE,
            ]
        )
        return _read_reports(reports)

    def _command(self, node_ids: list[str]) -> list[str]:
        config = self._config
        vcan = [sys.executable, "-P", "-m", "hil.cli", "vcan", "--"]
        tests = [_as_argument(node_id, config) for node_id in node_ids]
        options = ["--rootdir", str(config.rootpath)]
        if config.inipath is not None:
            options += ["-c", str(config.inipath)]
        if hasattr(config.option, "numprocesses"):  # pytest-xdist
            options += ["-n", "0"]
        if hasattr(config.option, "no_cov"):  # pytest-cov
            options += ["--no-cov"]
        is_safe = str(config.invocation_params.dir) not in sys.path and "" not in sys.path
        pytest_command = [sys.executable, *(["-P"] if is_safe else []), "-m", "pytest"]
        return [*vcan, *pytest_command, *_options_without_files(config), *options, *tests]

    def _announce(self, text: str) -> None:
        reporter = self._config.pluginmanager.getplugin("terminalreporter")
        if reporter is not None:
            reporter.ensure_newline()
            reporter.write_line(text)


def _as_argument(node_id: str, config: pytest.Config) -> str:
    """Return a node id, which is relative to the root folder, relative to the working directory."""
    file, colons, rest = node_id.partition("::")
    path = os.path.relpath(config.rootpath / file, config.invocation_params.dir)
    return f"{path}{colons}{rest}"


def _options_without_files(config: pytest.Config) -> list[str]:
    """Return the arguments with which this session was started, without the files and folders to test."""
    worker_input = getattr(config, "workerinput", None)
    given = config.invocation_params.args if worker_input is None else worker_input["mainargv"][1:]
    arguments = list(map(str, given))
    for file in reversed(getattr(config.option, "file_or_dir", None) or []):
        if file in arguments:
            del arguments[len(arguments) - 1 - arguments[::-1].index(file)]
    return arguments


def _read_reports(path: Path) -> dict[str, list[Any]]:
    by_node_id: defaultdict[str, list[Any]] = defaultdict(list)
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            data = json.loads(line)
            by_node_id[data["nodeid"]].append(data)
    return by_node_id
