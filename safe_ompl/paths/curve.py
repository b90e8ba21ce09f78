"""A path as a curve: configurations by their arc length in joint space."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.robot.robot import Robot


class Curve:
    """A path by its arc length in joint space."""

    def __init__(self, robot: Robot, path: FloatArray) -> None:
        steps = robot.difference(path[:-1], path[1:])
        # Unrolled, so that interpolation does not jump where a continuous joint wraps.
        self._points = path[0] + np.vstack([np.zeros((1, robot.n)), np.cumsum(steps, axis=0)])
        self._arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
        self.length = float(self._arc[-1])

    def at(self, s: FloatArray) -> FloatArray:
        """Return the configurations (S, n) at arc lengths `s: (S,)`."""
        columns = [np.interp(s, self._arc, column) for column in self._points.T]
        return np.stack(columns, axis=1)
