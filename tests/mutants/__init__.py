"""Change the safety path in small ways, and require that a test fails for each change: ``make mutants``.

:mod:`operators` makes the mutants of a module. :mod:`function_trials` runs those of function bodies: it
collects the tests once, learns which test reaches which branch, and forks a process for each mutant.
:mod:`module_trials` runs those of constants and tables, for which the modules must be imported anew.

A mutant that no test notices *survives*. One that changes nothing that matters stands with its reason in
``equivalents.toml``.
"""
