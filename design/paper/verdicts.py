"""What is printed beside what is computed, with a verdict that is computed too."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Verdict:
    """One printed figure, ours, and whether they agree; ``must_agree`` where disagreement is our mistake."""

    where: str
    what: str
    printed: str
    ours: str
    agrees: bool
    must_agree: bool
    why: str

    @property
    def failed(self) -> bool:
        """Whether something does not reproduce that should."""
        return self.must_agree and not self.agrees

    @property
    def text(self) -> str:
        """In a word or two."""
        if self.agrees:
            return "reproduced"
        return "DOES NOT REPRODUCE" if self.must_agree else "differs"


def number(
    where: str,
    what: str,
    printed: float,
    ours: float,
    tolerance: float,
    why: str = "",
    *,
    unit: str = "",
    must_agree: bool = True,
) -> Verdict:
    """Agrees where |ours - printed| is within the tolerance; it is stated beside the reading."""
    told = f"{why}; " if why else ""
    return Verdict(
        where,
        what,
        f"{printed:.6g}{unit}",
        f"{ours:.{_digits(printed)}g}{unit}",
        bool(abs(ours - printed) <= tolerance),
        must_agree,
        f"{told}tolerance {tolerance:.2g}{unit}",
    )


def _digits(printed: float) -> int:
    """Two more significant digits than are printed."""
    return max(len(f"{printed:g}".replace(".", "").strip("0")) + 2, 3)


def statement(
    where: str, what: str, ours: str, holds: bool, why: str = "", *, must_agree: bool = True
) -> Verdict:
    """What the paper says without a figure; ``ours`` is what it is judged by."""
    return Verdict(where, what, "stated", ours, bool(holds), must_agree, why)
