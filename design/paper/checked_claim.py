"""One figure or statement that the paper prints, beside the computed one, and whether they agree."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CheckedClaim:
    """One printed figure or statement beside the computed one."""

    where: str
    """Place in the paper, such as ``eq. (18)``."""
    what: str
    """Quantity or statement that is compared."""
    printed: str
    """Printed figure with its unit; ``stated`` or ``implied`` where the paper prints no figure."""
    computed: str
    """Computed figure with its unit, or the computed facts that decide about a statement."""
    agrees: bool
    must_agree: bool
    """A disagreement is a mistake in this package, not in the paper."""
    explanation: str
    """How the paper was read, why the figures differ, and the tolerance."""

    @property
    def has_failed(self) -> bool:
        """True if the figures disagree although they must agree."""
        return self.must_agree and not self.agrees

    @property
    def result(self) -> str:
        """Result as text for tables."""
        if self.agrees:
            return "reproduced"
        return "DOES NOT REPRODUCE" if self.must_agree else "differs"


def check_number(
    where: str,
    what: str,
    printed: float,
    computed: float,
    tolerance: float,
    explanation: str = "",
    *,
    unit: str = "",
    must_agree: bool = True,
) -> CheckedClaim:
    """Compare a printed figure with the computed one.

    They agree if the absolute difference is within ``tolerance``, which the explanation states.
    """
    before = f"{explanation}; " if explanation else ""
    return CheckedClaim(
        where,
        what,
        f"{printed:.6g}{unit}",
        f"{computed:.{_significant_digits(printed)}g}{unit}",
        bool(abs(computed - printed) <= tolerance),
        must_agree,
        f"{before}tolerance {tolerance:.2g}{unit}",
    )


def check_statement(
    where: str, what: str, computed: str, holds: bool, explanation: str = "", *, must_agree: bool = True
) -> CheckedClaim:
    """Check a statement of the paper without a figure; ``computed`` gives the facts that decide about it."""
    return CheckedClaim(where, what, "stated", computed, bool(holds), must_agree, explanation)


def _significant_digits(printed: float) -> int:
    """Return two digits more than the paper prints, and at least three."""
    return max(len(f"{printed:g}".replace(".", "").strip("0")) + 2, 3)
