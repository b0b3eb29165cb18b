"""The shipped rig file with limits that tolerate a machine that stalls for some tenths of a second."""

from __future__ import annotations

import re
from pathlib import Path

import hil

STALE_PERIODS, WATCHDOG_S, HEARTBEAT_S = 40, 0.504, 2.016


def write_patient_rig(path: Path) -> str:
    """Write the rig file to ``path``, and return the path as an argument of a command."""
    text = (Path(hil.__file__).parent / "shipped" / "rig.toml").read_text()
    for key, limit, places in (
        ("stale_after_periods", STALE_PERIODS, 1),
        ("watchdog_timeout_s", WATCHDOG_S, 1),
        ("heartbeat_timeout_s", HEARTBEAT_S, 2),
    ):
        text, count = re.subn(rf"^{key} = [\d.]+", f"{key} = {limit}", text, flags=re.MULTILINE)
        assert count == places
    path.write_text(text)
    return str(path)
