"""Corners of a path rounded by arcs that are proven as its edges are."""

from __future__ import annotations

import logging

import numpy as np

from safe_ompl.collision import CertifiedMotion
from safe_ompl.common import FloatArray, InputError
from safe_ompl.danger import DangerField, DangerLimit, segment_bounds
from safe_ompl.robot import Robot
from safe_ompl.trajectories.curve import BlendedCurve, Piece

_log = logging.getLogger(__name__)

_STRAIGHT = 1e-9  # [rad] turns below this are driven through as they are
_SMALLER = (1.0, 0.5, 0.25, 0.1, 0.03)  # of the arc that the tolerance allows: what is tried
_SAME = 1e-12  # [rad] way points nearer than this are one


def blended(path: FloatArray, robot: Robot, tolerance: float, motion: CertifiedMotion | None) -> BlendedCurve:
    """Return the path (N, n) with its corners rounded.

    An arc that leaves the edges at a distance l from a corner where the path turns by α has the radius l/tan(α/2), and
    is l tan(α/4) away from the corner at most. The largest one within the tolerance is taken that uses
    no more than half of either edge and is proven; where none is, the robot stops in the corner.

    Parameters
    ----------
    path : ndarray, shape (N, n)
        Way points.
    robot : Robot
        The robot.
    tolerance : float
        How far the curve may be from the path [rad]; 0: it stops in every corner.
    motion : CertifiedMotion, optional
        What proves arcs; without it there are none.

    Raises
    ------
    InputError
        If the path does not move.
    """
    steps = robot.difference(path[:-1], path[1:])
    moves = np.linalg.norm(steps, axis=1) > _SAME
    if not moves.any():
        raise InputError("the path does not move: give two different way points at least")
    steps = steps[moves]
    points = path[0] + np.vstack(
        [np.zeros((1, robot.n)), np.cumsum(steps, axis=0)]
    )  # continuous joints unrolled
    lengths = np.linalg.norm(steps, axis=1)
    units = steps / lengths[:, None]
    proof = None if motion is None or not tolerance else ArcProof(motion)

    pieces: list[Piece] = []
    stops: list[int] = []
    begun = 0.0  # of the edge, used by the arc before
    for k, (unit, length) in enumerate(zip(units, lengths.tolist(), strict=True)):
        arc, room = None, 0.0
        last = k == len(units) - 1
        if not last:
            arc, room = _arc(
                points[k + 1], unit, units[k + 1], min(length, lengths[k + 1]) / 2, tolerance, proof
            )
        line = length - begun - room
        if line > _SAME * length:
            pieces.append(Piece(points[k] + begun * unit, unit, np.zeros(robot.n), line, 0.0))
        if arc is not None:
            pieces.append(arc)
        elif not last and _turn(unit, units[k + 1]) > _STRAIGHT:
            stops.append(len(pieces))
        begun = room
    if stops:
        why = "no arc is proven there" if proof else "nothing proves arcs" if tolerance else "tolerance 0"
        _log.info("the robot stops in %d of %d corners: %s", len(stops), len(units) - 1, why)
    return BlendedCurve(pieces, stops)


def _turn(first: FloatArray, second: FloatArray) -> float:
    """Return the angle between two unit vectors [rad]."""
    return float(2 * np.arctan2(np.linalg.norm(second - first), np.linalg.norm(second + first)))


def _arc(
    corner: FloatArray,
    first: FloatArray,
    second: FloatArray,
    room: float,
    tolerance: float,
    proof: ArcProof | None,
) -> tuple[Piece | None, float]:
    """Return a proven arc and how much of the edges it takes."""
    turn = _turn(first, second)
    if proof is None or turn <= _STRAIGHT or turn >= np.pi - _STRAIGHT:
        return None, 0.0
    inward = second - np.cos(turn) * first
    inward = inward - (inward @ first) * first
    inward /= np.linalg.norm(inward)
    longest = min(room, tolerance / np.tan(turn / 4))
    for share in _SMALLER:
        l = share * longest  # noqa: E741 - the formula's name
        radius = l / np.tan(turn / 2)
        arc = Piece(corner - l * first, first, inward, radius * turn, 1 / radius)
        if proof.holds(arc):
            return arc, l
    return None, 0.0


class ArcProof:
    """Proves arcs free, and within the limits of danger, as `CertifiedMotion` proves straight motions.

    Parameters
    ----------
    motion : CertifiedMotion
        Robot, scene, floor, and what must be kept.
    """

    def __init__(self, motion: CertifiedMotion) -> None:
        self._checker, self._floor = motion.checker, motion.floor
        self._required = motion.separation.required(motion.checker)
        self._limits = [limit for limit in motion.limits if isinstance(limit, DangerLimit)]
        self._unknown = len(self._limits) < len(motion.limits)
        if self._unknown:
            _log.warning("limits other than those of danger are not proven on arcs: corners stay as they are")

    def holds(self, arc: Piece) -> bool:
        """Return whether the arc is proven, by bisection.

        While the joints move along half an interval, pair p approaches by at most Σ_i R_pi ∫|q′_i|: an interval at
        whose centre every pair keeps more than that, and what it must keep besides, is free.
        """
        if self._unknown:
            return False
        intervals = [(0.0, arc.length)]
        while intervals:
            first, last = intervals.pop()
            middle = (first + last) / 2
            low, high = arc.slope_box(np.array([first]), np.array([last]))
            steps = np.maximum(np.abs(low), np.abs(high))[0] * (last - first) / 2
            q = arc.places(np.array([middle])).q[0]
            approach = self._required.pairs.radii @ steps
            free = not self._required.pairs.within_margins(q, approach + self._required.provable(0.0))
            if free and all(_keeps(limit, q, steps) for limit in self._limits):
                continue
            if 2 * approach.max(initial=0.0) < self._floor or (not free and self._checker.touches(q)):
                return False
            if not all(limit.allows(q) for limit in self._limits):
                return False
            intervals += [(first, middle), (middle, last)]
        return True


def _keeps(limit: DangerLimit, q: FloatArray, steps: FloatArray) -> bool:
    """Return whether the danger keeps to the limit, proven, while the joints are within `steps: (n,)` of `q: (n,)`."""
    return danger_within(limit.field, q, steps) <= limit.limit


def danger_within(field: DangerField, q: FloatArray, steps: FloatArray) -> float:
    """Return a proven bound of the danger while the joints are within `steps: (n,)` of `q: (n,)`; +inf: not known."""
    robot = field.robot
    fields, distances = field.link_fields(robot.keypoints(q)[None])
    moved = (robot.bounds.keypoint_radii @ steps)[robot.segments].max(axis=1)
    grown = segment_bounds(fields, distances, moved[:, None])
    if field.weighting == "length":
        if field.segments.lengths is None:
            return float("inf")
        grown *= field.segments.lengths.reshape(1, -1, 1)
    return float(field.aggregated(grown.sum(axis=1))[0])
