"""Write transfer functions as MathML formulas."""

from __future__ import annotations

import numpy as np

from design.mathematics.polynomials import Array
from design.models.transfer_function import TransferFunction


def transfer_function_formula(
    H: TransferFunction, name: str, dead_time_s: float = 0.0, *, variable: str = "s", digits: int = 5
) -> str:
    """Return H(s) exp(-s dead_time_s) as MathML; ``name`` is a symbol with an optional index: ``W 1``.

    ``variable`` is s, or z for a sampled model, which has its delay in H. Coefficients have ``digits``
    significant digits.
    """
    symbol, _, index = name.partition(" ")
    head = f"<msub><mi>{symbol}</mi><mi>{index}</mi></msub>" if index else f"<mi>{symbol}</mi>"
    argument = f'<mo stretchy="false">(</mo><mi>{variable}</mi><mo stretchy="false">)</mo>'
    num, den = (f"<mrow>{_polynomial(np.ravel(p), variable, digits)}</mrow>" for p in H)
    delay = f"<msup><mi>e</mi><mrow><mo>−</mo><mn>{dead_time_s:.5g}</mn><mi>s</mi></mrow></msup>"
    right = f"<mfrac>{num}{den}</mfrac>{delay if dead_time_s else ''}"
    return f'<math display="block"><mrow>{head}{argument}<mo>=</mo>{right}</mrow></math>'


def _polynomial(p: Array, variable: str, digits: int) -> str:
    """Return a polynomial (n + 1,) in falling powers of the variable, without the terms that are 0."""
    terms: list[str] = []
    for i, coefficient in enumerate(p.tolist()):
        power = len(p) - 1 - i
        if coefficient == 0.0:
            continue
        sign = "−" if coefficient < 0.0 else ("+" if terms else "")
        size = f"{abs(coefficient):.{digits}g}"
        number = "" if size == "1" and power else _number(size)
        symbol = {0: "", 1: f"<mi>{variable}</mi>"}.get(
            power, f"<msup><mi>{variable}</mi><mn>{power}</mn></msup>"
        )
        terms.append((f"<mo>{sign}</mo>" if sign else "") + number + symbol)
    return "".join(terms) or "<mn>0</mn>"


def _number(text: str) -> str:
    """Return a number that is not negative, with a power of ten where Python writes an exponent."""
    mantissa, _, exponent = text.partition("e")
    if not exponent:
        return f"<mn>{mantissa}</mn>"
    power = str(int(exponent)).replace("-", "−")
    return f"<mn>{mantissa}</mn><mo>·</mo><msup><mn>10</mn><mn>{power}</mn></msup>"
