"""BUBBLE_PLANNER as printed, and with α = 0 its classical counterpart."""

from __future__ import annotations

from itertools import count, islice
from typing import Any

import numpy as np

from safe_ompl.collision import Bubble
from safe_ompl.common import FloatArray
from safe_ompl.planning.planners.base import SafePlanner
from safe_ompl.planning.planners.graphs.volume_tree import (
    JointMetric,
    VolumeTree,
    VolumeTrees,
    bubble_validity,
    intersect,
)
from safe_ompl.planning.planners.parameters import Parameter


class PaperSafeBubble(SafePlanner):
    """BUBBLE_PLANNER as it is printed in [1], §4.1; with α = 0 `PaperBubble`.

    Bubbles are those of (9); f is that of (10), with joint angles in the 1-norm for g and h. Where the print leaves
    something open it is read so: C is Closed(1); the roots wait in Open and are closed once; d_c counts the robot's own
    pairs, too, or a bubble would not be free; vertices lie 0.99 of the way to the boundary, and within the joint
    limits; of several bubbles that intersect the new one, the path takes the one that it overlaps most. The planner
    is deterministic.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013.
    """

    alpha = Parameter(1.0, "Weight of danger α, as length per danger.")
    beta = Parameter(0.0, "Weight β of the diversity.")
    shape = Parameter(
        "paper", "The paper's diamond (9), or the largest cube in it.", choices=("paper", "paper_cube")
    )
    iterations = Parameter(0, "k_max: how many turns the trees take; 0: until time is up.")

    def _make_parts(self) -> None:
        self._validity = bubble_validity(self.getSpaceInformation(), self.getName())

    def _search(self, ptc: Any) -> FloatArray | None:
        """BUBBLE_PLANNER."""
        tree, other = self._volumes.start, self._volumes.goal
        for _ in islice(count(), self.iterations or None):
            if ptc() or not (len(tree.open) or len(other.open)):
                break
            self._take_goals(ptc)
            path = self._expand(tree, other, other.latest) if len(tree.open) and not ptc() else None
            if path is not None:
                return path
            tree, other = other, tree  # SWAP
        return None

    def _expand(self, tree: VolumeTree, other: VolumeTree, current_goal: FloatArray) -> FloatArray | None:
        """Move argmin of f from Open(1) to Closed(1), and add the end points of its bubble to Open(1)."""
        x = tree.take(int(self._f(tree, current_goal).argmin()))
        bubble = Bubble.around(x.q, self._validity.checker, self.shape)
        if bubble is None:
            return None
        new = tree.close(x, bubble.weights)
        self.counts.nodes += 1
        path = intersect(self._problem, self.shape, tree, new, other)
        if path is None:
            points = self._bubble_endpoints(bubble)
            dangers = self._problem.cost.values(points) if self.alpha else np.zeros(len(points))
            tree.add(points, new, dangers)
        return path

    def _f(self, tree: VolumeTree, current_goal: FloatArray) -> FloatArray:
        """Return f = g + h + α·CDF − β·diversity, eq. (10), for the points in Open(1)."""
        rows = tree.open
        f: FloatArray = self._metric.lengths(rows["q"], current_goal) + rows["path_length"]
        if self.alpha:
            f += self.alpha * rows["cost"]
        if self.beta:
            f -= self.beta * rows["diversity"]
        return f

    def _bubble_endpoints(self, bubble: Bubble) -> FloatArray:
        """BUBBLE_ENDPOINTS: the vertices (K, n)."""
        bridge = self._bridge
        points = bridge.inside(bubble.vertices(bridge.lower, bridge.upper, bridge.circular))
        found: FloatArray = points[self._metric.separations(bubble.q, points) > 1e-9]
        return found

    @property
    def _structure(self) -> VolumeTrees:
        return self._volumes

    def _forget(self) -> None:
        self._metric = JointMetric(self._bridge, np.ones(self._bridge.n), taxicab=True)
        self._volumes = VolumeTrees(self._bridge, self._metric, diverse=self.beta > 0)
