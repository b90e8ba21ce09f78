"""Solids that are cells of a grid, and the trees in which kernels find those that are near."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.geometry.convex import NODE, Records

# The relative rounding of single precision, in which coal keeps its trees.
SINGLE_ROUNDING = 1.2e-7


@dataclass(frozen=True, eq=False, repr=False)
class Voxels:
    """A solid of C ≥ 1 different cells of a grid, `numbers: (C, 3)`; cell k is from k·edge to (k + 1)·edge [m].

    Eight cells of a level are one of the next, and so on up to one that has all.
    """

    numbers: IntArray
    edge: float

    @cached_property
    def tree(self) -> Records:
        """The cells of all levels that have any, of type `NODE`; made when first asked for.

        They are in Morton's order: the bits of their numbers along the axes take turns.
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
        # A cell comes before the cells in it.
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
        """Half the side of a cell of each level (L,) [m], and what the rounding may add."""
        return self.edge * 2.0 ** np.arange(-1.0, self._depth) + self.rounding

    @property
    def rounding(self) -> float:
        """How far from where it should be coal has a face of a cell [m], at most."""
        return SINGLE_ROUNDING * self.edge * (1.0 + float(np.abs(self.numbers).max()))

    @cached_property
    def _depth(self) -> int:
        return int(np.ptp(self.numbers, axis=0).max()).bit_length()
