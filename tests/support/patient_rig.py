"""The shipped rig made patient: its limits bear a machine that stalls for tenths of a second."""

from __future__ import annotations

import re
from pathlib import Path

import hil

STALE_PERIODS, WATCHDOG_S, HEARTBEAT_S = 40, 0.504, 2.016


def write_patient_rig(path: Path) -> str:
    """Write the rig file to ``path``; returns it as a command's argument."""
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
