"""A UR5 whose way from start to goal is barred by a dangerous ball."""

from itertools import pairwise

import numpy as np

from safe_ompl import Box, Obstacle, Pose, SafeSetup, Scene, Sphere

START = np.array([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
GOAL = START * [-1, 1, 1, 1, 1, 1]
IN_BALL = START * [0, 1, 1, 1, 1, 1]
BALL = Scene((Obstacle("ball", Sphere(0.15), Pose((0.45, 0.1, 0.55)), weight=1.0),))
SCENE = BALL.with_obstacles(Obstacle("shelf", Box((0.3, 0.6, 0.02)), Pose((0.5, 0.0, 0.1))))


def setup_for(robot, scene=BALL, **options):
    """Return a setup with start and goal."""
    setup = SafeSetup(robot, scene, **options)
    setup.setConfigurations(START, GOAL)
    return setup


def never():
    """Stop nothing."""
    return False


def densely(robot, path, number=200):
    """Return configurations of a path, `number` on each edge."""
    t = np.linspace(0, 1, number)[:, None]
    return np.concatenate([a + t * robot.difference(a, b) for a, b in pairwise(path)])
