"""One of the two graphs of a search on a roadmap."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import BoolArray, FloatArray, IntArray
from safe_ompl.planners.parts.tree import ROOT


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
        Their lengths [rad or m], tolls included.
    tolls : ndarray of int, shape (M,)
        How many tolls they have paid for coming near to obstacles.
    """

    def __init__(self, size: int, roots: list[int], *, from_start: bool) -> None:
        self.from_start = from_start
        self.closed: BoolArray = np.zeros(size, dtype=bool)
        self._parent: IntArray = np.full(size, ROOT)
        self._length: FloatArray = np.zeros(size)
        self.milestones: IntArray = np.array(roots, dtype=np.intp)
        self.parents: IntArray = np.full(len(roots), ROOT)
        self.g: FloatArray = np.zeros(len(roots))
        self.tolls: IntArray = np.zeros(len(roots), dtype=np.intp)

    def add_open(self, milestones: IntArray, parent: int, lengths: FloatArray) -> None:
        """ADD (Open): offer edges of the given lengths from `parent`, which is in Closed."""
        self.milestones = np.concatenate([self.milestones, milestones])
        self.parents = np.concatenate([self.parents, np.full(len(milestones), parent)])
        self.g = np.concatenate([self.g, self._length[parent] + lengths])
        self.tolls = np.concatenate([self.tolls, np.zeros(len(milestones), dtype=np.intp)])

    def add_closed(self, offer: int) -> int:
        """ADD (Closed): take an offer of Open and return its milestone."""
        milestone = int(self.milestones[offer])
        self.closed[milestone] = True
        self._parent[milestone] = self.parents[offer]
        self._length[milestone] = self.g[offer]
        return milestone

    def charge(self, offer: int, toll: float) -> None:
        """Let an offer of Open wait as if its edge were longer by a toll [rad or m]."""
        self.g[offer] += toll
        self.tolls[offer] += 1

    def remove_open(self, offers: list[int]) -> None:
        """REMOVE (Open): drop offers, and all others of milestones that are in Closed."""
        keep = ~self.closed[self.milestones]
        keep[offers] = False
        self.milestones, self.parents = self.milestones[keep], self.parents[keep]
        self.g, self.tolls = self.g[keep], self.tolls[keep]

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
