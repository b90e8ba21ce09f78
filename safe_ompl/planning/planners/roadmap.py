"""A roadmap: milestones, and what is known of them and their edges; and the graphs of a search on it."""

from __future__ import annotations

from itertools import pairwise, takewhile
from math import inf

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.planning.planners.growth import ROOT, branch
from safe_ompl.planning.planners.problem import PlanningProblem
from safe_ompl.planning.planners.tree import PlannerGraph, nearest_row
from safe_ompl.robot import StateBridge

# This cost replaces infinity and NaN. Such milestones come last.
_WORST_COST = 1e100


class Roadmap:
    """Milestones as rows of one array, with the verdicts on them and on the edges between them.

    No motion is checked twice. `valid`, `invalid`: (N,) say which milestones were found so, `connected: (N,)` which
    were ever reached from a start or goal, and `edges` which straight motions from one to another are free.
    """

    def __init__(self, problem: PlanningProblem) -> None:
        self._problem, self._robot = problem, problem.robot
        self.configurations: FloatArray = np.empty((0, problem.bridge.n))
        self._places: FloatArray = self._placed(self.configurations)
        self._costs: FloatArray = np.empty(0)
        self._priced = 0
        self.valid: BoolArray = np.empty(0, dtype=bool)
        self.invalid, self.connected = self.valid.copy(), self.valid.copy()
        self.edges: dict[tuple[int, int], bool] = {}
        self._margins: dict[tuple[int, int], tuple[float, float]] = {}
        self.starts: list[int] = []
        self.goals: list[int] = []

    def __len__(self) -> int:
        return len(self.configurations)

    def add(self, Q: FloatArray) -> None:
        """Append milestones `Q: (B, n)`."""
        unknown = np.zeros(len(Q), dtype=bool)
        self.configurations = np.concatenate([self.configurations, Q])
        self._places = np.concatenate([self._places, self._placed(Q)])
        self._costs = np.concatenate([self._costs, np.full(len(Q), np.nan)])
        self.valid = np.concatenate([self.valid, unknown])
        self.invalid = np.concatenate([self.invalid, unknown])
        self.connected = np.concatenate([self.connected, unknown])

    def _placed(self, Q: FloatArray) -> FloatArray:
        """Return the key points in a row (B, 3K) [m] for `Q: (B, n)`, or Q itself without a robot."""
        if self._robot is None:
            return Q
        points = self._robot.keypoints_batch(Q)
        return points.reshape(len(Q), 3 * points.shape[1])

    def nearest(self, milestone: int, excluded: BoolArray) -> IntArray:
        """Return the milestones that are neither invalid nor among `excluded: (N,)`, those nearest by D first.

        That is the paper's metric (11), how far the distal ends p_i of the links lie apart:

            D(q1, q2) = Σ_i ‖p_i(q1) − p_i(q2)‖²  [m²]

        The smaller it is, the less the robot sweeps between the two, and the likelier the straight motion is free.
        Without a robot it is that of the coordinates.
        """
        ways = self.ways_to(milestone) if self._robot is None else self._places - self._places[milestone]
        distances = squares(ways)
        left = np.flatnonzero(~(excluded | self.invalid))
        return left[np.argsort(distances[left], kind="stable")]

    def ways_to(self, milestone: int) -> FloatArray:
        """Return the straight motions (N, n) [rad or m] between every milestone and one of them."""
        return self._problem.bridge.difference(self.configurations, self.configurations[milestone])

    def costs(self, milestones: IntArray) -> FloatArray:
        """Return the costs (M,) of `milestones: (M,)`."""
        # Computing all at once costs little more than computing one.
        if self._priced < len(self):
            new = self.configurations[self._priced :]
            self._costs[self._priced :] = np.fmin(self._problem.cost.values(new), _WORST_COST)
            self._priced = len(self)
        return self._costs[milestones]

    # ------------------------------------------------------------------------------------------------ verdicts

    def is_valid(self, milestone: int) -> bool:
        """Return whether a milestone is valid."""
        if not (self.valid[milestone] or self.invalid[milestone]):
            is_valid = self._problem.is_valid(self.configurations[milestone])
            (self.valid if is_valid else self.invalid)[milestone] = True
        return bool(self.valid[milestone])

    def is_free(self, start: int, end: int, margin: float = 0.0) -> bool:
        """Return whether the edge from one milestone to another is free, or that back, and keeps a margin [m]."""
        verdict = self.edges.get((start, end), self.edges.get((end, start)))
        if not margin or verdict is False:
            return self.check(start, end) if verdict is None else verdict
        kept, refused = self.margins_of(start, end)
        if kept < margin < refused:
            # An edge that did not keep a larger margin is more often blocked than narrow.
            if refused < inf and verdict is None and not self.check(start, end):
                return False
            if self._problem.motion_is_free(self.configurations[start], self.configurations[end], margin):
                kept = margin
                self.edges[start, end] = True
            else:
                refused = margin
            self._margins[min(start, end), max(start, end)] = kept, refused
        return margin <= kept

    def margins_of(self, start: int, end: int) -> tuple[float, float]:
        """Return the largest margin [m] that an edge was proven to keep, and the smallest that it was not."""
        return self._margins.get((min(start, end), max(start, end)), (0.0, inf))

    def check(self, start: int, end: int) -> bool:
        """Return whether the edge from one milestone to another is free; ask where only the way back is known."""
        if (start, end) not in self.edges:
            ends = self.configurations[start], self.configurations[end]
            self.edges[start, end] = self._problem.motion_is_free(*ends)
        return self.edges[start, end]

    # ---------------------------------------------------------------------------------------- starts and goals

    def add_start(self, q: FloatArray) -> None:
        """Take a valid start configuration (n,)."""
        self.starts.append(self._milestone_at(q))

    def add_goal(self, q: FloatArray) -> None:
        """Take a valid goal configuration (n,)."""
        self.goals.append(self._milestone_at(q))

    def _milestone_at(self, q: FloatArray) -> int:
        """Return the milestone at a valid configuration `q: (n,)`; append it if there is none."""
        known = np.flatnonzero((self.configurations == q).all(axis=1))
        if not len(known):
            self.add(q[None])
        milestone = int(known[0]) if len(known) else len(self) - 1
        self.valid[milestone] = True
        return milestone

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

    def approach(self, bridge: StateBridge) -> FloatArray:
        """Return a free path (N, n) from a start to the milestone in its reach that is nearest to a goal."""
        neighbors: dict[int, list[int]] = {}
        for (first, second), is_free in self.edges.items():
            if is_free:
                neighbors.setdefault(first, []).append(second)
                neighbors.setdefault(second, []).append(first)
        parents, reached = dict.fromkeys(self.starts, ROOT), list(self.starts)
        for milestone in reached:  # which grows meanwhile
            new = [other for other in neighbors.get(milestone, ()) if other not in parents]
            parents.update(dict.fromkeys(new, milestone))
            reached += new
        path = branch(
            parents, reached[nearest_row(bridge, self.configurations[reached], self.configurations[self.goals])]
        )
        free = takewhile(lambda edge: self.check(*edge), pairwise(path))  # as it is driven
        return np.asarray(self.configurations[[path[0], *(end for _, end in free)]])

    def graph(self) -> PlannerGraph:
        """Return what was ever reached."""
        kept = np.unique(np.concatenate([np.flatnonzero(self.connected), self.starts, self.goals])).astype(np.intp)
        free = [edge for edge, is_free in self.edges.items() if is_free]
        edges = np.array(free, dtype=np.intp).reshape(-1, 2)
        edges = edges[np.isin(edges, kept).all(axis=1)]
        starts, goals = (np.searchsorted(kept, np.unique(ends)) for ends in (self.starts, self.goals))
        return PlannerGraph(self.configurations[kept], np.searchsorted(kept, edges), starts, goals)


def squares(rows: FloatArray) -> FloatArray:
    """Return the squared norms (N,) of `rows: (N, E)`."""
    return np.asarray(np.einsum("ij,ij->i", rows, rows))


class SearchGraph:
    """One of the two graphs of a search on a roadmap: its lists Closed and Open, and the tree of parents.

    Open holds offers: a milestone, the parent that offers an edge to it, the length g of the way to it through that
    parent, and how often it was penalised. A milestone may have several.
    """

    def __init__(self, size: int, roots: list[int], *, from_start: bool) -> None:
        self.from_start = from_start
        self.closed: BoolArray = np.zeros(size, dtype=bool)
        self._parent: IntArray = np.full(size, ROOT)
        self._length: FloatArray = np.zeros(size)
        self.milestones: IntArray = np.array(roots, dtype=np.intp)
        self.parents: IntArray = np.full(len(roots), ROOT)
        self.g: FloatArray = np.zeros(len(roots))
        self.penalties: IntArray = np.zeros(len(roots), dtype=np.intp)

    def add_open(self, milestones: IntArray, parent: int, lengths: FloatArray) -> None:
        """ADD (Open): offer edges of the given lengths from `parent`, which is in Closed."""
        self.milestones = np.concatenate([self.milestones, milestones])
        self.parents = np.concatenate([self.parents, np.full(len(milestones), parent)])
        self.g = np.concatenate([self.g, self._length[parent] + lengths])
        self.penalties = np.concatenate([self.penalties, np.zeros(len(milestones), dtype=np.intp)])

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
        self.milestones, self.parents = self.milestones[keep], self.parents[keep]
        self.g, self.penalties = self.g[keep], self.penalties[keep]

    def as_driven(self, parent: int, milestone: int) -> tuple[int, int]:
        """Return the ends of an edge in the order in which a path drives them."""
        return (parent, milestone) if self.from_start else (milestone, parent)

    def joined(self, other: SearchGraph, met: int) -> list[int]:
        """Return the milestones from start to goal through the one where this graph meets the other."""
        graph, other = (self, other) if self.from_start else (other, self)
        return branch(graph._parent, met) + branch(other._parent, met)[-2::-1]
