"""The nearest valid word to one that somebody mistyped."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

_MAX_COMPARED = 100
"""Longer words are not compared: nobody types them, and the comparison takes quadratic time."""


def nearest(word: str, valid: Iterable[str]) -> str | None:
    """Return the valid word that is most like ``word``, ignoring case; None where none is similar.

    Among similar words, one with the same letters is preferred: two letters were exchanged.
    """
    by_lower_case = {candidate.lower(): candidate for candidate in valid}
    if len(word) > _MAX_COMPARED:
        return None
    found = get_close_matches(word.lower(), by_lower_case)
    if not found:
        return None
    letters = sorted(word.lower())
    exchanged = (candidate for candidate in found if sorted(candidate) == letters)
    return by_lower_case[next(exchanged, found[0])]


def did_you_mean(word: str, valid: Iterable[str]) -> str:
    """Return ``; did you mean X?``, or an empty text where no valid word is similar."""
    suggestion = nearest(word, valid)
    return "" if suggestion is None else f"; did you mean {suggestion}?"
