"""The daemon's log on a terminal and in the journal."""

from __future__ import annotations

import json
import os
import re
import socket
import time
from pathlib import Path

import pytest

from hil.core.output import LogEntry, Severity
from hil.views import log_lines
from hil.views.log_lines import LogLines, goes_to_journal, log_line


@pytest.fixture
def utc(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()


@pytest.mark.usefixtures("utc")
def test_a_line_has_time_severity_source_and_text() -> None:
    line = log_line(1_700_000_000.125, 30, "loop", "woke up\nlate", is_journal=False)
    assert line == "2023-11-14 22:13:20.125 warning  loop: woke up late\n"


@pytest.mark.parametrize(
    ("severity", "prefix"), list(zip(Severity, ("<6>", "<4>", "<3>", "<2>"), strict=True))
)
def test_a_line_of_the_journal_begins_with_its_level(severity: Severity, prefix: str) -> None:
    line = log_line(0.0, severity, "adc", "lost", is_journal=True)
    assert line.startswith(prefix)
    assert line.endswith("  adc: lost\n")


def test_the_journal_is_recognised_by_device_and_inode(tmp_path: Path) -> None:
    with (tmp_path / "log").open("w") as file:
        status = os.fstat(file.fileno())
        assert goes_to_journal(file.fileno(), {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"})
        assert not goes_to_journal(file.fileno(), {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino + 1}"})
        assert not goes_to_journal(file.fileno(), {})


def test_the_process_prints_what_it_receives(capsys: pytest.CaptureFixture[str]) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.send(json.dumps({"log": [0.0, 40, "recorder", "disk full"]}).encode())
    ours.close()
    log_lines.main(theirs.detach())
    assert capsys.readouterr().err.endswith(" error    recorder: disk full\n")


def test_an_entry_is_printed_by_another_process(capfd: pytest.CaptureFixture[str]) -> None:
    lines = LogLines()
    lines.log(LogEntry(Severity.INFO, "life cycle", "offline -> ready (boards up)"))
    lines.close()
    assert re.fullmatch(
        r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3} info     life cycle: offline -> ready \(boards up\)\n",
        capfd.readouterr().err,
    )
