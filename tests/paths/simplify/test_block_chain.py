"""Cholesky's factor of a chain of blocks against NumPy's."""

import numpy as np
import pytest

from safe_ompl.paths.kernels import factored, solved


@pytest.mark.parametrize(("count", "n"), [(1, 3), (2, 1), (5, 3), (12, 7)])
def test_it_solves_what_the_whole_matrix_solves(rng, count, n):
    factor = rng.normal(size=(count, n, n))
    blocks = factor @ factor.transpose(0, 2, 1) + 8 * np.eye(n)
    beside = rng.normal(size=(count - 1, n, n))
    whole = np.zeros((count * n, count * n))
    for k in range(count):
        whole[k * n : (k + 1) * n, k * n : (k + 1) * n] = blocks[k]
    for k in range(count - 1):
        whole[k * n : (k + 1) * n, (k + 1) * n : (k + 2) * n] = beside[k]
        whole[(k + 1) * n : (k + 2) * n, k * n : (k + 1) * n] = beside[k].T
    whole += max(0.0, 1.0 - np.linalg.eigvalsh(whole).min()) * np.eye(count * n)
    blocks = np.array([whole[k * n : (k + 1) * n, k * n : (k + 1) * n] for k in range(count)])
    right = rng.normal(size=count * n)
    np.testing.assert_allclose(
        solved(factored(blocks, beside), right), np.linalg.solve(whole, right), atol=1e-10
    )
