"""The scenes of setups that are like any other."""

import pytest

from safe_ompl import Box, Obstacle, Pose, Scene, Sphere


@pytest.fixture(scope="session")
def ball():
    """Return a dangerous ball between a start and a goal of a UR5."""
    return Scene((Obstacle("ball", Sphere(0.15), Pose((0.45, 0.1, 0.55)), weight=1.0),))


@pytest.fixture(scope="session")
def scene(ball):
    """Return the ball above a shelf."""
    return ball.with_obstacles(Obstacle("shelf", Box((0.3, 0.6, 0.02)), Pose((0.5, 0.0, 0.1))))
