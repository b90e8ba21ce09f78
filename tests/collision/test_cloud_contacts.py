"""A checker with a large cloud never misses what balls, one by one, would touch."""

from __future__ import annotations

import numpy as np
import pytest

from safe_ompl import Obstacle, PointCloud, Scene, certificate, verify

RADIUS = 0.02


@pytest.fixture(scope="module")
def scan() -> np.ndarray:
    """Return a patch of a wall and of a table, as a camera sees them."""
    rng = np.random.default_rng(2)
    wall = np.column_stack(
        [rng.normal(0.55, 0.002, 120), rng.uniform(-0.4, 0.4, 120), rng.uniform(0.2, 0.8, 120)]
    )
    table = np.column_stack(
        [rng.uniform(0.2, 0.8, 120), rng.uniform(-0.4, 0.4, 120), rng.normal(0.1, 0.002, 120)]
    )
    return np.concatenate([wall, table])


def test_a_certificate_beside_a_large_cloud_verifies(panda, scan) -> None:
    scene = Scene((Obstacle("scan", PointCloud(RADIUS, points=np.tile(scan, (20, 1)))),))
    path = [[-1.8, -0.9, 0.0, -2.4, 0.0, 1.8, 0.8], [-2.4, -0.7, 0.1, -2.2, 0.1, 1.9, 0.6]]
    assert verify(certificate(path, panda, scene), panda, scene).edges == 1
