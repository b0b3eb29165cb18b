"""Model structures: what the estimators may vary, and how a user writes it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from design.errors import DesignError
from hil.core.suggestions import did_you_mean

MAX_ORDER = 12
"""Largest order of a polynomial. Beyond it, double precision cannot represent a fast-sampled denominator."""


MAX_REGRESSION = 30
"""Largest order of a polynomial of an ARX model, whose coefficients are found by linear least squares."""


@dataclass(frozen=True)
class OutputError:
    """y = q^-nk B/F u + e, with nb coefficients in B and nf in F."""

    nb: int = 1
    nf: int = 3
    nk: int = 1

    def __post_init__(self) -> None:
        _check(str(self), positive={"nb": self.nb}, others={"nf": self.nf, "nk": self.nk})

    def __str__(self) -> str:
        return f"OE({self.nb},{self.nf},{self.nk})"


@dataclass(frozen=True)
class Arx:
    """A y = q^-nk B u + e, with na coefficients in A and nb in B."""

    na: int
    nb: int
    nk: int = 1

    def __post_init__(self) -> None:
        _check(str(self), {"nb": self.nb}, {"na": self.na, "nk": self.nk}, MAX_REGRESSION)

    def __str__(self) -> str:
        return f"ARX({self.na},{self.nb},{self.nk})"


@dataclass(frozen=True)
class Armax:
    """A y = q^-nk B u + C e, with na, nb and nc coefficients."""

    na: int
    nb: int
    nc: int
    nk: int = 1

    def __post_init__(self) -> None:
        _check(str(self), positive={"nb": self.nb}, others={"na": self.na, "nc": self.nc, "nk": self.nk})

    def __str__(self) -> str:
        return f"ARMAX({self.na},{self.nb},{self.nc},{self.nk})"


@dataclass(frozen=True)
class BoxJenkins:
    """y = q^-nk B/F u + C/D e, with nb, nc, nd and nf coefficients."""

    nb: int
    nc: int
    nd: int
    nf: int
    nk: int = 1

    def __post_init__(self) -> None:
        others = {"nc": self.nc, "nd": self.nd, "nf": self.nf, "nk": self.nk}
        _check(str(self), positive={"nb": self.nb}, others=others)

    def __str__(self) -> str:
        return f"BJ({self.nb},{self.nc},{self.nd},{self.nf},{self.nk})"


@dataclass(frozen=True)
class ContinuousPoles:
    """G(s) = exp(-τ s) N(s) / (s^i Π(s + p) Π(s² + 2ζω s + ω²)) behind a zero-order hold.

    All poles but the integrators are stable. The ``zeros`` may lie anywhere.
    """

    real: int = 1
    pairs: int = 1
    zeros: int = 0
    integrators: int = 0
    max_dead_time_s: float = 0.0
    """Largest dead time τ of the search. τ need not be whole samples. 0 means no dead time."""

    def __post_init__(self) -> None:
        counts = {
            "real": self.real,
            "pairs": self.pairs,
            "zeros": self.zeros,
            "integrators": self.integrators,
        }
        _check(str(self), positive={"real + 2 pairs": self.real + 2 * self.pairs}, others=counts)
        if self.integrators > 1:
            raise DesignError(f"{self}: {self.integrators} integrators; at most 1 is supported")
        if self.zeros >= self.order:
            raise DesignError(
                f"{self}: {self.zeros} zeros with {self.order} poles; a plant has fewer zeros than poles"
            )
        if not 0.0 <= self.max_dead_time_s < float("inf"):
            raise DesignError(
                f"{self}: max_dead_time_s {self.max_dead_time_s} s; it must be finite and not negative"
            )

    @property
    def order(self) -> int:
        """Number of poles."""
        return self.integrators + self.real + 2 * self.pairs

    def __str__(self) -> str:
        parts = [f"real={self.real}", f"pairs={self.pairs}", f"zeros={self.zeros}"]
        if self.integrators:
            parts.append(f"integrators={self.integrators}")
        if self.max_dead_time_s:
            parts.append(f"max_dead_time_s={self.max_dead_time_s:g}")
        return f"continuous({', '.join(parts)})"


Structure = OutputError | Arx | Armax | BoxJenkins | ContinuousPoles


def parameters_of(structure: Structure) -> int:
    """Return the number of parameters of a structure."""
    match structure:
        case OutputError(nb, nf):
            return nb + nf
        case Arx(na, nb):
            return na + nb
        case Armax(na, nb, nc):
            return na + nb + nc
        case BoxJenkins(nb, nc, nd, nf):
            return nb + nc + nd + nf
        case ContinuousPoles():
            dead_time = structure.max_dead_time_s > 0.0
            return structure.real + 2 * structure.pairs + structure.zeros + 1 + dead_time


_ORDERS: dict[str, tuple[type[OutputError | Arx | Armax | BoxJenkins], int]] = {
    "OE": (OutputError, 3),
    "ARX": (Arx, 3),
    "ARMAX": (Armax, 4),
    "BJ": (BoxJenkins, 5),
}
FORMS = (
    "OE(nb,nf,nk), ARX(na,nb,nk), ARMAX(na,nb,nc,nk), BJ(nb,nc,nd,nf,nk) or continuous(real=1, pairs=1, "
    "zeros=0, integrators=0, max_dead_time_s=0)"
)
"""How structures are written."""


def parse_structure(text: str) -> Structure:
    """Read a structure as ``OE(1,3,1)`` or ``continuous(real=1, pairs=1)``. Raises DesignError."""
    match = re.fullmatch(r"\s*([A-Za-z]+)\s*(?:\(([^()]*)\))?\s*", text)
    if match is None:
        raise DesignError(f"structure {text!r} cannot be read; write {FORMS}")
    kind, inside = (
        match.group(1),
        [part.strip() for part in (match.group(2) or "").split(",") if part.strip()],
    )
    if kind.lower() == "continuous":
        return ContinuousPoles(**_keywords(text, inside))
    if kind.upper() not in _ORDERS:
        hint = did_you_mean(kind, [*_ORDERS, "continuous"])
        raise DesignError(f"structure {text!r} is not known{hint or '.'} Write {FORMS}")
    make, count = _ORDERS[kind.upper()]
    if not inside and make is OutputError:
        return OutputError()
    if len(inside) != count or not all(re.fullmatch(r"\d{1,4}", part) for part in inside):
        raise DesignError(f"structure {text!r} needs {count} whole numbers; write {FORMS}")
    return make(*map(int, inside))


def _keywords(text: str, parts: list[str]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for part in parts:
        key, equals, value = (piece.strip() for piece in part.partition("="))
        try:
            if not equals or key not in ContinuousPoles.__dataclass_fields__:
                raise ValueError
            values[key] = float(value) if key == "max_dead_time_s" else int(value)
        except ValueError:
            raise DesignError(f"structure {text!r}: {part!r} cannot be read; write {FORMS}") from None
    return values


def _check(
    structure: str, positive: dict[str, int], others: dict[str, int], largest: int = MAX_ORDER
) -> None:
    for key, value in positive.items():
        if value < 1:
            raise DesignError(f"{structure}: {key} = {value}; it must be at least 1")
    for key, value in others.items():
        if value < 0:
            raise DesignError(f"{structure}: {key} = {value}; it cannot be negative")
    for key, value in {**positive, **others}.items():
        if key != "nk" and value > largest:
            raise DesignError(f"{structure}: {key} = {value}; at most {largest} is supported")
