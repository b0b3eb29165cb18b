"""Keys of earlier versions of the rig file, and what to write instead."""

from __future__ import annotations

from typing import Any

from hil.core.errors import DocumentError

_REPLACED_KEYS = {
    ("gateway", "heartbeat_periods"): "heartbeat_interval_s",
    ("adc", "heartbeat_timeout_periods"): "heartbeat_timeout_s",
    ("dac", "heartbeat_timeout_periods"): "heartbeat_timeout_s",
    ("dac", "watchdog_periods"): "watchdog_timeout_s",
}
"""Keys of version 0.1, which counted periods, and the keys in seconds that replace them."""


def refuse_replaced_keys(plain: dict[str, Any], source: str) -> None:
    """Refuse keys of version 0.1, and give the line to write instead of each. Raises DocumentError."""
    loop = plain.get("loop")
    period_s = loop.get("period_s") if isinstance(loop, dict) else None
    problems = []
    for (table, old), new in _REPLACED_KEYS.items():
        settings = plain.get(table)
        if not isinstance(settings, dict) or old not in settings:
            continue
        periods, example = settings[old], ""
        if _is_number(periods) and _is_number(period_s) and 0 < periods < 1e6:
            example = f" = {periods * period_s:.6g}, which is {periods} periods of {period_s} s"
        problems.append(f"{source}: {table}.{old}: this time is now given in seconds; write {new}{example}")
    if problems:
        raise DocumentError("\n".join(problems))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
