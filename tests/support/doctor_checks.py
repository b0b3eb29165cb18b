"""Findings of the doctor, and files that stand for those of a kernel."""

from collections.abc import Iterable
from pathlib import Path

from hil.host.doctor import Check


def check_named(checks: Iterable[Check], name: str) -> Check:
    (check,) = (check for check in checks if check.name == name)
    return check


def write_kernel_file(root: Path, path: str, text: str) -> None:
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).write_text(text + "\n")
