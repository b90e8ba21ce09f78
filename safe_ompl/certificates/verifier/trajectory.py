"""Check the time law of a certificate by simple methods: limits, speeds, danger in motion, stops.

**Stops.** A stop that begins in cell j decelerates by min(b_j … b_k) in cell k. If there is a window, the stop is that
of the plan, and the robot is later by at most the window. The stop takes longest from the end of cell j, at the largest
speed there. While the stop is in cell k, it is not later than the stop from the start of cell j that ends at the end of
cell k. The smaller of both times is a bound for stops from cell j; its maximum over all j that reach cell k is the
latest instant τ_k at which a stop can still move in cell k. The distance of the robot from every limb must exceed the
clearance plus the distance that the limb covers at its speed in the reaction time and in τ_k.
"""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

from safe_ompl.certificates.claims import ClaimedStops, ClaimedTrajectory
from safe_ompl.certificates.verifier.bodies import Budget, PlainSpeeds
from safe_ompl.certificates.verifier.danger import PlainMovingDanger
from safe_ompl.certificates.verifier.motion import RecordedLaw, RecordedMotion
from safe_ompl.common import CertificateError, FloatArray
from safe_ompl.io import schema
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_STOP_ROUNDING = 1e-9


def check_trajectory(
    curve: RecordedMotion, path: RecordedMotion, robot: Robot, scene: Scene, budget: Budget
) -> RequiredFromPeople | None:
    """Check that the time law of a curve is as claimed; return the distances that must be kept from people.

    Raises CertificateError if it is not. The curve must begin and end where the path does. `check_motion` checks that
    the curve is free, as for every motion.
    """
    claim = curve.claim
    assert isinstance(claim, ClaimedTrajectory)
    law = RecordedLaw(claim, curve, path, robot)
    takes = law.duration
    if abs(takes - claim.duration) > _STOP_ROUNDING * takes:
        raise CertificateError(f"trajectory: it takes {takes:.6f} s, {claim.duration} s are claimed")
    sizes, squares = np.diff(law.edges), np.column_stack([law.squares[:-1], law.squares[1:]])
    path_accelerations = np.column_stack([law.path_accelerations] * 2)
    failure = law.exceeded(claim, squares, path_accelerations)
    if failure is not None:
        raise CertificateError(f"trajectory: {failure}")
    budget.where = "the speeds of its trajectory"
    for limit, who in ((claim.tool_speed, "the tool"), (claim.link_speed, "a link")):
        at = None if limit is None else PlainSpeeds(robot, budget).exceeded(law, limit, tool=who == "the tool")
        if at is not None:
            raise CertificateError(f"trajectory: {who} is faster than {limit:g} m/s near {at:.6f} rad")
    if claim.danger is not None:
        budget.where = "the danger of its trajectory"
        at = PlainMovingDanger(robot, scene, claim.danger, budget).exceeded(law)
        if at is not None:
            bound = claim.danger.bound
            raise CertificateError(f"trajectory: the danger in motion is not below {bound:.4f} near {at:.6f} rad")
    stops = claim.stops
    if stops is None:
        return None
    if stops.brakes.shape != sizes.shape:
        raise CertificateError(f"trajectory: {len(stops.brakes)} brakes for {len(sizes)} cells")
    fastest, latest = visits_of_stops(law, stops.brakes)
    still = np.zeros(len(sizes))
    squares = np.column_stack([squares, still, still, fastest, fastest])
    path_accelerations = np.column_stack([path_accelerations, still, -stops.brakes, still, -stops.brakes])
    failure = law.exceeded(claim, squares, path_accelerations)
    if failure is not None:
        raise CertificateError(f"trajectory: in a stop {failure}")
    return RequiredFromPeople(law, scene, stops, latest + law.window)


def visits_of_stops(law: RecordedLaw, brakes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return for each of the C cells the largest ṡ² at which a stop enters, and the latest instant of motion there.

    The instant is −inf if no stop reaches the cell. Raises CertificateError if a stop does not decelerate or goes too
    far.
    """
    if not (brakes > 0).all():
        raise CertificateError("trajectory: a stop does not decelerate")
    sizes, squares = np.diff(law.edges), law.squares
    fastest, latest = np.zeros(len(sizes)), np.full(len(sizes), -np.inf)
    for j in range(len(sizes)):
        end = int(law.ends[j])
        weakest = np.minimum.accumulate(brakes[j:end])
        # ṡ² that the stop has lost since the start of j.
        taken = np.append(0.0, np.cumsum(2 * weakest * sizes[j:end]))
        top = max(squares[j], squares[j + 1])
        spare = _STOP_ROUNDING * max(top, 1e-6)
        if squares[j] > taken[-1] + spare or squares[j + 1] > taken[-1] - taken[1] + spare:
            raise CertificateError(
                f"trajectory: a stop from {law.edges[j]:.6f} rad goes beyond where the robot must stand"
            )
        reached = int(np.searchsorted(taken[1:] - taken[1], top, side="left"))
        # The reached cells are j … j + last.
        last = min(max(reached, 1), end - j)
        whole = _stop_duration(top, weakest[1:], sizes[j + 1 : end], brakes[j])
        ending = _durations(taken[: last + 1], sizes[j : j + last])
        # ṡ² at the end of j, for any start of the stop within j.
        after = max(squares[j] - taken[1], squares[j + 1])
        entered = np.append(top, after - (taken[1:last] - taken[1]))
        fastest[j : j + last] = np.maximum(fastest[j : j + last], entered)
        latest[j : j + last] = np.maximum(latest[j : j + last], np.minimum(whole, ending))
    return fastest, latest


def _stop_duration(square: float, brakes: FloatArray, sizes: FloatArray, first: float) -> float:
    """Return the duration of a stop that begins with cells of given decelerations (without cells: `first`)."""
    time, brake = 0.0, first
    for brake, size in zip(brakes.tolist(), sizes.tolist(), strict=True):
        after = square - 2 * brake * size
        if after <= 0:
            break
        time += 2 * size / (square**0.5 + after**0.5)
        square = after
    return float(time + square**0.5 / brake)


def _durations(taken: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return for each cell the duration of the stop that begins with the first cell and ends with this one."""
    left = np.maximum(taken[1:, None] - taken[None, :], 0.0)  # (end, grid point): ṡ²
    speeds = np.sqrt(left)
    both = speeds[:, :-1] + speeds[:, 1:]
    spans = np.where(both > 0, 2 * sizes / np.where(both > 0, both, 1.0), 0.0)
    return np.asarray(np.tril(spans).sum(axis=1))


class RequiredFromPeople:
    """Distances that bodies must keep from limbs of people on the pieces of a motion.

    Stops move until `latest: (C,)`.
    """

    def __init__(self, law: RecordedLaw, scene: Scene, stops: ClaimedStops, latest: FloatArray) -> None:
        self._stops, self._latest, self._pieces = stops, latest, law.pieces
        self._starts, self._edges = law.starts, law.edges.tolist()
        self._speeds = {
            schema.OBSTACLE + part: stops.speed_of(part[len(name) + 1 :])
            for name in stops.who
            for part, _, _ in scene[name].geometries()
        }

    def __call__(self, body: str, piece: int, first: float, last: float) -> float:
        """Return the distance [m] to keep from a body on a piece, between two fractions of the piece."""
        if body not in self._speeds:
            return 0.0
        start, length = self._starts[piece], self._pieces[piece].length
        places = start + first * length + _STOP_ROUNDING, start + last * length - _STOP_ROUNDING
        low, high = (min(max(bisect_left(self._edges, s) - 1, 0), len(self._edges) - 2) for s in places)
        time = float(self._latest[low : high + 1].max())
        if time == -np.inf:
            return 0.0
        return self._stops.clearance + self._speeds[body] * (self._stops.reaction_time + time)
