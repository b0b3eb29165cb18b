"""The exponential of a batch of matrices, against scipy's of single ones."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from design.mathematics.matrix_exponential import exponential


@pytest.mark.parametrize("size", [1e-6, 0.3, 1.0, 30.0])
def test_the_batch_agrees_with_scipy(size: float) -> None:
    M = size * np.random.default_rng(1).normal(size=(20, 5, 5))
    M -= 3.0 * size * np.eye(5)
    for ours, one in zip(exponential(M), M, strict=True):
        expected = scipy.linalg.expm(one)
        np.testing.assert_allclose(ours, expected, atol=1e-12 * max(1.0, np.abs(expected).max()))


def test_exponentials_that_are_known_in_closed_form() -> None:
    stiff, shear, turn = (
        exponential(np.array([M]))[0]
        for M in ([[0.0, 0.0], [0.0, -50.0]], [[0.0, 1.0], [0.0, 0.0]], [[0.0, 7.0], [-7.0, 0.0]])
    )
    np.testing.assert_allclose(stiff, np.diag([1.0, np.exp(-50.0)]), atol=1e-15)
    np.testing.assert_allclose(shear, [[1.0, 1.0], [0.0, 1.0]])
    np.testing.assert_allclose(turn, [[np.cos(7.0), np.sin(7.0)], [-np.sin(7.0), np.cos(7.0)]], atol=1e-13)


def test_a_slow_mode_keeps_its_digits_beside_a_very_fast_one() -> None:
    slow = exponential(np.array([[[-1e-3, 0.0], [0.0, -1e7]]]))[0, 0, 0]
    assert slow == pytest.approx(np.exp(-1e-3), rel=1e-14)


def test_no_matrix_depends_on_the_others_of_its_batch() -> None:
    calm, wild = np.array([[0.1, 0.2], [0.3, -0.4]]), np.array([[-900.0, 50.0], [7.0, -3000.0]])
    together = exponential(np.stack([calm, wild]))
    assert together[0].tolist() == exponential(calm[None])[0].tolist()
