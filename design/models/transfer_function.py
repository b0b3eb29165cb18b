"""The pair of polynomials that all mathematics of this package works on."""

from __future__ import annotations

from typing import NamedTuple

from design.mathematics.polynomials import Array


class TransferFunction(NamedTuple):
    """A transfer function num/den: coefficients (..., n + 1) in falling powers of s or z.

    The leading axes count candidates; num and den may have different lengths.
    """

    num: Array
    den: Array
