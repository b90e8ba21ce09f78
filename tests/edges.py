"""Random motions of robots, which several tests prove."""

import numpy as np


def kept_within_limits(robot, q):
    """Return configurations (…, n) with what is outside the limits moved to them; continuous joints have none."""
    return np.where(robot.continuous, q, np.clip(q, robot.lower, robot.upper))


def random_edge(robot, seed, length):
    """Return two configurations within the limits, about `length` [rad or m] apart where the limits leave the room."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(robot.lower, robot.upper)
    step = length * rng.normal(size=robot.n) / np.sqrt(robot.n)
    return start, kept_within_limits(robot, start + step)
