"""Durations and sizes as people write them."""

from __future__ import annotations

_UNITS_S = (("days", 86_400), ("h", 3600), ("min", 60))


def duration_text(seconds: float) -> str:
    """Return a duration with its two largest units, such as ``1 h 30 min``; under 120 s in seconds."""
    if seconds < 120.0:
        return f"{seconds:g} s"
    rest = round(seconds)
    parts = []
    for unit, size in (*_UNITS_S, ("s", 1)):
        count, rest = divmod(rest, size)
        if count:
            parts.append(f"{count} {unit}".replace("1 days", "1 day") if count == 1 else f"{count} {unit}")
    return " ".join(parts[:2])


def size_text(size_bytes: float) -> str:
    """Return a number of bytes with three digits and a decimal prefix, such as ``1.25 GB``."""
    for unit in ("kB", "MB", "GB"):
        size_bytes /= 1000.0
        if size_bytes < 999.5:
            return f"{size_bytes:.3g} {unit}"
    return f"{size_bytes / 1000.0:.3g} TB"
