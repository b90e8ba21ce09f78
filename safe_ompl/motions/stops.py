"""Stops for people from every instant of a motion (`docs/how-it-works.md` §9): proofs, and the speeds they allow.

A stop stays on the motion. Before a limb may reach a cell, the robot has left the cell, stands still, or is so slow
that a contact is harmless (`PeopleDistances`). Two functions use the same cells, distances and contact limits.

* `stops_beside` checks whether the stops of a timed motion are in time. The motion's parameter σ is its time, x = σ̇²,
  and a stop brakes in each cell as hard as the ranges of q′ and q″ allow. If x would reach y < 0 at the end of a cell
  of size h, the stop ends within the cell, after 2h√x/(x − y). Where the motion itself accelerates more than the limit,
  x stays constant, and the stop accelerates no more than the motion. A stop also ends where the motion is at rest. No
  stop is needed there.
* `people_velocity_limits` computes how fast the robot may follow a path. A stop decelerates by one number b per cell,
  and never harder than at its beginning. Hence if a speed is allowed, all smaller speeds are allowed.

There are two braking rules, because with stops that brake by b, splines beside a person would be proven only if they
were up to 21 % slower (4 % in the mean of eight). While people move, the area they may reach changes at every tick:
`safe_ompl.live.replanning` then computes the distances of a few cells, for stops that brake by b.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.common import FloatArray, InputError, IntArray
from safe_ompl.motions.cells import BodySpeeds, Cells, divided_edges
from safe_ompl.motions.contact import CLAMPING, CONTACT, SEPARATION
from safe_ompl.motions.laws import squared_velocities_of_stop, stopping_speeds, time_left
from safe_ompl.motions.limits import RATE_TOLERANCE, RateLimits
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.separation import PeopleDistances, SeparationBounds
from safe_ompl.motions.time_law import SmoothLimits, TimeLaw, best_window, joint_velocity_limit
from safe_ompl.motions.trajectory import VelocityLimit
from safe_ompl.motions.velocity_limits import Standstill, StandstillError, bending_velocity_limit, braking

# Limits of dividing the cells of a timed motion: rounds, parts of a cell per round, and the least cell.
_MOST_DIVISIONS = 6
_MOST_PARTS = 8
_LEAST_CELL_TIME = 1e-4  # [s]
# Finer cells might shorten a stop by this share of its time.
_STOP_TIME_LOSS = 0.01
# Finer cells may show that a speed is harmless if it is above this share of a harmless speed.
_NEARLY_HARMLESS = 0.9
# When a path is timed, cells are not divided into smaller ones than `_LEAST_CELL_LENGTH`. Remaining times are taken to
# be at least `_LEAST_TIME_LEFT`. A stop takes at most `_MOST_STOP_TIME_FACTOR` times the time of constant deceleration.
_LEAST_CELL_LENGTH = 1e-3  # [rad]
_LEAST_TIME_LEFT = 0.005  # [s]
_MOST_STOP_TIME_FACTOR = 3.0


@dataclass(frozen=True)
class Stops:
    """The stops of a motion from any instant, and the time left before people may arrive; made by `stops_beside`.

    The edges of `cells` are times of the motion. Stops keep `accelerations: (n,)`. All stops that begin in a cell end
    `left: (N,)` [s] before a person may arrive; negative: not proven. `limb` is the first to arrive, and would be met
    in cell `where`. Finer cells might increase `left` by about `loss` [s].
    """

    cells: Cells
    accelerations: FloatArray
    left: FloatArray
    limb: IntArray
    where: IntArray
    loss: FloatArray
    separation: SeparationBounds
    distances: PeopleDistances

    def __repr__(self) -> str:
        return f"Stops({len(self.cells)} cells, {self.left.min():.3g} s left)"

    def met(self, cell: int) -> tuple[str, tuple[str, str], float]:
        """Return the most critical encounter of stops from a cell: link, (person, limb), remaining distance [m]."""
        k, m = int(self.where[cell]), int(self.limb[cell])
        bounds, distances, people = self.separation, self.distances, self.distances.people
        # The time is infinite for limbs that do not move.
        time = float(bounds.times[k, m])
        since = people.reaction_time + (time - float(self.left[cell]) if np.isfinite(time) else 0.0)
        room = bounds.distances[k, m] - people.clearance - distances.grown(m, since)
        return distances.links[int(bounds.nearest[k, m])], distances.limbs[m], float(room)

    def stop_from(self, time: float) -> TimeLaw:
        """Return the time law of the stop that begins at a time [s] of the motion.

        Its arc length is the time of the motion.
        """
        edges = self.cells.edges
        begin = float(np.clip(time, edges[0], edges[-1]))
        j = int(np.clip(np.searchsorted(edges, begin, side="right") - 1, 0, len(self.cells) - 1))
        end = int(self.cells.last_before_stop[j])
        squared_speeds = squared_velocities_of_stop(j + 1, end, self.cells.sizes, self.cells.boxes, self.accelerations)
        at = edges[j + 1 : j + 1 + len(squared_speeds)].copy()
        if squared_speeds[-1] < 0.0:
            at[-1] -= np.diff(at[-2:])[0] * squared_speeds[-1] / (squared_speeds[-1] - squared_speeds[-2])
            squared_speeds[-1] = 0.0
        return TimeLaw.through(np.append(begin, at), np.append(1.0, squared_speeds))


def stops_beside(
    motion: Motion, cells: Cells, bodies: BodySpeeds, limits: RateLimits, distances: PeopleDistances
) -> Stops:
    """Return the stops of a motion, which ends at rest, and the time left before people arrive; see the module."""
    accelerations = limits.acceleration
    for rounds_left in reversed(range(_MOST_DIVISIONS + 1)):
        braked = cells.sizes, cells.boxes, accelerations, cells.last_before_stop
        none = np.empty((len(cells), 0))
        spans = time_left(*braked, none, none)[-1]
        soon = float(spans.max())
        found = distances.along(motion, cells, bodies, soon, soon)
        still = np.asarray((cells.dq_ds <= RATE_TOLERANCE[1]).all(axis=1))
        times = np.where(still[:, None], np.inf, found.times)
        left, limb, where, entries, _ = time_left(*braked, times, found.harmless)
        loss = found.lost[where, limb] + cells.sizes + 2 * cells.sizes[where]
        loss = np.where(limb < 0, 0.0, loss) + _STOP_TIME_LOSS * spans
        slow = found.harmless[where, limb] > _NEARLY_HARMLESS * entries
        # Finer cells have tighter speed bounds, so a late stop may turn out to be harmless.
        loss = np.where(slow & (left < 0), np.maximum(loss, -2 * left), loss)
        parts = _finer(cells, left, where, loss)
        # Dividing also ends if some stop is so late that finer cells cannot help.
        if not rounds_left or (parts == 1).all() or (left + loss < 0).any():
            return Stops(cells, accelerations, left, limb, where, loss, found, distances)
        cells = motion.between(divided_edges(cells.edges, parts))
    raise AssertionError


def _finer(cells: Cells, left: FloatArray, where: IntArray, loss: FloatArray) -> IntArray:
    """Return into how many parts (N,) to divide each cell, so that more stops might be proven."""
    parts: IntArray = np.ones(len(cells), dtype=np.intp)
    for j in np.flatnonzero((left < 0) & (left + loss > 0)):
        k, wanted = where[j], np.clip(np.ceil(loss[j] / (left[j] + loss[j])), 2, _MOST_PARTS)
        parts[j : k + 1] = np.maximum(parts[j : k + 1], 2)
        parts[[j, k]] = np.maximum(parts[[j, k]], wanted)
    most = np.maximum(cells.sizes / _LEAST_CELL_TIME, 1.0).astype(np.intp)
    return np.asarray(np.minimum(parts, most))


# --------------------------------------------------------------- the largest speeds from which stops are in time


def people_velocity_limits(
    motion: Motion, cells: Cells, bodies: BodySpeeds, limits: RateLimits, distances: PeopleDistances, loss: float
) -> tuple[Cells, FloatArray, float, list[VelocityLimit]]:
    """Return cells, decelerations (N,) of stops in the cells, an averaging window [s], and the velocity limits.

    In cell k a stop may decelerate by b_k = min_i (a_i − |q″_i|x_k)/|q′_i|, with the largest x_k = ṡ² there, and does
    not brake harder than at its beginning. The stop ends before a person comes nearer than the clearance, or the robot
    is then so slow that a contact is harmless (`safe_ompl.motions.laws`, `.contact`). A cell that limits the speed is
    divided if motion within it costs more than the share `loss` of the remaining time. If the jerk is limited, this
    holds for a plan, and the motion is at most the window later than the plan (`.time_law`).

    Raises InputError if a person is within the clearance at the start of the robot; StandstillError if a cell allows no
    speed.
    """
    people, window = distances.people, 0.0
    for last in (False, True):
        bending = bending_velocity_limit(cells, limits)
        most = velocity_limit = np.minimum(joint_velocity_limit(cells, limits), bending)
        brakes = braking(cells, limits, velocity_limit)
        left = distances.along(
            motion, cells, bodies, _MOST_STOP_TIME_FACTOR * float(velocity_limit.max() / brakes.min())
        )
        # For each of K groups of limbs (M,), the limb that arrives first in each cell (N, K), and its time.
        rows = [np.flatnonzero(distances.alike == group) for group in range(int(distances.alike.max()) + 1)]
        first = np.stack([row[left.times[:, row].argmin(axis=1)] for row in rows], axis=1)
        times = np.take_along_axis(left.times, first, axis=1)
        harmless = np.ascontiguousarray(left.harmless[:, first[0]])
        if limits.jerk is not None:
            window = window or best_window(cells, limits, velocity_limit, times)
            smooth = SmoothLimits.of(cells, limits, velocity_limit, window, stops=True)
            most = smooth.cone(smooth.velocity_limit)
            brakes = np.minimum(braking(smooth.cells, limits, most), smooth.brakes)
            times = times - window
        ends = cells.last_before_stop
        allowed, group, where, slow = stopping_speeds(cells.sizes, brakes, times, harmless, most, ends)
        limb = np.where(group < 0, -1, first[where, group])
        if not last:
            cells = motion.between(divided_edges(cells.edges, _parts(cells, left, limb, where, loss)))
    m = int(left.distances[0].argmin())
    if left.distances[0, m] <= people.clearance and not people.contact:
        raise InputError(
            f"{_named(distances.limbs[m])} is {max(0.0, left.distances[0, m]) * 1e3:.1f} mm from the robot where it "
            f"starts: it must be more than the clearance of {people.clearance * 1e3:g} mm away"
        )
    for j in np.flatnonzero(allowed <= 0):
        raise StandstillError(_standstill(motion, cells, int(where[j]), int(limb[j]), left, distances, window))
    caused = np.where(slow, np.where(left.clamped[where, limb], CLAMPING, CONTACT), SEPARATION)
    rules = (SEPARATION, CONTACT, CLAMPING) if people.contact else (SEPARATION,)
    found = [VelocityLimit(r, np.where((allowed < most) & (caused == r), allowed, np.inf)) for r in rules]
    return cells, brakes, window, [VelocityLimit("blends beside people", bending), *found]


def _parts(cells: Cells, left: SeparationBounds, limb: IntArray, where: IntArray, loss: float) -> IntArray:
    """Return into how many parts (N,) to divide cells, so that their lengths cost little of the remaining time."""
    parts: IntArray = np.ones(len(cells), dtype=np.intp)
    k, m = np.unique(np.stack([where, limb])[:, limb >= 0], axis=1)
    lost = left.lost[k, m]
    wanted = lost / (loss * np.maximum(left.times[k, m] + lost, _LEAST_TIME_LEFT))
    wanted = np.ceil(np.minimum(wanted, cells.sizes[k] / _LEAST_CELL_LENGTH)).astype(np.intp)
    np.maximum.at(parts, k, wanted)
    return parts


def _named(who: tuple[str, str]) -> str:
    person, limb = who
    return f"{person!r} ({limb})" if limb else repr(person)


def _standstill(
    motion: Motion, cells: Cells, k: int, m: int, left: SeparationBounds, distances: PeopleDistances, window: float
) -> Standstill:
    people, (person, limb) = distances.people, distances.limbs[m]
    link = distances.links[int(left.nearest[k, m])]
    nearer = 1e3 * distances.grown(m, people.reaction_time + window)
    s = float(cells.centres[k])
    way_out = f"let the {limb or 'body'} bear a contact" if people.contact else "allow contact"
    reason = (
        f"{_named(distances.limbs[m])} is {1e3 * max(left.distances[k, m], 0.0):.0f} mm from {link!r}, and may come "
        f"{nearer:.0f} mm nearer before it begins to brake, where {1e3 * people.clearance:.0f} mm must be left; keep "
        f"the path farther away, shorten the reaction time, or {way_out}"
    )
    return Standstill(s, motion.places(np.array([s])).q[0], reason, person, limb or None, link)
