"""Ladder graphs: the branches of the inverse kinematics for a whole tool path, chosen by dynamic programming.

A rung is a pose of the curve. A strand is a sequence of solutions of the inverse kinematics, one at each rung. Newton's
method begins at the solution of the previous rung. If the robot is redundant for the task, a null-space motion reduces
the danger. A strand ends at a joint limit, in a collision, or where the arm would jump. The cheapest path follows
strands, and may change to another strand where two strands are near each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from safe_ompl.collision import CollisionChecker
from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.danger import DangerField
from safe_ompl.robot import METRES_PER_RADIAN, Frames, Tip

# The accuracy of the nodes; a radian counts METRES_PER_RADIAN.
PRECISION = 1e-7  # [m]
# Iterations of Newton's method from a random configuration, and from the previous rung.
_SEARCH, _FOLLOW = 30, 6
# A joint moves at most this far between rungs.
_JUMP = 0.35  # [rad or m]
# A node that is nearer to the start than this is the start.
_START_TOLERANCE = 1e-9  # [rad or m]
# Nodes of a rung that differ by less than this are equal.
_EQUAL_NODES = 0.05  # [rad or m]
# The longest null-space motion at a rung.
_DESCENT = 0.2  # [rad or m]
# The longest null-space motion between rungs.
_DRIFT = 0.1  # [rad or m]
# The number of null-space steps that reduce the danger of a new node before its strand is followed.
_DESCENTS = 8
# Clearances below this one have a cost.
_CLEAR = 0.05  # [m]
# The cost of a whole curve without clearance, and of a curve in danger of its typical size.
_CLEARANCE = 20.0
_DANGER = 30.0


@dataclass
class Ends:
    """The reason why strands ended: the largest curve parameter [m] that was reached, and a message."""

    reached: float = 0.0
    why: str = "no configuration has its tip there"

    def note(self, s: float, why: str) -> None:
        """Store the reason if its strand came farthest."""
        if s >= self.reached:
            self.reached, self.why = s, why


class LadderPath(NamedTuple):
    """A path along the ladder: the number of rungs reached; if all, its nodes (R, n) and their strands (R,)."""

    reached: int
    nodes: FloatArray | None = None
    strands: IntArray | None = None


class Costs:
    """Costs of nodes [rad per curve]: danger divided by its median at the first nodes, and clearance below 50 mm."""

    def __init__(self, checker: CollisionChecker, field: DangerField | None) -> None:
        self._checker, self.field = checker, field
        self._scale: float | None = None
        obstacles = {obstacle for _, obstacle in checker.distance_names}
        self._margins = np.array([_CLEAR if obstacles & {*names} else 0.0 for names in checker.pair_names])
        self._margins.setflags(write=False)

    def of(self, Q: FloatArray) -> FloatArray:
        """Return the costs (B,) of configurations (B, n), infinite in contact."""
        costs = np.zeros(len(Q))
        if self.field is not None and len(Q):
            dangers = self.field.values(Q)
            # The scale is the median of the danger at the first nodes.
            if self._scale is None:
                self._scale = float(np.median(dangers)) or 1.0
            costs += self.weight * dangers
        near = np.flatnonzero([self._checker.pairs.within_margins(q, self._margins) for q in Q])
        if len(near):
            costs[near[[self._checker.touches(q) for q in Q[near]]]] = np.inf
            if len(self._checker.distance_names):
                clear = self._checker.all_distances(Q[near]).min(axis=1)
                costs[near] += _CLEARANCE * np.maximum(0.0, 1 - clear / _CLEAR) ** 2
        return costs

    @property
    def weight(self) -> float:
        """The cost of a unit of danger along the whole curve."""
        return _DANGER / (self._scale or 1.0)

    def downhill(self, Q: FloatArray) -> FloatArray:
        """Return −∇danger/‖∇danger‖ (B, n); 0 where the gradient is 0, and without a danger field."""
        if self.field is None:
            return np.zeros_like(Q)
        gradients = self.field.gradients(Q)
        size = np.linalg.norm(gradients, axis=1, keepdims=True)
        return np.where(size > 0, -gradients / np.maximum(size, 1e-300), 0.0)


class Ladder:
    """The ladder graph of a tool path.

    Parameters
    ----------
    tip : Tip
        The tip, with its robot.
    checker : CollisionChecker
        Collision checker of the robot in the scene.
    costs : Costs
        Costs of nodes.
    s : ndarray, shape (R,)
        Curve parameters of the rungs [m].
    frames : Frames
        Frames of the curve at the rungs.
    """

    def __init__(self, tip: Tip, checker: CollisionChecker, costs: Costs, s: FloatArray, frames: Frames) -> None:
        self._tip, self._checker, self._costs = tip, checker, costs
        self.s, self.frames = s, frames
        # The nodes of each rung and strand, NaN where a strand has none.
        self._nodes = np.empty((len(s), 0, tip.robot.n))
        # The costs of the nodes, infinite where there is none.
        self._weights = np.empty((len(s), 0))
        self._start: FloatArray | None = None
        self.ends = Ends()

    def begin(self, start: FloatArray) -> None:
        """Add the strand from a start configuration (n,); every path must begin there."""
        self._start = start
        self._follow(start[None], 0)

    def grow(self, rng: np.random.Generator, rung: int, seeds: int) -> None:
        """Solve the inverse kinematics at a rung from `seeds` random configurations, and add strands through them."""
        robot = self._tip.robot
        given = rng.uniform(robot.lower, robot.upper, (seeds, robot.n))
        found, arrived = self._tip.solved(given, self._at(rung, seeds), PRECISION, _SEARCH)
        if not arrived.any() and not np.isfinite(self._nodes[rung]).any():
            off = self._tip.errors(self._tip.at(found), self._at(rung, seeds))
            nearest = np.hypot(*(np.linalg.norm(part, axis=1) for part in (off[:, :3], METRES_PER_RADIAN * off[:, 3:])))
            best = _off(off[nearest.argmin()])
            why = f"no configuration within the joint limits has its tip there: the nearest found is {best}"
            self.ends.note(self.s[max(0, rung - 1)], why)
        self._follow(self._distinct(self._descended(self._distinct(found[arrived], rung), rung), rung), rung)

    def cheapest(self) -> LadderPath:
        """Return the cheapest path over all rungs, by dynamic programming, or the number of rungs it can reach."""
        nodes = self._nodes
        rungs, strands, _ = nodes.shape
        weights, shares = self._weights, np.diff(self.s) / (self.s[-1] - self.s[0])
        there = np.isfinite(weights)
        if self._start is not None:
            there[0] &= np.abs(nodes[0] - self._start).max(axis=1) < _START_TOLERANCE
        best, before = np.where(there[0], 0.0, np.inf), np.zeros((rungs, strands), dtype=np.intp)
        if not there[0].any():
            return LadderPath(0)
        for k in range(1, rungs):
            old, new = np.flatnonzero(np.isfinite(best)), np.flatnonzero(there[k])
            steps = self._tip.robot.difference(nodes[k - 1, old][:, None], nodes[k, new])
            lengths = np.linalg.norm(steps, axis=2)
            middle = (weights[k - 1, old][:, None] + weights[k, new]) / 2
            costs = np.where(
                np.abs(steps).max(axis=2) < _JUMP, best[old][:, None] + lengths + shares[k - 1] * middle, np.inf
            )
            best = np.full(strands, np.inf)
            if len(new):
                best[new], before[k, new] = costs.min(axis=0), old[costs.argmin(axis=0)]
            if not np.isfinite(best).any():
                return LadderPath(k)
        chosen = np.empty(rungs, dtype=np.intp)
        chosen[-1] = best.argmin()
        for k in range(rungs - 1, 0, -1):
            chosen[k - 1] = before[k, chosen[k]]
        return LadderPath(rungs, nodes[np.arange(rungs), chosen], chosen)

    def remove(self, rung: int, strand: int) -> None:
        """Remove a node at which the proof of a path failed."""
        self._weights[rung, strand] = np.inf

    def _at(self, rung: int, count: int) -> Frames:
        return Frames(*(np.repeat(part[rung : rung + 1], count, axis=0) for part in self.frames))

    def _distinct(self, Q: FloatArray, rung: int) -> FloatArray:
        """Return the free configurations that differ from each other and from the strands at this rung."""
        known = [node for node in self._nodes[rung] if np.isfinite(node[0])]
        kept: list[FloatArray] = []
        for q in Q:
            if all(np.abs(self._tip.robot.difference(q, other)).max() > _EQUAL_NODES for other in (*known, *kept)):
                if pair := self._checker.colliding_pair(q):
                    self.ends.note(self.s[rung], f"{pair[0]} would touch {pair[1]}")
                    continue
                kept.append(q)
        return np.array(kept).reshape(-1, Q.shape[1])

    def _descended(self, Q: FloatArray, rung: int) -> FloatArray:
        """Return configurations (B, n) at a rung, each moved in the null space to less danger if possible."""
        if self._costs.field is None:
            return Q
        frames, costs = self._at(rung, len(Q)), self._costs.of(Q)
        for _ in range(_DESCENTS):
            _, jacobians = self._tip.task(self._tip.at(Q), frames)
            drift = self._tip.null_motion(jacobians, _DESCENT * self._costs.downhill(Q))
            moved, arrived = self._tip.solved(np.clip(Q + drift, *self._tip.limits), frames, PRECISION, _FOLLOW)
            new = self._costs.of(moved)
            better = arrived & (new < costs)
            if not better.any():
                break
            Q, costs = np.where(better[:, None], moved, Q), np.where(better, new, costs)
        return Q

    def _follow(self, Q: FloatArray, rung: int) -> None:
        """Follow configurations (B, n) at a rung in both directions, and keep the strands."""
        if not len(Q):
            return
        strands = np.full((len(self.s), *Q.shape), np.nan)
        strands[rung] = Q
        for rungs in (range(rung + 1, len(self.s)), range(rung - 1, -1, -1)):
            alive, now, last = np.arange(len(Q)), Q, rung
            for k in rungs:
                now, kept = self._step(now, last, k)
                alive, now, last = alive[kept], now[kept], k
                if not len(alive):
                    break
                strands[k, alive] = now
        weights, there = np.full(strands.shape[:2], np.inf), np.isfinite(strands[:, :, 0])
        weights[there] = self._costs.of(strands[there])
        self._nodes = np.concatenate([self._nodes, strands], axis=1)
        self._weights = np.concatenate([self._weights, weights], axis=1)

    def _step(self, Q: FloatArray, last: int, rung: int) -> tuple[FloatArray, BoolArray]:
        """Follow configurations (B, n) from rung `last` to `rung`; return those there, and which (B,) are usable.

        A configuration is usable if it is free and no joint jumps.
        """
        frames = self._at(rung, len(Q))
        _, jacobians = self._tip.task(self._tip.at(Q), self._at(last, len(Q)))
        drift = self._tip.null_motion(jacobians, _DRIFT * self._costs.downhill(Q))
        guess = np.clip(Q + drift, *self._tip.limits)
        found, arrived = self._tip.solved(guess, frames, PRECISION, _FOLLOW)
        moved = np.abs(found - Q).max(axis=1)
        forward = rung > last
        for k in np.flatnonzero(~arrived | (moved >= _JUMP)) if forward else ():
            self.ends.note(self.s[last], self._obstacle_of(found[k], rung, bool(arrived[k])))
        kept = arrived & (moved < _JUMP)
        for k in np.flatnonzero(kept):
            if pair := self._checker.colliding_pair(found[k]):
                kept[k] = False
                if forward:
                    self.ends.note(self.s[last], f"{pair[0]} would touch {pair[1]}")
        return found, kept

    def _obstacle_of(self, q: FloatArray, rung: int, arrived: bool) -> str:
        """Return the reason why a strand ends at `q: (n,)` before a rung: a jump, joint limits, or a singularity."""
        if arrived:
            return "the arm would jump to another branch of its inverse kinematics"
        robot, (low, high) = self._tip.robot, self._tip.limits
        off = _off(self._tip.errors(self._tip.at(q[None]), self._at(rung, 1))[0])
        stuck = [robot.joint_names[i] for i in np.flatnonzero((q <= low) | (q >= high))]
        if stuck:
            word = "its limit" if len(stuck) == 1 else "their limits"
            return f"{' and '.join(stuck)} would pass {word}: within {word} the tip is {off}"
        return f"the arm is singular: no motion of its joints brings the tip on, which is {off}"


def _off(error: FloatArray) -> str:
    return f"{1e3 * np.linalg.norm(error[:3]):.2g} mm and {np.degrees(np.linalg.norm(error[3:])):.3g}° off"
