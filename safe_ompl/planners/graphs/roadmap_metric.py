"""Metrics by which milestones count as near."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.plugins.states import StateBridge
from safe_ompl.robot.robot import Robot


class RoadmapMetric(Protocol):
    """A distance D between configurations, measured between places that are computed once for each of them."""

    def places(self, Q: FloatArray) -> FloatArray:
        """Return the places (B, E) of configurations `Q: (B, n)`."""
        ...

    def distances(self, places: FloatArray, place: FloatArray) -> FloatArray:
        """Return D (N,) from each of `places: (N, E)` to `place: (E,)`."""
        ...


class LinkMetric:
    """The paper's metric (11): how far the ends of the links lie apart.

        D(q1, q2) = Σ_i ‖p_i(q1) − p_i(q2)‖²  [m²]

    with p_i the distal end of link i. The smaller it is, the less the robot sweeps between the two, and the likelier
    the straight motion is free. The place of a configuration is the row of its key points, (3K,).

    Parameters
    ----------
    robot : Robot
        Gives the key points.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    def places(self, Q: FloatArray) -> FloatArray:
        """Return the key points in a row (B, 3K) [m] for `Q: (B, n)`."""
        points = self._robot.keypoints_batch(Q)
        return points.reshape(len(Q), 3 * points.shape[1])

    def distances(self, places: FloatArray, place: FloatArray) -> FloatArray:
        """Return D (N,) [m²] from each of `places: (N, 3K)` to `place: (3K,)`."""
        return squares(places - place)


class SpaceMetric:
    """The metric where there is no robot model: the space's own distance.

    Parameters
    ----------
    bridge : StateBridge
        The space.
    """

    def __init__(self, bridge: StateBridge) -> None:
        self._bridge = bridge

    def places(self, Q: FloatArray) -> FloatArray:
        """Return `Q: (B, n)` as it is."""
        return Q

    def distances(self, places: FloatArray, place: FloatArray) -> FloatArray:
        """Return D (N,) from each of `places: (N, n)` to `place: (n,)`."""
        return self._bridge.distances(places, place)


def squares(rows: FloatArray) -> FloatArray:
    """Return the squared norms (N,) of `rows: (N, E)`."""
    norms: FloatArray = np.einsum("ij,ij->i", rows, rows)
    return norms
