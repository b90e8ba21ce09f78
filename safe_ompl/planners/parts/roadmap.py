"""A roadmap: milestones, how far they lie apart, all that was ever learnt about them; and a search on it."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from safe_ompl.arrays import BoolArray, FloatArray, IntArray
from safe_ompl.plugins.objective import StateCost
from safe_ompl.plugins.states import StateBridge
from safe_ompl.robot.robot import Robot

ROOT = -1

_WORST_COST = 1e100  # stands for infinity and NaN: such milestones come last, but they come


class Metric(Protocol):
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
        return _squares(places - place)


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


class Roadmap:
    """Milestones as rows of one array, with the verdicts on them and on the edges between them.

    Costs are evaluated when they are first asked for, all new ones in one batch. Whether a milestone is valid and an
    edge free is for the planner to find out, once, and to note here.

    Parameters
    ----------
    bridge : StateBridge
        The space.
    cost : StateCost
        Cost of configurations.
    metric : Metric
        Which milestones count as near.

    Attributes
    ----------
    configurations : ndarray, shape (N, n)
        The milestones.
    valid, invalid : ndarray of bool, shape (N,)
        Which of them were found valid, and invalid; of the others nothing is known yet.
    connected : ndarray of bool, shape (N,)
        Which of them were ever reached from a start or goal.
    edges : dict of (int, int) to bool
        Whether the straight motion from one milestone to another is free.
    detours : dict of tuple to list of ndarray
        Way points between two milestones, under a key that names them first.
    """

    def __init__(self, bridge: StateBridge, cost: StateCost, metric: Metric) -> None:
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
        self.detours: dict[tuple[int, int, float, float], list[FloatArray]] = {}

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

    def lengths(self, q: FloatArray) -> FloatArray:
        """Return the lengths (N,) of the straight motions between every milestone and `q: (n,)` [rad or m]."""
        return np.sqrt(_squares(self._bridge.difference(self.configurations, q)))

    def costs(self, milestones: IntArray) -> FloatArray:
        """Return the costs (M,) of `milestones: (M,)`."""
        new = np.unique(milestones[np.isnan(self._costs[milestones])])
        if len(new):
            self._costs[new] = np.fmin(self._cost.values(self.configurations[new]), _WORST_COST)
        return self._costs[milestones]

    def verdict(self, start: int, end: int) -> bool | None:
        """Return whether the edge is free; where only the way back was looked at, whether that is; else None."""
        return self.edges.get((start, end), self.edges.get((end, start)))


class Graph:
    """One of the two graphs of a search on a roadmap: its lists Closed and Open, and the tree of parents.

    Open holds offers: a milestone, the parent that offers an edge to it, and the length g of the way to it through
    that parent. A milestone may have several.

    Parameters
    ----------
    size : int
        Number of milestones N.
    roots : list of int
        The starts, or the goals.
    from_start : bool
        Whether the roots are the starts: then edges are driven away from them, else towards them.

    Attributes
    ----------
    closed : ndarray of bool, shape (N,)
        Which milestones are in Closed.
    milestones, parents : ndarray of int, shape (M,)
        The offers in Open.
    g : ndarray, shape (M,)
        Their lengths [rad or m].
    """

    def __init__(self, size: int, roots: list[int], *, from_start: bool) -> None:
        self.from_start = from_start
        self.closed: BoolArray = np.zeros(size, dtype=bool)
        self._parent: IntArray = np.full(size, ROOT)
        self._length: FloatArray = np.zeros(size)
        self.milestones: IntArray = np.array(roots, dtype=np.intp)
        self.parents: IntArray = np.full(len(roots), ROOT)
        self.g: FloatArray = np.zeros(len(roots))

    def add_open(self, milestones: IntArray, parent: int, lengths: FloatArray) -> None:
        """ADD (Open): offer edges of the given lengths from `parent`, which is in Closed."""
        self.milestones = np.concatenate([self.milestones, milestones])
        self.parents = np.concatenate([self.parents, np.full(len(milestones), parent)])
        self.g = np.concatenate([self.g, self._length[parent] + lengths])

    def add_closed(self, offer: int) -> int:
        """ADD (Closed): take an offer of Open and return its milestone."""
        milestone = int(self.milestones[offer])
        self.closed[milestone] = True
        self._parent[milestone] = self.parents[offer]
        self._length[milestone] = self.g[offer]
        return milestone

    def remove_open(self, offers: list[int]) -> None:
        """REMOVE (Open): drop offers, and all others of milestones that are in Closed."""
        keep = ~self.closed[self.milestones]
        keep[offers] = False
        self.milestones, self.parents, self.g = self.milestones[keep], self.parents[keep], self.g[keep]

    def branch(self, milestone: int) -> list[int]:
        """Return the milestones from the root to `milestone`."""
        branch = []
        while milestone != ROOT:
            branch.append(milestone)
            milestone = int(self._parent[milestone])
        return branch[::-1]


def _squares(rows: FloatArray) -> FloatArray:
    """Return the squared norms (N,) of `rows: (N, E)`."""
    squares: FloatArray = np.einsum("ij,ij->i", rows, rows)
    return squares
