"""The roadmap of `SafePRM` with the verdicts on milestones and edges, and the graphs of a search on it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice, pairwise, takewhile
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

    No motion is checked twice. `valid` and `invalid` (N,) mark milestones that were checked, and `connected` (N,) those
    that were ever reached from a start or goal. `edges` maps pairs of milestones to whether the edge is free.
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
        """Return the robot's key points (B, 3K) [m] at `Q: (B, n)`, or Q itself without a robot."""
        if self._robot is None:
            return Q
        points = self._robot.keypoints_batch(Q)
        return points.reshape(len(Q), 3 * points.shape[1])

    def nearest(self, milestone: int, excluded: BoolArray) -> IntArray:
        """Return the milestones that are neither invalid nor in the mask `excluded: (N,)`, in the order of D.

        D is the paper's metric (11), with the positions p_i of the distal ends of the links:

            D(q1, q2) = Σ_i ‖p_i(q1) − p_i(q2)‖²  [m²]

        The smaller D is, the less space the robot sweeps, and the more probably the straight motion is free. Without a
        robot D is the squared distance of the coordinates.
        """
        ways = self.ways_to(milestone) if self._robot is None else self._places - self._places[milestone]
        distances = squares(ways)
        left = np.flatnonzero(~(excluded | self.invalid))
        return left[np.argsort(distances[left], kind="stable")]

    def ways_to(self, end: int, milestones: IntArray | slice = slice(None)) -> FloatArray:
        """Return the differences (M, n) [rad or m] from `milestones: (M,)`, by default all of them, to one of them."""
        return self._problem.bridge.difference(self.configurations[milestones], self.configurations[end])

    def costs(self, milestones: IntArray) -> FloatArray:
        """Return the costs (M,) of `milestones: (M,)`."""
        # All new costs are computed in one batch, which takes little more time than one cost.
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
        """Return whether the edge between two milestones is free in one direction and keeps a margin [m]."""
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

    def is_blocked(self, start: int, end: int) -> bool:
        """Return whether the edge between two milestones is known not to be free, in one of the directions."""
        return self.edges.get((start, end), self.edges.get((end, start))) is False

    def margins_of(self, start: int, end: int) -> tuple[float, float]:
        """Return the largest margin [m] that is proven for an edge, and the smallest that could not be proven."""
        return self._margins.get((min(start, end), max(start, end)), (0.0, inf))

    def check(self, start: int, end: int) -> bool:
        """Return whether the edge is free from `start` to `end`; check it if only the other direction is known."""
        if (start, end) not in self.edges:
            ends = self.configurations[start], self.configurations[end]
            self.edges[start, end] = self._problem.motion_is_free(*ends)
        return self.edges[start, end]

    # ---------------------------------------------------------------------------------------- starts and goals

    def add_start(self, q: FloatArray) -> None:
        """Add a valid start configuration (n,)."""
        self.starts.append(self._milestone_at(q))

    def add_goal(self, q: FloatArray) -> None:
        """Add a valid goal configuration (n,)."""
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
        """Clear the lists of starts and goals; their milestones stay."""
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
        """Return a free path (N, n) from a start to the connected milestone that is nearest to a goal."""
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
        """Return all milestones that were ever reached, with the free edges between them."""
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

    Open holds offers. An offer is a milestone, a parent with an edge to it, the length g of the path to it through this
    parent, and its number of penalties. A milestone may have several offers.
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
        # For milestones in Closed, their neighbours that have not been offered yet, the nearest first.
        self.nearest: dict[int, Iterator[int]] = {}

    def add_open(self, milestones: IntArray, parent: int, lengths: FloatArray) -> None:
        """ADD (Open): add offers of edges with these lengths from `parent`, which is in Closed."""
        self.milestones = np.concatenate([self.milestones, milestones])
        self.parents = np.concatenate([self.parents, np.full(len(milestones), parent)])
        self.g = np.concatenate([self.g, self._length[parent] + lengths])
        self.penalties = np.concatenate([self.penalties, np.zeros(len(milestones), dtype=np.intp)])

    def next_neighbors(self, milestone: int, invalid: BoolArray, number: int) -> IntArray:
        """Return up to `number` further neighbours of a milestone that are not `invalid: (N,)` and not in Closed."""
        further = (other for other in self.nearest[milestone] if not (invalid[other] or self.closed[other]))
        return np.fromiter(islice(further, number), dtype=np.intp)

    def add_closed(self, offer: int) -> int:
        """ADD (Closed): move an offer of Open to Closed, and return its milestone."""
        milestone = int(self.milestones[offer])
        self.closed[milestone] = True
        self._parent[milestone] = self.parents[offer]
        self._length[milestone] = self.g[offer]
        return milestone

    def remove_open(self, offers: list[int]) -> None:
        """REMOVE (Open): remove offers, and all offers of milestones in Closed."""
        keep = ~self.closed[self.milestones]
        keep[offers] = False
        self.milestones, self.parents = self.milestones[keep], self.parents[keep]
        self.g, self.penalties = self.g[keep], self.penalties[keep]

    def as_driven(self, parent: int, milestone: int) -> tuple[int, int]:
        """Return the ends of an edge in the direction in which the robot moves."""
        return (parent, milestone) if self.from_start else (milestone, parent)

    def joined(self, other: SearchGraph, met: int) -> list[int]:
        """Return the milestones from start to goal through the milestone `met`, where this graph meets the other."""
        graph, other = (self, other) if self.from_start else (other, self)
        return branch(graph._parent, met) + branch(other._parent, met)[-2::-1]
