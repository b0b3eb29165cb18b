"""The list of equivalent mutants, and the report of a run as text and as JSON."""

from __future__ import annotations

import json
import tomllib
from collections import Counter
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

from mutants.trial import Trial, Verdict

EQUIVALENTS = Path(__file__).with_name("equivalents.toml")
_LIVE = (Verdict.SURVIVED, Verdict.UNREACHED, Verdict.BROKEN)


class Equivalents:
    """Mutants that change nothing that matters, with the reason for each.

    A key of the file is the key of a mutant, or a pattern for several, with ``*`` for any text.
    """

    def __init__(self, path: Path = EQUIVALENTS) -> None:
        groups = tomllib.loads(path.read_text())["group"]
        self._reasons = {key: group["reason"] for group in groups for key in group["keys"]}
        self._used: set[str] = set()

    def reason(self, key: str) -> str | None:
        """Return why a mutant is equivalent, or None."""
        for pattern, reason in self._reasons.items():
            if key == pattern or fnmatchcase(key, pattern.replace("[", "[[]")):
                self._used.add(pattern)
                return str(reason)
        return None

    @property
    def unused(self) -> list[str]:
        """Keys for which no mutant has survived: a test notices them by now, or the code is gone."""
        return [pattern for pattern in self._reasons if pattern not in self._used]


class Report(NamedTuple):
    """The result of a run."""

    verdicts: dict[str, str]
    """Verdict by key of the mutant; ``equivalent`` for a survivor with a reason."""
    reasons: dict[str, str]
    """Reason by key of the equivalent mutant."""
    left_over: int
    """Number of mutants for which the time was too short."""

    @property
    def survivors(self) -> list[str]:
        """Keys of mutants that no test notices and that nobody has explained."""
        return sorted(key for key, verdict in self.verdicts.items() if verdict in _LIVE)

    def text(self) -> str:
        """Return the report for people."""
        counts = Counter(self.verdicts.values())
        rows = [f"{len(self.verdicts)} mutants: " + ", ".join(f"{n} {v}" for v, n in counts.most_common())]
        if self.left_over:
            rows.append(f"{self.left_over} mutants were left out, because the time was over")
        rows += [f"  {self.verdicts[key]}: {key}" for key in self.survivors]
        return "\n".join(rows)

    def write(self, path: Path) -> None:
        """Write the report as JSON."""
        path.parent.mkdir(parents=True, exist_ok=True)
        document = {"verdicts": self.verdicts, "reasons": self.reasons, "left_over": self.left_over}
        path.write_text(json.dumps(document, indent=1, sort_keys=True) + "\n")


def make_report(trials: Iterable[Trial], planned: int, equivalents: Equivalents) -> Report:
    """Join the verdicts of a run, of which ``planned`` mutants were to be tried."""
    verdicts, reasons = {}, {}
    for trial in trials:
        key, verdict = trial.mutant.key, str(trial.verdict)
        reason = equivalents.reason(key) if trial.verdict in _LIVE else None
        if reason is not None:
            verdict, reasons[key] = "equivalent", reason
        verdicts[key] = verdict
    return Report(verdicts, reasons, planned - len(verdicts))


def lines_of(keys: Sequence[str]) -> str:
    """Return keys, one a line."""
    return "".join(f"  {key}\n" for key in keys)
