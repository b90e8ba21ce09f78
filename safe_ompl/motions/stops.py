"""Motions as curves whose parameter is their time, with boxes of their rates: how they stop beside people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from safe_ompl.collision import MotionProver
from safe_ompl.common import FloatArray, InputError, polynomials
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.rates import roughness
from safe_ompl.scene import People
from safe_ompl.trajectories import (
    CELL_LENGTH,
    CELLS,
    RATE_TOLERANCE,
    BodySpeeds,
    Boxes,
    Cells,
    CurvePoints,
    MotionCaps,
    PeopleDistances,
    RateLimits,
    Stops,
    divided_edges,
    stops_beside,
    within_tube,
)


class MotionCurve:
    """A motion in time, without slack, as a curve whose parameter is its time [s]; `limits` are those of its joints."""

    def __init__(self, motion: Motion, limits: RateLimits) -> None:
        self._motion = motion
        self._rates = [motion.derivative_coefficients(order) for order in (1, 2, 3)]
        self._rough = [roughness(motion, order) for order in (1, 2, 3)]
        rates = self._rates[0]
        ends = np.abs(np.stack([rates[:, 0], rates.sum(axis=1)])) + self._rough[0]
        moves = (ends > RATE_TOLERANCE[1]).any(axis=2)
        if moves[1, -1]:
            joint = int((ends[1, -1] / limits.velocity).argmax())
            raise InputError(
                f"must end at rest where it is to stop before people, and {limits.joint_names[joint]!r} ends at "
                f"{ends[1, -1, joint]:.3g} rad/s or m/s; without people it need not",
                "motion",
            )
        self._rests = np.flatnonzero(~(moves[0, 1:] | moves[1, :-1])) + 1  # knots at which it is at rest

    def at(self, s: FloatArray) -> CurvePoints:
        """Return the places (S, n) at times `s: (S,)`."""
        return CurvePoints(*(self._motion.derivative(s, order) for order in range(4)))

    def cells(self) -> Cells:
        """Return cells in which the joints move little, in all no fewer than a trajectory has."""
        motion = self._motion
        fastest = np.linalg.norm(np.abs(polynomials.bernstein(self._rates[0])).max(axis=1), axis=1)
        lengths = fastest * np.diff(motion.times)
        step = min(CELL_LENGTH, float(lengths.sum()) / CELLS)
        parts = np.ceil(lengths / step) if step > 0 else np.ones(motion.pieces)
        return self.between(divided_edges(motion.times, np.maximum(parts, 1).astype(np.intp)))

    def between(self, edges: FloatArray) -> Cells:
        """Return the cells between times, the knots among them."""
        times = self._motion.times
        piece = np.searchsorted(times, (edges[1:] + edges[:-1]) / 2, side="right") - 1
        span = np.diff(times)[piece]
        first, last = ((ends - times[piece]) / span for ends in (edges[:-1], edges[1:]))
        roughest = [rough[piece] for rough in self._rough]
        half = np.diff(edges)[:, None] / 2  # velocities at centres are those of the polynomials
        roughest[1] = np.maximum(roughest[1], roughest[0] / half)
        boxes = []
        for rates, rough in zip(self._rates, roughest, strict=True):
            held = rates[piece]
            points = polynomials.bernstein(polynomials.restricted(held, first, last))
            error = 16 * (held.shape[1] + 2) * polynomials.EPS * np.abs(held).sum(axis=1) + rough
            boxes.append((points.min(axis=1) - error, points.max(axis=1) + error))
        swings = np.maximum(np.abs(boxes[2][0]), np.abs(boxes[2][1]))
        rests = np.searchsorted(edges, times[self._rests])
        return Cells(edges, Boxes(*boxes[0], *boxes[1]), swings, rests)


def stops_of(motion: Motion, proof: MotionProver, limits: RateLimits | None, people: People) -> Stops:
    """Return how a motion, its joints in the order of the robot's, stops beside people within a proof's tube.

    Raises InputError if it has no times, or is of bare samples; if it does not end at rest; if there are no limits, or
    they limit the jerk; if people are not in the scene, or may be touched within a tube.
    """
    if not motion.rated:
        why = "bare samples have no rates" if motion.timed else "it has no times"
        raise InputError(f"stops beside people cannot be proven: {why}", "motion")
    if limits is None:
        raise InputError("give limits: stops beside people need to know how hard the robot may brake", "limits")
    if limits.jerk is not None:
        raise InputError(
            "stops that keep a limit of the jerk are proven of our own trajectories only; without it, stops that keep "
            "velocities and accelerations are",
            "limits",
        )
    checker = proof.checker
    people = within_tube(MotionCaps(people), proof).people or people
    off = motion.allowance.sum(axis=0)  # of jumps, too: distances are kept from one piece to the next
    nearer = float((checker.robot.bounds.displacement_radii @ off).max(initial=0.0))
    distances = PeopleDistances(checker.robot, checker.scene, replace(people, clearance=people.clearance + nearer))
    curve = MotionCurve(motion, limits)
    return stops_beside(curve, curve.cells(), BodySpeeds(checker.robot), limits, distances)
