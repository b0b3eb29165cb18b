"""The mutation runner: its operators, its trials, and its report."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import pytest

from mutants.operators import Mutant, mutants_of, mutated
from mutants.report import Equivalents, make_report
from mutants.trial import Trial, Verdict, limit_processor_time, run_trials

CHANGES = {
    "a < b": {"a <= b", "a >= b"},
    "a >= b": {"a > b", "a < b"},
    "a == b": {"a != b"},
    "a is None": {"a is not None"},
    "a in b": {"a not in b"},
    "a < b < 3": {"a <= b < 3", "a >= b < 3", "a < b <= 3", "a < b >= 3", "a < b < 4", "a < b < 2"},
    "a + b": {"a - b"},
    "a * b": {"a / b"},
    "a // b": {"a * b"},
    "a & b": {"a | b"},
    "a << b": {"a >> b"},
    "-a": {"a"},
    "not a": {"a"},
    "a and b": {"a or b"},
    "a if b else 0.5": {"a if True else 0.5", "a if False else 0.5", "a if b else 1.5", "a if b else -0.5"},
    "True": {"False"},
    "7": {"8", "6"},
    "(a, b)": {"(b,)", "(a,)"},
    "{a: 'x'}": {"{}", "{a: 'x?'}"},
    "f'{a + 1} V'": set(),
    "'text'": set(),
    "zip(a, b, strict=True)": set(),
}


@pytest.mark.parametrize("expression", CHANGES)
def test_an_expression_has_these_mutants(expression: str) -> None:
    source = f"x = {expression}\n"
    found = [mutated(source, mutant).strip().removeprefix("x = ") for mutant in mutants_of(source, "m.py")]
    assert len(found) == len(set(found))
    assert set(found) == CHANGES[expression]


STATEMENTS = '''
def function(x: int | None = None) -> bool:
    """Docstring with 1."""
    assert x, "never changed"
    self.count += 1
    self.list.append(x)
    if x:
        raise ValueError("text")
    return x
'''


def test_statements_conditions_and_results_are_changed() -> None:
    found = {mutant.key.split("::", 2)[2] for mutant in mutants_of(STATEMENTS, "m.py")}
    assert found == {
        "arithmetic::self.count += 1 -> self.count -= 1",
        "statement::self.count += 1 -> pass",
        "constant::1 -> 2",
        "constant::1 -> 0",
        "statement::self.list.append(x) -> pass",
        "condition::x -> True",
        "condition::x -> False",
        "statement::raise ValueError('text') -> pass",
        "return::return x -> return None",
    }


def test_a_key_names_path_and_function_and_does_not_depend_on_lines() -> None:
    source = "class Guard:\n    def check(self):\n        return 1 if self.a else 1\n"
    keys = [mutant.key for mutant in mutants_of(source, "m.py")]
    assert keys == [mutant.key for mutant in mutants_of("# comment\n\n" + source, "m.py")]
    assert "m.py::Guard.check::constant::1 -> 2" in keys
    assert "m.py::Guard.check::constant::1 -> 2 (2)" in keys
    assert len(keys) == len(set(keys))


def test_a_function_within_a_function_has_the_name_that_python_gives_it() -> None:
    source = "class Guard:\n  def check(self):\n    def limit():\n      return 7\n    return limit\n"
    names = {mutant.function for mutant in mutants_of(source, "m.py")}
    assert names == {"Guard.check", "Guard.check.<locals>.limit"}


def mutant(key: str) -> Mutant:
    return Mutant(key, "m.py", "f", 1, 0)


def test_each_mutant_gets_the_verdict_of_its_own_process() -> None:
    def survives(tried: Mutant) -> bool:
        match tried.key:
            case "survivor":
                return True
            case "endless":
                limit_processor_time(0.0)
                while True:
                    pass
            case "crash":
                os.kill(os.getpid(), signal.SIGKILL)
            case "exception":
                raise ValueError("in the trial")
        return False

    keys = ["survivor", "endless", "crash", "exception", "noticed"]
    trials = run_trials(map(mutant, keys), survives, workers=2, until_s=time.monotonic() + 100.0)
    assert {trial.mutant.key: trial.verdict for trial in trials} == {
        "survivor": Verdict.SURVIVED,
        "endless": Verdict.TIMED_OUT,
        "crash": Verdict.KILLED,
        "exception": Verdict.BROKEN,
        "noticed": Verdict.KILLED,
    }


def test_no_trial_begins_when_the_time_is_over() -> None:
    assert list(run_trials([mutant("late")], lambda _: True, 2, until_s=time.monotonic())) == []


def test_a_survivor_with_a_reason_is_equivalent(tmp_path: Path) -> None:
    path = tmp_path / "equivalents.toml"
    keys = '["m.py::describe::*", "m.py::x[0] -> x[1]", "gone"]'
    path.write_text(f'[[group]]\nreason = "text"\nkeys = {keys}\n')
    equivalents = Equivalents(path)
    verdicts = {
        "m.py::describe::a": Verdict.SURVIVED,
        "m.py::x[0] -> x[1]": Verdict.UNREACHED,
        "m.py::other": Verdict.SURVIVED,
        "m.py::dead": Verdict.KILLED,
    }
    trials = [Trial(mutant(key), verdict) for key, verdict in verdicts.items()]
    report = make_report(trials, planned=6, equivalents=equivalents)
    assert report.survivors == ["m.py::other"]
    assert report.reasons == {"m.py::describe::a": "text", "m.py::x[0] -> x[1]": "text"}
    assert report.text().splitlines() == [
        "4 mutants: 2 equivalent, 1 survived, 1 killed",
        "2 mutants were left out, because the time was over",
        "  survived: m.py::other",
    ]
    assert equivalents.unused == ["gone"]
    report.write(tmp_path / "new" / "mutants.json")
    assert json.loads((tmp_path / "new" / "mutants.json").read_text())["verdicts"]["m.py::dead"] == "killed"


def test_the_list_of_equivalents_can_be_read() -> None:
    assert Equivalents().reason("no such mutant") is None
