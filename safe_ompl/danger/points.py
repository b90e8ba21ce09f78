"""Danger points: weights, charges, and groups of neighbours."""

from __future__ import annotations

from collections.abc import Sized
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import InputError, finite_array
from safe_ompl.danger.kernels.danger import Points
from safe_ompl.danger.kernels.kinetostatic_peak import Groups
from safe_ompl.danger.link_field import columns

_GROUP = 64  # points in a group at most


class DangerPoints:
    """Danger points (M, 3) [m] with weights (M,) > 0, None: 1; k₁ of the field scales their charges. Read-only.

    Raises InputError if points or weights have the wrong shape, are not finite, or weights are not positive.
    """

    def __init__(self, points: ArrayLike, weights: ArrayLike | None, k1: float) -> None:
        if isinstance(points, Sized) and not len(points):
            points = np.zeros((0, 3))
        self.points = finite_array(points, (None, 3), "danger points")
        self.points.setflags(write=False)
        self.weights = None if weights is None else finite_array(weights, (len(self.points),), "danger weights")
        if self.weights is not None:
            if not (self.weights > 0).all():
                bad = self.weights[self.weights <= 0].tolist()
                raise InputError(f"danger weights must be positive, got {bad}; leave out the others")
            self.weights.setflags(write=False)
        charges = k1 * (np.ones(len(self.points)) if self.weights is None else self.weights)
        short = columns(self.points).astype(np.float32)
        self.prepared = Points(columns(self.points), charges, short, float(np.abs(short).max(initial=0.0)))

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def groups(self) -> Groups:
        """The points in groups of neighbours of the same weight; there is one at least."""
        points, charges = self.points, self.prepared.charges
        waiting, groups = [np.flatnonzero(charges == charge) for charge in np.unique(charges)], []
        while waiting:
            rows = waiting.pop()
            if len(rows) <= _GROUP:
                groups.append(rows)
                continue
            longest = np.ptp(points[rows], axis=0).argmax()
            rows = rows[np.argsort(points[rows, longest], kind="stable")]
            waiting += [rows[: len(rows) // 2], rows[len(rows) // 2 :]]
        centres = np.array([points[rows].mean(axis=0) for rows in groups])
        radii = [
            np.linalg.norm(points[rows] - centre, axis=1).max() for rows, centre in zip(groups, centres, strict=True)
        ]
        order, begins = np.concatenate(groups), np.cumsum([0, *map(len, groups)], dtype=np.intp)
        heaviest = np.array([charges[rows[0]] for rows in groups])
        places = np.concatenate([points[order], centres])
        return Groups(columns(places), charges[order], begins, np.array(radii) * (1 + 1e-12), heaviest)
