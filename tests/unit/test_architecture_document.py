"""hil/ARCHITECTURE.md says what the code does: its state diagram, and every path that it names."""

import re
from pathlib import Path

from hil.core.life_cycle import TRANSITIONS

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "hil" / "ARCHITECTURE.md").read_text(encoding="utf-8")


def test_the_state_diagram_is_the_transition_table() -> None:
    drawn = re.findall(r"^    (\w+) --> (\w+): (.+)$", TEXT, re.M)
    assert sorted(drawn) == sorted(
        (before.name.lower(), after.name.lower(), trigger.value)
        for (before, trigger), after in TRANSITIONS.items()
    )


def test_every_path_that_it_names_exists() -> None:
    named = re.findall(r"`((?:hil|design|firmware_sim|tests)/[\w/.]+)`", TEXT)
    assert len(named) > 20
    assert [path for path in named if not (ROOT / path).exists()] == []
