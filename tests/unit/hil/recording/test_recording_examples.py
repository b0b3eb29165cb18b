"""The examples in the docstring of ``open_recording``, on a lockstep run of the shipped rig."""

from __future__ import annotations

import doctest
from pathlib import Path

import pytest

import hil.recording
from hil.cli import main


def test_the_examples_in_the_docstrings_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", "--lockstep", "--duration", "2", "--record", "run.mcap"]) == 0
    failed, attempted = doctest.testmod(hil.recording)
    assert attempted > 10
    assert failed == 0
