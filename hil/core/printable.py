"""Texts of operators as the log shows them."""

from __future__ import annotations


def printable(text: str) -> str:
    """Return ``text`` with a question mark for each character that could act on a terminal."""
    return text if text.isprintable() else "".join(c if c.isprintable() else "?" for c in text)
