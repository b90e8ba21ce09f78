"""The scene of setups that are like any other."""

import pytest

from safe_ompl.geometry.basic import Box, Sphere
from safe_ompl.geometry.obstacle import Obstacle
from safe_ompl.geometry.pose import Pose
from safe_ompl.scene.scene import Scene


@pytest.fixture(scope="module")
def scene():
    return Scene(
        (
            Obstacle("ball", Sphere(0.15), Pose((0.45, 0.1, 0.55)), weight=1.0),
            Obstacle("shelf", Box((0.3, 0.6, 0.02)), Pose((0.5, 0.0, 0.1))),
        )
    )
