"""Random motions of robots, which several tests prove."""

import numpy as np


def kept_within_limits(robot, q):
    """Return configurations (…, n) with what is outside the limits moved to them; continuous joints have none."""
    return np.where(robot.continuous, q, np.clip(q, robot.lower, robot.upper))


def random_path(robot, seed, edges, length):
    """Return way points within the limits, about `length` [rad or m] apart where the limits leave the room."""
    rng = np.random.default_rng(seed)
    path = [rng.uniform(robot.lower, robot.upper)]
    for _ in range(edges):
        step = length * rng.normal(size=robot.n) / np.sqrt(robot.n)
        path.append(kept_within_limits(robot, path[-1] + step))
    return np.array(path)


def random_edge(robot, seed, length):
    """Return two configurations, as `random_path` has them."""
    return tuple(random_path(robot, seed, 1, length))
