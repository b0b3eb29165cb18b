"""Check that a running daemon uses the same settings of an axis as a rig file on disk.

A calibration through a daemon measures relative to the daemon's settings, and changes the rig file. If the
two differ, its result is wrong. They differ, for example, if a calibration was written and the daemon was not
restarted.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec

from hil.core.calibration import CalibrationError
from hil.core.calibration_rig import calibration_text
from hil.core.rig import Rig, read_rig
from hil.host.text_file import read_text
from hil.operation.client import Client
from hil.shells.run_setup import RIG_NAME, SHIPPED

_DAEMON = "the daemon's rig"


def check_settings(client: Client, file: Path | None, axis: str) -> None:
    """Check that the daemon scales, limits and centres ``axis`` as the rig file does.

    ``file`` is None for the shipped rig file. A daemon that calibrates an axis is compared with the rig file
    as ``hil daemon --calibrate`` changes it. Raises CalibrationError.
    """
    source = str(file or RIG_NAME)
    text = read_text(file or SHIPPED / RIG_NAME)
    daemon = read_rig(client.rig_text(), _DAEMON)
    if daemon.calibration is not None and daemon.calibration in read_rig(text, source).axes:
        text = calibration_text(text, daemon.calibration, source)
    rig = read_rig(text, source)
    _refuse_differences(_settings(daemon, axis), _settings(rig, axis), source, axis)


def check_channels(client: Client, file: Path | None, rig: Rig, axis: str) -> None:
    """Check that the daemon's channels are those of the rig file ``rig``. Raises CalibrationError.

    Voltages of potentiometers depend on no other setting.
    """
    daemon = read_rig(client.rig_text(), _DAEMON)
    source = str(file or RIG_NAME)
    _refuse_differences(dict(_channels(daemon)), dict(_channels(rig)), source, axis)


def _settings(rig: Rig, axis: str) -> dict[str, object]:
    """Return the settings on which a measurement by jogs depends, by their keys in the rig file."""
    if axis not in rig.axes:
        return {}
    settings = rig.axes[axis]
    found: dict[str, object] = {"min_y": settings.min_y, "max_y": settings.max_y}
    for table, values in (("potentiometer", settings.potentiometer), ("valve", settings.valve)):
        found |= {f"{table}.{key}": value for key, value in msgspec.structs.asdict(values).items()}
    found["operator.jog_max_v"] = settings.operator_limits.jog_max_v
    return {f"axes.{axis}.{key}": value for key, value in found.items()}


def _channels(rig: Rig) -> Iterator[tuple[str, object]]:
    for name, axis in rig.axes.items():
        yield f"axes.{name}.potentiometer.channel", axis.potentiometer.channel
        yield f"axes.{name}.valve.channel", axis.valve.channel


def _refuse_differences(daemon: dict[str, object], file: dict[str, object], source: str, axis: str) -> None:
    key = next((key for key in {**file, **daemon} if file.get(key) != daemon.get(key)), None)
    if key is None:
        return
    raise CalibrationError(
        f"{axis}: the daemon does not use the settings of {source}: {key} is "
        f"{_shown(daemon.get(key))} in the daemon and {_shown(file.get(key))} in the file, so what is "
        "measured would not fit the file; end the daemon with `hil shutdown`, and start it again with this "
        "rig file"
    )


def _shown(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else "not given" if value is None else str(value)
