"""Caps of the speed along a motion, proven over whole cells: people, and the speeds of tool and links."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.common import RATE_BOUNDS, BoolArray, FloatArray, InputError, IntArray, SafeOmplError, number
from safe_ompl.danger import KinetostaticField
from safe_ompl.motions.cells import BodySpeeds, Cells, divided_edges
from safe_ompl.motions.contact import CLAMPING, CONTACT, SEPARATION
from safe_ompl.motions.laws import stopping_speeds
from safe_ompl.motions.limits import RateLimits
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.separation import PeopleDistances, SeparationBounds
from safe_ompl.motions.time_law import SmoothLimits, best_window, velocity_cap
from safe_ompl.motions.trajectory import SpeedCap
from safe_ompl.scene import People

TOOL_SPEED, LINK_SPEED = "tool speed", "link speed"  # names of caps
BENDING = 0.5  # share of the accelerations (and jerks) that blends may take beside people; the rest is for braking
_INSTANT = 0.005  # [s] times shorter than this count as this
_FINEST = 1e-3  # [rad] no cell is divided into smaller ones
_SOON = 3.0  # stops take no longer than this times that of constant deceleration


@dataclass(frozen=True)
class MotionCaps:
    """What bounds the speed of trajectories besides the limits of the joints; see `PathTimer`."""

    people: People | None = None
    tool_speed: float | None = None
    link_speed: float | None = None
    danger: KinetostaticField | None = None
    max_danger: float | None = None

    def __post_init__(self) -> None:
        if (self.danger is None) != (self.max_danger is None):
            raise InputError(
                "give a danger and the largest that it may reach, or neither",
                "danger" if self.danger is None else "max_danger",
            )
        for key, name in (("tool_speed", TOOL_SPEED), ("link_speed", LINK_SPEED)):
            if (value := getattr(self, key)) is not None:
                object.__setattr__(self, key, number(name, value, kind="number of m/s", **RATE_BOUNDS["speed"]))
        if self.max_danger is not None:
            object.__setattr__(self, "max_danger", number("max_danger", self.max_danger, above=0.0))


@dataclass(frozen=True)
class Standstill:
    """Where the robot may not move at any speed: arc length [rad], configuration (n,), and what forbids it."""

    arc_length: float
    configuration: FloatArray
    reason: str
    person: str | None = None
    limb: str | None = None
    link: str | None = None


class StandstillError(SafeOmplError):
    """No speed along a path is allowed somewhere; `standstill` says where and why."""

    def __init__(self, standstill: Standstill) -> None:
        super().__init__(
            f"nothing allows the robot to move at {standstill.arc_length:.3f} rad of its path: {standstill.reason}"
        )
        self.standstill = standstill

    def __reduce__(self) -> tuple[type[StandstillError], tuple[Standstill]]:
        return type(self), (self.standstill,)


def people_caps(
    motion: Motion, cells: Cells, bodies: BodySpeeds, limits: RateLimits, distances: PeopleDistances, loss: float
) -> tuple[Cells, FloatArray, float, list[SpeedCap]]:
    """Return cells as fine as it takes, decelerations (N,) that stops take there, a window [s], and the caps.

    A stop may decelerate by b_k = min_i (a_i − |q″_i|x_k)/|q′_i| in cell k, with the largest x_k = ṡ² there, and does
    not brake harder than it began. It ends before a person comes nearer than the clearance, or the robot is then so
    slow that a contact is harmless (`safe_ompl.motions.laws`, `.contact`). A cell that bounds the speed is
    divided if motion within it costs more than the share `loss` of the time that is left. With a limit of the jerk all
    this is said of a plan, than which the motion is later by the window at most (`.time_law`).

    An InputError if somebody is within the clearance where the robot starts; a StandstillError if a cell allows no
    speed.
    """
    people, window = distances.people, 0.0
    for last in (False, True):
        bending = bending_cap(cells, limits)
        most = caps = np.minimum(velocity_cap(cells, limits), bending)
        brakes = braking(cells, limits, caps)
        speeds = bodies.bounds(motion, cells)
        left = distances.along(motion, cells, speeds, _SOON * float(caps.max() / brakes.min()))
        harmless, clamps = harmless_rates(motion, cells, speeds, distances)
        # Of each of K groups of limbs (M,) which one comes first in each cell (N, K), and when
        rows = [np.flatnonzero(distances.alike == group) for group in range(int(distances.alike.max()) + 1)]
        first = np.stack([row[left.times[:, row].argmin(axis=1)] for row in rows], axis=1)
        times = np.take_along_axis(left.times, first, axis=1)
        harmless = np.ascontiguousarray(harmless[:, first[0]])
        if limits.jerk is not None:
            window = window or best_window(cells, limits, caps, times)
            smooth = SmoothLimits.of(cells, limits, caps, window, stops=True)
            most = smooth.cone(smooth.caps)
            brakes = np.minimum(braking(smooth.cells, limits, most), smooth.brakes)
            times = times - window
        ends = next_stops(cells)
        allowed, group, where, slow = stopping_speeds(cells.sizes, brakes, times, harmless, most, ends)
        limb = np.where(group < 0, -1, first[where, group])
        if not last:
            parts = _parts(cells, speeds, left, limb, where, distances, loss)
            cells = motion.between(divided_edges(cells.edges, parts))
    m = int(left.distances[0].argmin())
    if left.distances[0, m] <= people.clearance and not people.contact:
        raise InputError(
            f"{_named(distances.limbs[m])} is {max(0.0, left.distances[0, m]) * 1e3:.1f} mm from the robot where it "
            f"starts: it must be more than the clearance of {people.clearance * 1e3:g} mm away"
        )
    for j in np.flatnonzero(allowed <= 0):
        raise StandstillError(_standstill(motion, cells, int(where[j]), int(limb[j]), left, distances, window))
    caused = np.where(slow, np.where(clamps[where, limb], CLAMPING, CONTACT), SEPARATION)
    rules = (SEPARATION, CONTACT, CLAMPING) if people.contact else (SEPARATION,)
    found = [SpeedCap(r, np.where((allowed < most) & (caused == r), allowed, np.inf)) for r in rules]
    return cells, brakes, window, [SpeedCap("bends beside people", bending), *found]


def next_stops(cells: Cells) -> IntArray:
    """Return for each cell (N,) the last one before the robot stops in any case."""
    stops = np.append(cells.stops, len(cells))
    return np.asarray(stops[np.searchsorted(stops, np.arange(len(cells)), side="right")] - 1)


def _parts(
    cells: Cells,
    speeds: FloatArray,
    left: SeparationBounds,
    limb: IntArray,
    where: IntArray,
    distances: PeopleDistances,
    loss: float,
) -> IntArray:
    """Return into how many parts (N,) to divide cells, so that motion within them costs little of the time left."""
    parts: IntArray = np.ones(len(cells), dtype=np.intp)
    k, m = np.unique(np.stack([where, limb])[:, limb >= 0], axis=1)
    speed = distances.speeds[m]
    moved = speeds[k, left.nearest[k, m]] * cells.sizes[k] / 2
    lost = np.divide(moved, speed, out=np.zeros(len(k)), where=speed > 0)
    wanted = lost / (loss * np.maximum(left.times[k, m] + lost, _INSTANT))
    wanted = np.ceil(np.minimum(wanted, cells.sizes[k] / _FINEST)).astype(np.intp)
    np.maximum.at(parts, k, wanted)
    return parts


def bending_cap(cells: Cells, limits: RateLimits) -> FloatArray:
    """Return the largest ṡ (N,) with which blends take half of the accelerations; the rest is left for braking."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.sqrt((BENDING * limits.acceleration / cells.bends).min(axis=1)))


def braking(cells: Cells, limits: RateLimits, speeds: FloatArray) -> FloatArray:
    """Return the deceleration along the path (N,) [rad/s²] that the accelerations leave at ṡ of `speeds: (N,)`."""
    rest = limits.acceleration - cells.bends * (speeds * speeds)[:, None]
    slopes = cells.slopes
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(slopes > 0, rest / slopes, np.inf).min(axis=1))


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


def harmless_rates(
    motion: Motion, cells: Cells, speeds: FloatArray, distances: PeopleDistances
) -> tuple[FloatArray, BoolArray]:
    """Return the ṡ (N, M) with which a contact is harmless whatever body touches, and where clamping decides that."""
    shape = len(cells), len(distances.limbs)
    if distances.contact is None:
        return np.zeros(shape), np.zeros(shape, dtype=bool)
    moving = speeds[:, distances.moving]
    found, free = distances.contact.speeds(motion.at(cells.centres), cells.sizes, cells.slopes, moving)
    return found.min(axis=1), found.min(axis=1) < free.min(axis=1)


def speed_caps(speeds: FloatArray, tool_speed: float | None, link_speed: float | None) -> tuple[SpeedCap, ...]:
    """Return the caps that keep the tip, and all points of all bodies, below speeds [m/s]; `speeds` of `BodySpeeds`."""
    caps = []
    for name, limit, bound in ((TOOL_SPEED, tool_speed, speeds[:, -1]), (LINK_SPEED, link_speed, speeds.max(axis=1))):
        if limit is not None:
            with np.errstate(divide="ignore"):
                caps.append(SpeedCap(name, np.where(bound > 0, limit / bound, np.inf), limit))
    return tuple(caps)
