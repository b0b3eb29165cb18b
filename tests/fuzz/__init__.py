"""Stateful, coverage-guided fuzzing of the path from the bus to a valve: ``make fuzz``.

A *sequence* is a list of steps: frames, deadlines, operator's requests and faults of the bus.
:mod:`played_rig` gives it to one gateway and plays the boards. :mod:`checker` observes every call and shares
no code with the gateway. :mod:`fuzzer` keeps each sequence that reaches a new branch of the gateway in one of
its states, and changes the kept ones at random. :mod:`minimiser` shortens a sequence that breaks a rule.

Coverage comes from counters that ``support.branch_counters`` inserts into the source of ``hil.core`` when it
is imported. The package ``atheris`` was tried: it works, but it takes 62 MB, exists for x86_64 alone, and its
inputs are bytes, from which a sequence that passes counters and CRCs is rarely made.
"""
