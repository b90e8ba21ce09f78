"""Solids of grid cells, with trees in which compiled code finds the cells near a body."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.geometry.convex import NODE, Records

# Relative rounding of single precision, in which coal stores its trees.
SINGLE_ROUNDING = 1.2e-7


@dataclass(frozen=True, eq=False, repr=False)
class Voxels:
    """A solid of C ≥ 1 distinct grid cells `numbers: (C, 3)`; cell k covers [k·edge, (k + 1)·edge] along each axis [m].

    Eight cells of a level form one cell of the next level, up to a root that contains all cells.
    """

    numbers: IntArray
    edge: float

    @cached_property
    def tree(self) -> Records:
        """The octree of the occupied cells of all levels, of type `NODE`, in Morton order.

        A Morton code interleaves the bits of the cell numbers along the axes.
        """
        low, depth = self.numbers.min(axis=0), self._depth
        axes: IntArray = np.array((self.numbers - low).T, order="C")
        codes: IntArray = np.zeros(len(self.numbers), np.intp)
        for place in range(3 * depth):
            codes |= (axes[place % 3] >> place // 3 & 1) << place
        order = np.argsort(codes)
        codes, corners = codes[order], axes.T[order]
        firsts = [np.flatnonzero(np.diff(codes >> 3 * level, prepend=-1)) for level in range(depth + 1)]
        first, level = np.concatenate(firsts), np.repeat(np.arange(depth + 1), list(map(len, firsts)))
        # A cell precedes the cells that it contains.
        order = np.lexsort((-level, first))
        first, level = first[order], level[order]
        begins = codes[first] >> 3 * level << 3 * level
        nodes = np.zeros(len(order), NODE)
        nodes["level"] = level
        nodes["size"] = np.searchsorted(begins, begins + (1 << 3 * level)) - np.arange(len(nodes))
        corners = corners[first] >> level[:, None] << level[:, None]
        nodes["centre"] = (low + corners + 2.0 ** (level[:, None] - 1)) * self.edge
        return nodes

    @property
    def half_sides(self) -> FloatArray:
        """Half the side of the cells of each level (L,) [m], enlarged by the rounding."""
        return self.edge * 2.0 ** np.arange(-1.0, self._depth) + self.rounding

    @property
    def rounding(self) -> float:
        """Bound on the error of a cell's face in coal's tree [m]."""
        return SINGLE_ROUNDING * self.edge * (1.0 + float(np.abs(self.numbers).max()))

    @cached_property
    def _depth(self) -> int:
        return int(np.ptp(self.numbers, axis=0).max()).bit_length()
