"""Algebra of batches of polynomials, against numpy's algebra of single ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from design.mathematics import polynomials as poly

coefficients = st.lists(st.floats(-9.0, 9.0).map(lambda x: round(x, 3)), min_size=1, max_size=7)


def row(values: list[float]) -> np.ndarray:
    return np.array([values])


@given(coefficients, coefficients, st.floats(-2.0, 2.0))
def test_sum_product_and_value(p: list[float], q: list[float], s: float) -> None:
    points = np.array([[s]])
    assert poly.at(row(p), points)[0, 0] == pytest.approx(np.polyval(p, s), abs=1e-9)
    product, total = poly.multiply(row(p), row(q)), poly.add(row(p), row(q))
    assert np.polyval(product[0], s) == pytest.approx(np.polyval(p, s) * np.polyval(q, s), abs=1e-7)
    assert np.polyval(total[0], s) == pytest.approx(np.polyval(p, s) + np.polyval(q, s), abs=1e-9)


@given(coefficients, st.floats(0.0, 3.0))
def test_the_squared_magnitude_on_the_imaginary_axis(p: list[float], omega: float) -> None:
    expected = abs(np.polyval(p, 1j * omega)) ** 2
    assert poly.at(poly.squared_magnitude(row(p)), np.array([[omega**2]]))[0, 0] == pytest.approx(
        expected, abs=1e-6
    )
    assert poly.squared_magnitude_at(row(p), np.array([[omega]]))[0, 0] == pytest.approx(
        expected, rel=1e-9, abs=1e-9
    )
    even, odd = poly.even_odd(row(p))
    x = np.array([[omega**2]])
    value = poly.at(even, x)[0, 0] + 1j * omega * poly.at(odd, x)[0, 0]
    assert value == pytest.approx(np.polyval(p, 1j * omega), abs=1e-9)


def test_the_squared_magnitude_keeps_its_digits_near_a_lightly_damped_root() -> None:
    zeta = 1e-7
    near = poly.squared_magnitude_at(np.array([1.0, 2.0 * zeta, 1.0]), np.array([1.0]))
    assert near[0] == pytest.approx((2.0 * zeta) ** 2, rel=1e-12)


def test_roots_keep_their_digits_beside_a_nearly_vanishing_coefficient() -> None:
    wanted = np.array([-30.0, -7.0, -2.0, -1.0, -0.004, 5.0])
    p = np.poly(wanted)
    batch = np.stack([np.concatenate([[lead], p]) for lead in (0.0, 1e-12, 1e-40, 1e-150)])
    for found in poly.roots(batch):
        far = np.argmax(np.abs(found))
        assert np.abs(found[far]) > 1e10
        np.testing.assert_allclose(np.sort(np.delete(found, far).real), wanted, rtol=1e-9)
    assert np.isinf(poly.roots(batch)[0]).sum() == 1


def test_multiple_leading_zeros_and_a_root_at_zero() -> None:
    found = poly.roots(np.array([[0.0, 0.0, 1.0, 3.0, 2.0, 0.0]]))[0]
    assert np.isinf(found).sum() == 2
    np.testing.assert_allclose(np.sort(found[np.isfinite(found)].real), [-2.0, -1.0, 0.0], atol=1e-12)


@given(
    st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(0.1, 3.0)), min_size=1, max_size=4), st.floats(-3, 3)
)
def test_routh_agrees_with_the_roots(pairs: list[tuple[float, float]], real: float) -> None:
    roots = [complex(a, side * b) for a, b in pairs for side in (1.0, -1.0)] + [complex(real)]
    largest = max(root.real for root in roots)
    if abs(largest) < 1e-3:
        return
    p = np.poly(roots).real
    assert bool(poly.hurwitz(p[None, :])[0]) == (largest < 0.0)
    assert bool(poly.hurwitz(-p[None, :])[0]) == (largest < 0.0)
    assert poly.spectral_abscissa(p[None, :])[0] == pytest.approx(largest, abs=1e-3)


def test_routh_of_a_batch_of_degrees_zero_and_one() -> None:
    assert poly.hurwitz(np.array([[2.0]])).tolist() == [True]
    assert poly.hurwitz(np.array([[1.0, 1.0], [1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])).tolist() == [
        True,
        False,
        False,
        False,
    ]


def test_a_fraction_is_substituted_into_a_polynomial() -> None:
    p, s = np.array([2.0, -3.0, 0.5, 1.0]), 0.7
    substituted = poly.substitute_fraction(p, (2.0, -2.0), (1.0, 1.0))
    fraction = (2.0 * s - 2.0) / (s + 1.0)
    assert np.polyval(substituted, s) == pytest.approx(np.polyval(p, fraction) * (s + 1.0) ** 3)
