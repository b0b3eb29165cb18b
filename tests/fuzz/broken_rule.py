"""The exception for a rule that the gateway has broken."""

from __future__ import annotations


class BrokenRule(Exception):  # noqa: N818  # it is a finding about the gateway, not an error of the checker
    """A call of the gateway whose output must not be."""

    def __init__(self, rule: str, text: str) -> None:
        super().__init__(f"{rule}: {text}")
        self.rule = rule
