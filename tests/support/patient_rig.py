"""The shipped rig file with limits that tolerate a machine that stalls for some tenths of a second."""

from __future__ import annotations

import re
from pathlib import Path

import hil

STALE_PERIODS, WATCHDOG_PERIODS, HEARTBEAT_PERIODS = 40, 45, 180


def write_patient_rig(path: Path) -> str:
    """Write the rig file to ``path``, and return the path as an argument of a command."""
    text = (Path(hil.__file__).parent / "shipped" / "rig.toml").read_text()
    for key, periods, places in (
        ("stale_after_periods", STALE_PERIODS, 1),
        ("watchdog_periods", WATCHDOG_PERIODS, 1),
        ("heartbeat_timeout_periods", HEARTBEAT_PERIODS, 2),
    ):
        text, count = re.subn(rf"^{key} = \d+", f"{key} = {periods}", text, flags=re.MULTILINE)
        assert count == places
    path.write_text(text)
    return str(path)
