"""Durations and sizes are written as people write them."""

from __future__ import annotations

import pytest

from hil.cli.quantities import duration_text, size_text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.5, "0.5 s"),
        (10.0, "10 s"),
        (119.99, "119.99 s"),
        (120.0, "2 min"),
        (150.0, "2 min 30 s"),
        (3600.0, "1 h"),
        (5400.0, "1 h 30 min"),
        (5401.0, "1 h 30 min"),
        (86_400.0, "1 day"),
        (90_000.0, "1 day 1 h"),
        (8.64e7, "1000 days"),
    ],
)
def test_durations(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text


@pytest.mark.parametrize(
    ("size_bytes", "text"),
    [
        (0, "0 kB"),
        (1500, "1.5 kB"),
        (1_505_000, "1.5 MB"),
        (999_499_999, "999 MB"),
        (999_500_001, "1 GB"),
        (83.3e9, "83.3 GB"),
        (4.32e12, "4.32 TB"),
    ],
)
def test_sizes(size_bytes: float, text: str) -> None:
    assert size_text(size_bytes) == text
