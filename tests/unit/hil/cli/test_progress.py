"""What a run in lockstep shows: warnings with the simulated time."""

from __future__ import annotations

import pytest
from support.gateway_bench import make_stepped

from hil.cli.progress import LockstepProgress
from hil.core.output import Cycle, LogEntry, Severity


@pytest.mark.parametrize("duration_s", [10.0, 1000.0])
def test_warnings_have_the_time_and_brackets_are_kept(
    duration_s: float, capsys: pytest.CaptureFixture[str]
) -> None:
    gateway = make_stepped().core
    with LockstepProgress(duration_s) as progress:
        progress.log(LogEntry(Severity.WARNING, "vertical", "the setpoint begins at 0.1 m"))
        progress.cycle(Cycle(223, 2_500_000_000, 0, 0, 0, True, ()), gateway)
        progress.log(LogEntry(Severity.INFO, "arm", "not shown"))
        progress.log(LogEntry(Severity.FATAL, "adc", "folder a[/b] " + "long " * 40))
    shown = capsys.readouterr().err.splitlines()
    lines = [line.rstrip() for line in shown if " s  " in line]
    assert lines == [
        "     0.00 s  vertical: the setpoint begins at 0.1 m",
        ("     2.50 s  adc: folder a[/b] " + "long " * 40).rstrip(),
    ]
    assert "not shown" not in "".join(shown)
