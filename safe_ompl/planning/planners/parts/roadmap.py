"""A roadmap: milestones, the metric by which they count as near, and the verdicts on them and their edges."""

from __future__ import annotations

from itertools import pairwise
from math import inf
from typing import Any

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.planning.ompl import CollisionFreeValidity, StateBridge, StateCost
from safe_ompl.planning.planners.parts.problem import PlanningProblem
from safe_ompl.planning.planners.parts.tree import ROOT, Graph, branch
from safe_ompl.robot import Robot

_WORST_COST = 1e100  # stands for infinity and NaN: such milestones come last, but they come


class Roadmap:
    """Milestones as rows of one array, with the verdicts on them and on the edges between them.

    Costs are evaluated when they are first asked for, all new ones in one batch. `valid`, `invalid`: (N,) say which
    milestones were found so, `connected: (N,)` which were ever reached from a start or goal, and `edges` which straight
    motions from one to another are free; `detours` are way points of edges, under a key that names their ends.
    """

    def __init__(self, bridge: StateBridge, cost: StateCost, metric: LinkMetric | SpaceMetric) -> None:
        self._bridge, self._cost, self._metric = bridge, cost, metric
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

    def graph(self) -> Graph:
        """Return what was ever reached: vertices (N, n), free edges (E, 2), and which vertices are starts and goals."""
        kept = np.unique(np.concatenate([np.flatnonzero(self.connected), self.starts, self.goals]))
        kept = kept.astype(np.intp)
        free = [edge for edge, is_free in self.edges.items() if is_free]
        edges = np.array(free, dtype=np.intp).reshape(-1, 2)
        edges = edges[np.isin(edges, kept).all(axis=1)]
        starts, goals = (np.searchsorted(kept, np.unique(ends)) for ends in (self.starts, self.goals))
        return self.configurations[kept], np.searchsorted(kept, edges), starts, goals


class LinkMetric:
    """The paper's metric (11): how far the ends of the links lie apart.

        D(q1, q2) = Σ_i ‖p_i(q1) − p_i(q2)‖²  [m²]

    with p_i the distal end of link i. The smaller it is, the less the robot sweeps between the two, and the likelier
    the straight motion is free. The place of a configuration is the row of its key points, (3K,).
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
    """The metric where there is no robot model: the space's own distance."""

    def __init__(self, bridge: StateBridge) -> None:
        self._bridge = bridge

    def places(self, Q: FloatArray) -> FloatArray:
        """Return `Q: (B, n)` as it is."""
        return Q

    def distances(self, places: FloatArray, place: FloatArray) -> FloatArray:
        """Return D (N,) from each of `places: (N, n)` to `place: (n,)`."""
        return self._bridge.distances(places, place)


def roadmap_metric(si: Any, bridge: StateBridge) -> LinkMetric | SpaceMetric:
    """Return the paper's metric where the validity checker knows the robot, else that of the space."""
    validity = si.getStateValidityChecker()
    if isinstance(validity, CollisionFreeValidity):
        return LinkMetric(validity.checker.robot)
    return SpaceMetric(bridge)


def squares(rows: FloatArray) -> FloatArray:
    """Return the squared norms (N,) of `rows: (N, E)`."""
    norms: FloatArray = np.einsum("ij,ij->i", rows, rows)
    return norms


_GROWTH = 0.25  # by this share of itself the sample set grows when it does not suffice …
_LARGEST_GROWTH = 500  # … but by no more milestones at a time, …
_TOWARDS_SHARE = 0.8  # … of which this share grows out of the graph that is stuck, …
_NEAREST_TO_GRAPH = 0.05  # … from this fraction of the way to a random configuration on.
_LARGEST_FRINGE = 1000  # milestones of a stuck graph from which samples are drawn


class SearchGraph:
    """One of the two graphs of a search on a roadmap: its lists Closed and Open, and the tree of parents.

    Open holds offers: a milestone, the parent that offers an edge to it, and the length g of the way to it through that
    parent, penalties included, with how often it was penalised. A milestone may have several. Where the roots are the
    starts, edges are driven away from them, else towards them. `closed: (N,)` says which milestones are in Closed.
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

    def penalise(self, offer: int, penalty: float) -> None:
        """Add a penalty [rad or m] to the length of an offer in Open."""
        self.g[offer] += penalty
        self.penalties[offer] += 1

    def remove_open(self, offers: list[int]) -> None:
        """REMOVE (Open): drop offers, and all others of milestones that are in Closed."""
        keep = ~self.closed[self.milestones]
        keep[offers] = False
        self.milestones, self.parents = self.milestones[keep], self.parents[keep]
        self.g, self.penalties = self.g[keep], self.penalties[keep]

    def as_driven(self, parent: int, milestone: int) -> tuple[int, int]:
        """Return the ends of an edge in the order in which a path drives them."""
        return (parent, milestone) if self.from_start else (milestone, parent)

    def branch(self, milestone: int) -> list[int]:
        """Return the milestones from the root to `milestone`."""
        return branch(self._parent, milestone)


def joined_branches(graph: SearchGraph, other: SearchGraph, met: int) -> list[int]:
    """Return the milestones from start to goal through the one where two graphs meet."""
    if not graph.from_start:
        graph, other = other, graph
    return graph.branch(met) + other.branch(met)[-2::-1]


class LocalPlanner:
    """Connects milestones by straight motions; it notes every verdict in the roadmap, and does not ask again."""

    def __init__(self, problem: PlanningProblem, roadmap: Roadmap) -> None:
        self._problem, self._roadmap = problem, roadmap

    def is_valid(self, milestone: int) -> bool:
        """Return whether a milestone is valid."""
        roadmap = self._roadmap
        if not (roadmap.valid[milestone] or roadmap.invalid[milestone]):
            is_valid = self._problem.is_valid(roadmap.configurations[milestone])
            (roadmap.valid if is_valid else roadmap.invalid)[milestone] = True
        return bool(roadmap.valid[milestone])

    def is_free(self, start: int, end: int, margin: float = 0.0) -> bool:
        """Return whether the edge from one milestone to another is free, or that back, and keeps a margin [m]."""
        verdict = self._roadmap.verdict(start, end)
        if margin and verdict is not False:
            return self._keeps(start, end, margin)
        return self.check(start, end) if verdict is None else verdict

    def can_be_driven(self, path: list[int]) -> bool:
        """Return whether the edges of a path are free in this direction too, where only the way back was asked for."""
        edges = self._roadmap.edges
        return all(edges[edge] if edge in edges else self.check(*edge) for edge in pairwise(path))

    def check(self, start: int, end: int) -> bool:
        """Ask whether the motion from one milestone to another is free, and note it."""
        configurations = self._roadmap.configurations
        verdict = self._problem.motion_is_free(configurations[start], configurations[end])
        self._roadmap.edges[start, end] = verdict
        return verdict

    def _keeps(self, start: int, end: int, margin: float) -> bool:
        kept, refused = self._roadmap.margins_of(start, end)
        if kept < margin < refused:
            # An edge that did not keep a larger margin is more often blocked than narrow.
            if refused < inf and self._roadmap.verdict(start, end) is None and not self.check(start, end):
                return False
            configurations = self._roadmap.configurations
            if self._problem.motion_is_free(configurations[start], configurations[end], margin):
                kept = margin
                self._roadmap.edges[start, end] = True
            else:
                refused = margin
            self._roadmap.note_margins(start, end, kept, refused)
        return margin <= kept


class Samples:
    """Draws the milestones of a roadmap."""

    def __init__(self, bridge: StateBridge) -> None:
        self._bridge = bridge

    def uniform(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return uniform random configurations (count, n)."""
        return self._bridge.between_bounds(rng.random((count, self._bridge.n)))

    def more(self, size: int, stuck: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return configurations (B, n) to enlarge a sample set of `size` that does not suffice.

        Some are uniform; most lie around the configurations `stuck: (N, n)`, which a search cannot go on from.
        """
        count = min(_LARGEST_GROWTH, 1 + int(_GROWTH * size))
        outwards = round(_TOWARDS_SHARE * count) if len(stuck) else 0
        rows = [self._outwards(stuck, outwards, rng)] if outwards else []
        if count > outwards:
            rows.append(self.uniform(count - outwards, rng))
        return np.concatenate(rows)

    def _outwards(self, fringe: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
        """Return configurations (count, n) between a fringe (N, n) and random ones, from the nearest of it on."""
        if len(fringe) > _LARGEST_FRINGE:
            fringe = fringe[rng.choice(len(fringe), _LARGEST_FRINGE, replace=False)]
        deltas = [self._bridge.difference(fringe, target) for target in self.uniform(count, rng)]
        nearest = [int(np.einsum("ij,ij->i", delta, delta).argmin()) for delta in deltas]
        steps = np.array([delta[k] for delta, k in zip(deltas, nearest, strict=True)])
        fractions = _NEAREST_TO_GRAPH ** rng.random((count, 1))
        return self._bridge.wrapped(fringe[nearest] + fractions * steps)
