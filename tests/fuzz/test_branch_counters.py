"""The counters of branches, by which the fuzzer is guided and mutants find their tests."""

from __future__ import annotations

import ast
from typing import Any

from support import branch_counters

SOURCE = '''"""Docstring."""
from __future__ import annotations


def way(x):
    """Docstring."""
    if x:
        return 1
    for _ in range(2):
        x = 3
    return x
'''


def test_both_ways_of_a_condition_are_counted() -> None:
    names: dict[str, Any] = {}
    tree = branch_counters.with_counters(ast.parse(SOURCE), "way.py")
    exec(compile(tree, "way.py", "exec", dont_inherit=True), names)
    branch_counters.take_branches()
    assert names["way"](1) == 1
    true_way = branch_counters.take_branches()
    assert names["way"](0) == 3
    false_way = branch_counters.take_branches()
    assert true_way.bit_count() == 2
    assert false_way.bit_count() == 3
    assert (true_way & false_way).bit_count() == 1
    assert branch_counters.take_branches() == 0
    body, loop = branch_counters.innermost("way.py", 8), branch_counters.innermost("way.py", 10)
    assert body is not None and loop is not None
    assert branch_counters.is_in(true_way, body) and not branch_counters.is_in(false_way, body)
    assert branch_counters.is_in(false_way, loop) and not branch_counters.is_in(true_way, loop)
    assert branch_counters.innermost("way.py", 1) is None
