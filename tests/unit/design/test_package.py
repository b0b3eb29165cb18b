"""The package's documentation: its example runs as printed, and importing the package loads nothing else."""

from __future__ import annotations

import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import design


def test_the_example_runs_as_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"::\n\n((?: {4}.*\n|\n)+)", design.__doc__ or "")
    assert len(blocks) == 2
    exec(textwrap.dedent("".join(blocks)), {})
    assert capsys.readouterr().out == "0.5724 designs/paper/controller.json Action.RUN\n"
    assert (tmp_path / "designs/paper/report.html").exists()


def test_importing_the_package_imports_nothing_else() -> None:
    program = "import sys, design; sys.exit(any(name.startswith('design.') for name in sys.modules))"
    subprocess.run([sys.executable, "-c", program], check=True)
