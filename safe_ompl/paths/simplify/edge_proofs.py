"""Proofs of the edges of paths; what was proven once is remembered."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from safe_ompl.arrays import BoolArray, FloatArray
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.errors import InputError
from safe_ompl.paths.curve import Curve

_STEP = 0.03  # [rad]
_REACH = 0.5  # [rad] of path on each side of a refused edge are held back at first,
_WIDENINGS = 6  # then twice as much, so many times


class EdgeProofs:
    """Proves that every edge of a path is free, and keeps more than a margin from obstacles.

    Parameters
    ----------
    motion : CertifiedMotion
        Proves that edges are free. What is proven with a margin, it proves too.
    margin : float
        [m] Clearance that every edge must keep.
    """

    def __init__(self, motion: CertifiedMotion, margin: float = 0.0) -> None:
        self._free = motion
        self._clear = motion.with_margin(max(margin, motion.margin))
        self._proven: set[bytes] = set()

    @classmethod
    def of(cls, path: FloatArray, motion: CertifiedMotion, margin: float, *, proven: bool) -> EdgeProofs:
        """Return a proof that accepts the edges of a path (N, n), though these may keep less than the margin [m].

        Raises
        ------
        InputError
            If an edge of the path is not even proven free, and that is not known already (`proven`).
        """
        proof = cls(motion, max(0.0, margin) if np.isfinite(margin) else 0.0)
        if not proof.admit(path, proven):
            edge = proof.refused(path)[0]
            raise InputError(f"path: the edge from way point {edge} on is not proven free")
        return proof

    def accepts(self, start: FloatArray, end: FloatArray) -> bool:
        """Return whether the edge between two configurations (n,) is proven."""
        key = start.tobytes() + end.tobytes()
        proven = key in self._proven or self._clear.is_free(start, end)
        if proven:
            self._proven.add(key)
        return proven

    def admit(self, path: FloatArray, proven: bool = False) -> bool:
        """Take a path (N, n) whose edges are parts of known ones for accepted, if all are proven free."""
        free = proven or all(self._free.is_free(start, end) for start, end in pairwise(path))
        if free:
            self._proven.update(start.tobytes() + end.tobytes() for start, end in pairwise(path))
        return free

    def refused(self, path: FloatArray) -> list[int]:
        """Return the edges of a path (N, n) that are not proven."""
        return [k for k, (start, end) in enumerate(pairwise(path)) if not self.accepts(start, end)]

    def held_back(self, path: FloatArray, known: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return `path: (N, n)`, held back to a known one where edges are refused, and which way points are there (N,).

        Way points beside a refused edge go back to where they were, and those around them in part, so that there is
        no kink; if that does not help, more of them.

        Parameters
        ----------
        path : ndarray, shape (N, n)
            What is wanted.
        known : ndarray, shape (N, n)
            A path that is accepted; where nothing else helps, all way points go back to it.
        """
        refused, reach = self.refused(path), _REACH
        if not refused:
            return path, np.zeros(len(path), dtype=bool)
        lengths = np.linalg.norm(known[1:] - known[:-1], axis=1)
        arc = np.concatenate([[0.0], np.cumsum(lengths)])
        share, held = np.ones(len(path)), path
        for _ in range(_WIDENINGS):
            for k in refused:
                beyond = np.maximum(arc[k] - arc, arc - arc[k + 1])
                share = np.minimum(share, np.maximum(0.0, beyond) / reach)
                share[k : k + 2] = 0.0
            held = np.where(share[:, None] < 1, known + share[:, None] * (path - known), path)
            held[share == 0] = known[share == 0]
            refused = self.refused(held)
            if not refused:
                return held, share == 0
            reach *= 2.0
        return known.copy(), np.ones(len(path), dtype=bool)


def least_clearance(path: FloatArray, checker: CollisionChecker) -> float:
    """Return the least distance [m] between robot and obstacles over closely spaced samples of a path (N, n).

    Distances are asked for only where a boolean query says that they are less than the least so far.
    """
    curve = Curve(checker.robot, path)
    samples = curve.at(np.linspace(0.0, curve.length, 2 + int(curve.length / _STEP)))
    least = min(checker.clearance(q).distance for q in samples[[0, -1]])
    if not 0 < least < np.inf:
        return max(0.0, least)
    pairs = checker.pairs_within(least)
    margins = pairs.margins(least)
    for q in samples:
        if pairs.within_margins(q, margins) and (distance := checker.clearance(q).distance) < least:
            if distance <= 0:
                return 0.0
            least, margins = distance, pairs.margins(distance)
    return least
