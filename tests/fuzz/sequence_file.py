"""The file of one sequence: JSON, one step a line."""

from __future__ import annotations

import json
from pathlib import Path

from fuzz.fuzzer import Failure
from fuzz.steps import Sequence


def write_failure(failure: Failure, folder: Path, seed: int) -> Path:
    """Write a failure to a new file in ``folder`` and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{failure.rule.replace(' ', '-').lower()}-{seed}.json"
    sequence = failure.sequence
    head = {"rule": failure.rule, "text": failure.text, "rig": sequence.rig}
    head |= {"law": sequence.law, "setpoint": sequence.setpoint}
    steps = ",\n".join(f"  {json.dumps(step)}" for step in sequence.steps)
    path.write_text(json.dumps(head, indent=1)[:-2] + f',\n "steps": [\n{steps}\n ]\n}}\n')
    return path


def read_sequence(path: Path) -> Sequence:
    """Read the sequence of a file."""
    document = json.loads(path.read_text())
    return Sequence(document["rig"], document["law"], document["setpoint"], document["steps"])
