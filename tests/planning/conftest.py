"""The scenes of setups that are like any other."""

import ball as scenes
import pytest


@pytest.fixture(scope="session")
def ball():
    """Return a dangerous ball between a start and a goal of a UR5."""
    return scenes.BALL


@pytest.fixture(scope="session")
def scene():
    """Return the ball above a shelf."""
    return scenes.SCENE
