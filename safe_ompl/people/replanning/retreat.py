"""Retreats: motions that bring a robot no nearer to anyone who is too near for any other motion.

Let a limb be in a set when it is measured, and u the unit vector along which a body of the robot, where a motion
begins, is farthest from it. If the set is behind the plane across u through the foremost point of the body, and no
point of the body gets behind that plane, the body *recedes*: it comes no nearer to the plane's other side, where the
limb was, and the limb can be at the body no sooner than at the plane. That is the bound for a body that stands, too.

A vertex of the body that is start ≥ 0 ahead of the foremost one, and end ≥ 0 after the motion, is in between never
behind its chord by more than A x(l − x)/2 at an arc length x of l, with |a″| ≤ A. That is at least 0 all along if
√start + √end ≥ √(A l²/2). The convex body recedes if all its vertices do. A body that only turns about the axis of the
first joint never leaves the solid that it sweeps about that: along u, a vertex at a distance r from the axis comes no
nearer than its place on the axis less r‖u⊥‖. It recedes from all who are behind a plane across u before that solid.

What does not recede must be kept from as ever. A body that must recede is no faster than
`guarded_path.RETREAT_SPEED`. People who run after it may touch it, as they may touch one that stands.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from safe_ompl.collision import MotionProver
from safe_ompl.common import BoolArray, FloatArray
from safe_ompl.geometry.kernels import CellFrames, chords_ahead, separating_axes
from safe_ompl.people import ReachSets
from safe_ompl.people.replanning.guarded_path import GuardedPath, PathLimits, RobotBodies, StopMotion, line

# Who may be at the robot so soon [s] is retreated from; if that fails only from the nearest.
_SOON = (0.2, 0.12)
_LENGTHS = (0.6, 0.3, 0.15)  # [rad] of retreats that are tried
_NUDGE = 1e-4  # [rad]
_STILL = 3  # so many of the first joints may stay still: links near the base cannot get away
_ROUNDS = 40  # of the search for a direction
_FAR = 0.35  # [m] who is farther away need not be looked at
_LEAST = 0.02  # [m/rad] distances must grow by this at least


class Receding:
    """Which bodies (G,) recede from which of M limbs along motions that begin at s of a path."""

    def __init__(self, path: GuardedPath, s: float, sets: ReachSets) -> None:
        self._path, self._s, self._sets = path, s, sets
        frames = path.bodies.frames(path.curve.at(np.array([s])).q)
        self._axes, self._apart = _ahead(path.bodies, frames, sets)
        self._always = np.zeros((len(path.bodies.links), len(sets.names)), dtype=bool)
        for g in np.flatnonzero(path.bodies.turning).tolist():
            near = np.flatnonzero((self._apart[g] > 0.0) & (self._apart[g] < np.inf))
            lost = path.bodies.swept(g, frames, self._axes[g, near])
            self._always[g, near[self._apart[g, near] > lost]] = True

    def along(self, motion: StopMotion) -> BoolArray:
        """Return which (G, M) do along a motion; where it goes through a corner only those that always do."""
        path, last = self._path, float(motion.places[-1])
        found, corners = self._always.copy(), path.edges[path.stops]
        if not len(motion.cells) or ((self._s < corners) & (corners < last)).any():
            return found
        frames = path.bodies.frames(path.curve.at(np.array([self._s, last])).q)
        bends = path.accelerations[motion.cells].max(axis=0) * (last - self._s) ** 2 / 2
        body, which = np.nonzero(chords_ahead(path.bodies.arrays, frames, self._axes, self._apart, bends))
        found[body, which] = True
        return found


def _ahead(bodies: RobotBodies, frames: CellFrames, sets: ReachSets) -> tuple[FloatArray, FloatArray]:
    """Return directions (G, S, 3) from sets to bodies, and how far (G, S) apart they are along these [m], at least.

    The sets are those of the measurement, the frames the first ones. Distances above `_FAR` are infinite.
    """
    axes, apart = separating_axes(bodies.arrays, frames, sets.arrays, _FAR)
    return axes, apart - bodies.arrays.pads[:, None] - sets.radii - sets.grown(0.0)


class Retreats:
    """Searches motions that recede from people, free of what stands still."""

    def __init__(self, prover: MotionProver, bodies: RobotBodies, limits: PathLimits) -> None:
        self._prover, self._bodies, self._limits = prover, bodies, limits

    def search(self, path: GuardedPath, s: float, sets: ReachSets) -> GuardedPath | None:
        """Return a motion away from all who are near a robot that stands at s of a path, back, and on; or None."""
        q = path.curve.at(np.array([s])).q[0]
        end = self._away(q, sets)
        if end is None:
            return None
        out, back, rest = (
            GuardedPath.along(self._bodies, curve, self._limits)
            for curve in (line(q, end), line(end, q), path.curve.rest(s))
        )
        return out.then(back).then(rest)

    def _away(self, q: FloatArray, sets: ReachSets) -> FloatArray | None:
        """Return the end of a free motion away from all who are near; None if nobody is, or none is found."""
        n, robot, bodies = len(q), self._prover.checker.robot, self._bodies
        frames = bodies.frames(np.vstack([q, q + _NUDGE * np.eye(n)]))
        axes, apart = _ahead(bodies, frames, sets)
        after = [sets.grown(soon) - sets.grown(0.0) for soon in _SOON]
        pairs = np.argwhere((apart > 0.0) & (apart < np.max(after, axis=0)))
        least = [(bodies.vertices(g, frames) @ axes[g, s]).min(axis=1) for g, s in pairs.tolist()]
        rates = np.array([(each[1:] - each[0]) / _NUDGE for each in least]).reshape(-1, n)
        for grown, still in product(after, range(min(n, _STILL + 1))):
            near = rates[apart[tuple(pairs.T)] < grown[pairs[:, 1]]] * (np.arange(n) >= still)
            near = near[near.any(axis=1)]
            way = _away_from_all(near)
            if not len(near) or (near @ way).min() < _LEAST:
                continue
            for length in _LENGTHS:
                end = q + length * way
                if robot.within_limits(end).all() and self._prover.is_free(q, end):
                    return np.asarray(end)
        return None


def _away_from_all(rates: FloatArray) -> FloatArray:
    """Return a direction (n,) in which the least of the rates (P, n) is as large as a few rounds make it."""
    units = rates / np.maximum(np.linalg.norm(rates, axis=1), 1e-9)[:, None]
    way = units.sum(axis=0)
    best, most = way, -np.inf
    for _ in range(_ROUNDS if len(rates) else 0):
        unit = way / max(float(np.linalg.norm(way)), 1e-9)
        worst = int((rates @ unit).argmin())
        if rates[worst] @ unit > most:
            best, most = unit, float(rates[worst] @ unit)
        way = way + units[worst]
    return np.asarray(best)
