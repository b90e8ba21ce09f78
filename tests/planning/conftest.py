"""The scene of setups that are like any other."""

import pytest

from safe_ompl import Box, Obstacle, Pose, Scene, Sphere


@pytest.fixture(scope="module")
def scene():
    return Scene(
        (
            Obstacle("ball", Sphere(0.15), Pose((0.45, 0.1, 0.55)), weight=1.0),
            Obstacle("shelf", Box((0.3, 0.6, 0.02)), Pose((0.5, 0.0, 0.1))),
        )
    )
