"""A roadmap: milestones, the metric by which they count as near, and the verdicts on them and their edges."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.planning.ompl import CollisionFreeValidity, StateBridge, StateCost
from safe_ompl.robot import Robot

_WORST_COST = 1e100  # stands for infinity and NaN: such milestones come last, but they come


class Roadmap:
    """Milestones as rows of one array, with the verdicts on them and on the edges between them.

    Costs are evaluated when they are first asked for, all new ones in one batch. The planner finds out once whether a
    milestone is valid and an edge free, and notes it here.

    Parameters
    ----------
    bridge : StateBridge
        The space.
    cost : StateCost
        Cost of configurations.
    metric : RoadmapMetric
        Which milestones count as near.

    Attributes
    ----------
    configurations : ndarray, shape (N, n)
        The milestones.
    valid, invalid : ndarray of bool, shape (N,)
        Which of them were found valid, and invalid; the others were not checked yet.
    connected : ndarray of bool, shape (N,)
        Which of them were ever reached from a start or goal.
    edges : dict of (int, int) to bool
        Whether the straight motion from one milestone to another is free.
    detours : dict of tuple to list of ndarray
        Way points between two milestones, under a key that names them first.
    starts, goals : list of int
        The milestones that are starts, and goals.
    """

    def __init__(self, bridge: StateBridge, cost: StateCost, metric: RoadmapMetric) -> None:
        self._bridge = bridge
        self._cost = cost
        self._metric = metric
        self.configurations: FloatArray = np.empty((0, bridge.n))
        self._places: FloatArray = metric.places(self.configurations)
        self._costs: FloatArray = np.empty(0)
        self.valid: BoolArray = np.empty(0, dtype=bool)
        self.invalid = self.valid.copy()
        self.connected = self.valid.copy()
        self.edges: dict[tuple[int, int], bool] = {}
        self._margins: dict[tuple[int, int], tuple[float, float]] = {}
        self.detours: dict[tuple[int, int, float, float, float], list[FloatArray]] = {}
        self.starts: list[int] = []
        self.goals: list[int] = []

    def __len__(self) -> int:
        return len(self.configurations)

    def add(self, Q: FloatArray) -> None:
        """Append milestones `Q: (B, n)`."""
        unknown = np.zeros(len(Q), dtype=bool)
        self.configurations = np.concatenate([self.configurations, Q])
        self._places = np.concatenate([self._places, self._metric.places(Q)])
        self._costs = np.concatenate([self._costs, np.full(len(Q), np.nan)])
        self.valid = np.concatenate([self.valid, unknown])
        self.invalid = np.concatenate([self.invalid, unknown])
        self.connected = np.concatenate([self.connected, unknown])

    def milestone_at(self, q: FloatArray) -> int:
        """Return the milestone at a valid configuration `q: (n,)`; append it if there is none."""
        known = np.flatnonzero((self.configurations == q).all(axis=1))
        if not len(known):
            self.add(q[None])
        milestone = int(known[0]) if len(known) else len(self) - 1
        self.valid[milestone] = True
        return milestone

    def nearest(self, milestone: int, excluded: BoolArray) -> IntArray:
        """Return the milestones that are neither invalid nor among `excluded: (N,)`, those nearest by D first."""
        distances = self._metric.distances(self._places, self._places[milestone])
        left = np.flatnonzero(~(excluded | self.invalid))
        order: IntArray = left[np.argsort(distances[left], kind="stable")]
        return order

    def lengths(self, q: FloatArray, *, taxicab: bool = False) -> FloatArray:
        """Return the lengths (N,) of the straight motions between every milestone and `q: (n,)` [rad or m].

        In the 2-norm, or `taxicab` in the 1-norm.
        """
        deltas = self._bridge.difference(self.configurations, q)
        if not taxicab:
            return np.sqrt(squares(deltas))
        lengths: FloatArray = np.abs(deltas).sum(axis=1)
        return lengths

    def costs(self, milestones: IntArray) -> FloatArray:
        """Return the costs (M,) of `milestones: (M,)`."""
        new = np.unique(milestones[np.isnan(self._costs[milestones])])
        if len(new):
            self._costs[new] = np.fmin(self._cost.values(self.configurations[new]), _WORST_COST)
        return self._costs[milestones]

    def verdict(self, start: int, end: int) -> bool | None:
        """Return whether the edge is free; if only the way back was checked, whether that is free; else None."""
        return self.edges.get((start, end), self.edges.get((end, start)))

    def margins_of(self, start: int, end: int) -> tuple[float, float]:
        """Return the largest margin [m] that an edge was proven to keep, and the smallest that it was not."""
        return self._margins.get((min(start, end), max(start, end)), (0.0, np.inf))

    def note_margins(self, start: int, end: int, kept: float, refused: float) -> None:
        """Note what `margins_of` returns."""
        self._margins[min(start, end), max(start, end)] = kept, refused

    # ------------------------------------------------------------------------------------ starts and goals

    def add_start(self, q: FloatArray) -> None:
        """Take a valid start configuration (n,)."""
        self.starts.append(self.milestone_at(q))

    def add_goal(self, q: FloatArray) -> None:
        """Take a valid goal configuration (n,)."""
        self.goals.append(self.milestone_at(q))

    def forget_ends(self) -> None:
        """Forget which milestones are starts and goals."""
        self.starts.clear()
        self.goals.clear()

    @property
    def has_starts(self) -> bool:
        """Whether there is a start."""
        return bool(self.starts)

    @property
    def has_goals(self) -> bool:
        """Whether there is a goal."""
        return bool(self.goals)

    def graph(self) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
        """Return what was ever reached: vertices (N, n), free edges (E, 2), and which vertices are starts and goals."""
        kept = np.unique(np.concatenate([np.flatnonzero(self.connected), self.starts, self.goals]))
        kept = kept.astype(np.intp)
        free = [edge for edge, is_free in self.edges.items() if is_free]
        edges = np.array(free, dtype=np.intp).reshape(-1, 2)
        edges = edges[np.isin(edges, kept).all(axis=1)]
        starts, goals = (np.searchsorted(kept, np.unique(ends)) for ends in (self.starts, self.goals))
        return self.configurations[kept], np.searchsorted(kept, edges), starts, goals


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


def roadmap_metric(si: Any, bridge: StateBridge) -> RoadmapMetric:
    """Return the paper's metric where the validity checker knows the robot, else that of the space."""
    validity = si.getStateValidityChecker()
    if isinstance(validity, CollisionFreeValidity):
        return LinkMetric(validity.checker.robot)
    return SpaceMetric(bridge)


def squares(rows: FloatArray) -> FloatArray:
    """Return the squared norms (N,) of `rows: (N, E)`."""
    norms: FloatArray = np.einsum("ij,ij->i", rows, rows)
    return norms
