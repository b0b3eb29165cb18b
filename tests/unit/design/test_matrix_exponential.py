"""The batched exponential against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from design.matrix_exponential import exponential


@pytest.mark.parametrize("size", [1e-6, 0.3, 1.0, 30.0])
def test_a_batch_is_scipys_one_by_one(size: float) -> None:
    M = size * np.random.default_rng(1).normal(size=(20, 5, 5))
    M -= 3.0 * size * np.eye(5)
    for ours, one in zip(exponential(M), M, strict=True):
        expected = scipy.linalg.expm(one)
        np.testing.assert_allclose(ours, expected, atol=1e-12 * max(1.0, np.abs(expected).max()))


def test_known_ones() -> None:
    np.testing.assert_allclose(exponential(np.diag([0.0, -50.0])), np.diag([1.0, np.exp(-50.0)]), atol=1e-15)
    np.testing.assert_allclose(exponential(np.array([[0.0, 1.0], [0.0, 0.0]])), [[1.0, 1.0], [0.0, 1.0]])
    turn = exponential(np.array([[0.0, 7.0], [-7.0, 0.0]]))
    np.testing.assert_allclose(turn, [[np.cos(7.0), np.sin(7.0)], [-np.sin(7.0), np.cos(7.0)]], atol=1e-13)
