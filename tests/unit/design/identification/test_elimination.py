"""Elimination of unknowns that matter to a part of the data, against one large least-squares problem."""

from __future__ import annotations

import numpy as np
import pytest

from design.identification.estimators.elimination import Layout, projected, reduce
from design.identification.least_squares import solved, triangle


def test_the_result_is_that_of_one_large_problem() -> None:
    random = np.random.default_rng(1)
    lengths, experiments, layout = (40, 25, 60), (0, 0, 1), Layout(2, 1, 4)
    blocks = [random.standard_normal((sum(layout), length)) for length in lengths]
    reduced = reduce(blocks, experiments, layout)
    # Unknowns: 3 stretches x 2, 2 experiments x 1, 3 shared.
    rows = []
    for i, (block, experiment) in enumerate(zip(blocks, experiments, strict=True)):
        row = np.zeros((block.shape[1], 11))
        row[:, 2 * i : 2 * i + 2] = block[:2].T
        row[:, 6 + experiment] = block[2]
        row[:, 8:] = block[3:6].T
        rows.append(row)
    A, y = np.concatenate(rows), np.concatenate([block[-1] for block in blocks])
    expected, cost, *_ = np.linalg.lstsq(A, y, rcond=None)
    shared = solved(reduced.shared[:, :3], reduced.shared[:, 3])
    np.testing.assert_allclose(shared, expected[8:])
    assert reduced.shared[3, 3] ** 2 == pytest.approx(cost[0])
    values = np.concatenate([shared, [-1.0]])
    common = [reduced.common_values(experiment, values) for experiment in experiments]
    np.testing.assert_allclose(np.concatenate(common), expected[6 + np.array(experiments)])
    np.testing.assert_allclose(reduced.local_values(common, values).ravel(), expected[:6])
    orthogonal = np.concatenate(projected(blocks, experiments, reduced), axis=1)
    np.testing.assert_allclose(orthogonal @ A[:, :8], 0.0, atol=1e-12)
    np.testing.assert_allclose(orthogonal @ orthogonal.T, reduced.shared[:3, :3].T @ reduced.shared[:3, :3])


@pytest.mark.parametrize("rows", [1, 3, 4, 100, 1125, 1126, 2249, 30_000])
def test_tall_matrices_are_triangularised_piece_by_piece(rows: int) -> None:
    columns = np.random.default_rng(2).standard_normal((4, rows))
    R = triangle(columns)
    assert R.shape == (min(rows, 4), 4)
    np.testing.assert_allclose(R.T @ R, columns @ columns.T, atol=1e-12 * rows)
    np.testing.assert_array_equal(R, np.triu(R))


def test_tall_least_squares() -> None:
    random = np.random.default_rng(3)
    rows = random.standard_normal((30_000, 3)) * [1.0, 1e-9, 1e9]
    expected = np.array([1.0, 2e9, 3e-9])
    orthogonal = random.standard_normal(30_000)
    units = rows / np.linalg.norm(rows, axis=0)
    orthogonal -= units @ np.linalg.lstsq(units, orthogonal, rcond=None)[0]
    np.testing.assert_allclose(solved(rows, rows @ expected + orthogonal), expected, rtol=1e-9)


def test_fewer_rows_than_unknowns() -> None:
    reduced = reduce([np.ones((4, 1))], [0], Layout(1, 1, 2))
    assert reduced.shared.shape == (2, 2)
    assert not reduced.shared.any()
