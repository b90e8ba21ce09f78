"""The search on a roadmap: its two graphs, the lazy local planner, and the samples."""

from __future__ import annotations

from itertools import pairwise
from math import inf

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.planning.ompl import StateBridge
from safe_ompl.planning.planners.graphs.roadmap import Roadmap
from safe_ompl.planning.planners.parts.problem import PlanningProblem
from safe_ompl.planning.planners.parts.tree import ROOT

_GROWTH = 0.25  # by this share of itself the sample set grows when it does not suffice …
_LARGEST_GROWTH = 500  # … but by no more milestones at a time, …
_TOWARDS_SHARE = 0.8  # … of which this share grows out of the graph that is stuck, …
_NEAREST_TO_GRAPH = 0.05  # … from this fraction of the way to a random configuration on.
_LARGEST_FRINGE = 1000  # milestones of a stuck graph from which samples are drawn


class SearchGraph:
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
        Their lengths [rad or m], penalties included.
    penalties : ndarray of int, shape (M,)
        How often they were penalised for coming near to obstacles.
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
        branch = []
        while milestone != ROOT:
            branch.append(milestone)
            milestone = int(self._parent[milestone])
        return branch[::-1]


def joined_branches(graph: SearchGraph, other: SearchGraph, met: int) -> list[int]:
    """Return the milestones from start to goal through the one where two graphs meet."""
    if not graph.from_start:
        graph, other = other, graph
    return graph.branch(met) + other.branch(met)[-2::-1]


class LocalPlanner:
    """Connects milestones by straight motions; it notes every verdict in the roadmap, and does not ask again.

    Parameters
    ----------
    problem : PlanningProblem
        Says what is valid and free.
    roadmap : Roadmap
        The milestones.
    """

    def __init__(self, problem: PlanningProblem, roadmap: Roadmap) -> None:
        self._problem = problem
        self._roadmap = roadmap

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
    """Draws the milestones of a roadmap.

    Parameters
    ----------
    bridge : StateBridge
        The space.
    """

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
