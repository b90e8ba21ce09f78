"""Paths in cells with bounds of speed and braking, and time laws of one tick and a stop along a path.

Without a jerk limit s̈ is constant in each piece of a time law. With a jerk limit these are pieces of a
plan σ(t), and the robot is at

    s(t) = 1/w ∫ σ(τ) dτ,  τ from t − w to t,

so that s̈ is continuous and s⃛ bounded (`safe_ompl.motions.time_law`). A law then begins with what the plan did in the
window before it, and the next law goes on with that: nothing jumps between two ticks. The plan leaves no place more
than w before the robot does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray
from safe_ompl.live import ReachSets
from safe_ompl.live.replanning.hull_gaps import BodyHulls, MarginQuery
from safe_ompl.motions import (
    BRAKING,
    CLAMPING,
    CONTACT,
    CONTACT_RULES,
    LINK_SPEED,
    SEPARATION,
    TOOL_SPEED,
    BodySpeeds,
    Cells,
    ContactLimits,
    Motion,
    RateLimits,
    SmoothLimits,
    TimingLimits,
    Trajectory,
    bending_velocity_limit,
    body_speed_limits,
    braking,
    ceilings,
    drive,
    joint_velocity_limit,
)
from safe_ompl.robot import Robot

# Largest size of the cells of executed paths, and of paths for estimates.
STEP = 0.02  # [rad]
_ESTIMATE_CELL = 0.1  # [rad]
# The reduced speed of ISO 10218.
RETREAT_SPEED = 0.25  # [m/s]
# In estimates people are assumed to be at least this fast.
_LEAST_PERSON_SPEED = 0.01  # [m/s]
# Cells in which people limit the robot to less than this share of the full speed are barred.
_BARRED = 0.02
# Time horizon of estimates.
_AHEAD = 1.0  # [s]
# If this number of cells at an end of a path is barred, they are estimated again in small cells.
_ENDS = 2
# Largest errors of distances in estimates, and of exact margins.
_ROUGH_PRECISION = 5e-3  # [m]
_CLOSE = 1e-4  # [m]
# Arc lengths closer than this are treated as equal.
_EQUAL_PLACES = 1e-9  # [rad]
# Relative bound of the rounding errors of speeds.
_NEARLY = 1e-9
# Velocity limits of trajectories that the replanner computes itself at every tick.
_DERIVED = ("joint velocity", "blends beside people", *CONTACT_RULES)
# Contact is not allowed anywhere.
_NO_CONTACT: FloatArray = np.zeros((0, 0, 0))
_NOWHERE: FloatArray = np.zeros((0, 0))
# Share of the jerk limit that q‴ṡ³ may use.
REPLANNED_CURVE_JERK_SHARE = 0.3
# Averages over windows of at least this length are not affected by rounding.
_LEAST_CELL_TIME = 1e-4  # [s]


def line(start: FloatArray, end: FloatArray) -> Motion:
    """Return the straight path between two configurations (n,), by arc length."""
    step = end - start
    return Motion(np.array([0.0, np.linalg.norm(step)]), np.array([[start, step]]), timed=False)


class MotionMargin(NamedTuple):
    """The smallest margin between a motion of the robot and what moves around it."""

    # A lower bound of distance − growth − required clearance [m]. It is infinite if nobody is there.
    margin: float
    # The nearest link of the robot.
    link: str | None = None
    # The nearest person or object, and its limb.
    who: tuple[str, str] | None = None
    # The rule that applies to that person or object, one of `CONTACT_RULES`.
    rule: str = ""

    @property
    def description(self) -> str:
        """The person or object that is too near, the link, and the missing distance."""
        if self.link is None or self.who is None:
            return "not all people and moving objects have been observed"
        who, limb = self.who
        named = f"{limb} of {who!r}" if limb else repr(who)
        if self.rule == CLAMPING:
            return f"{named} may be clamped by {self.link} above the allowed contact speed"
        if self.rule == CONTACT:
            return f"{named} may touch {self.link} above the allowed contact speed"
        return f"{named} may come {np.ceil(-1e3 * self.margin):.0f} mm too near to {self.link} before the robot stops"


class Around(NamedTuple):
    """The reach sets around a robot at the beginning of a motion, and the distances that must be kept from them."""

    sets: ReachSets
    # How long ago the sets were measured [s], at least 0.
    since: float = 0.0
    # The distance that must remain [m].
    clearance: float = 0.0
    # The speeds at which contact is allowed, if it is.
    contact: ContactLimits | None = None


@dataclass(frozen=True)
class SpeedLimits:
    """Limits that hold for every path of the replanner, independent of its curve."""

    # Velocities and accelerations of the joints, and jerks if they are limited.
    joints: RateLimits
    # Limits for the tip, and for every point of every link [m/s].
    tool_speed: float | None = None
    link_speed: float | None = None

    def __post_init__(self) -> None:
        # This raises InputError if a limit is not a possible speed.
        TimingLimits(tool_speed=self.tool_speed, link_speed=self.link_speed)

    @classmethod
    def of(cls, trajectory: Trajectory) -> SpeedLimits:
        """Return the limits of a trajectory. Raises InputError if a limit is only proven on its own curve."""
        speeds = {limit.name: limit.point_speed for limit in trajectory.velocity_limits}
        for limit in trajectory.velocity_limits:
            if limit.point_speed is None and limit.name not in _DERIVED:
                raise InputError(
                    f"the limit {limit.name!r} is proven on the trajectory's own curve only: "
                    "time it without this limit",
                    "trajectory",
                )
        return cls(trajectory.limits, speeds.get(TOOL_SPEED), speeds.get(LINK_SPEED))

    def same_as(self, other: SpeedLimits) -> bool:
        """Return whether the other limits are equal to these."""
        mine, theirs = ((of.joints.as_dict(), of.tool_speed, of.link_speed) for of in (self, other))
        return mine == theirs


class CellFrames(NamedTuple):
    """N cells of a path: the frames of the m joints at their centres, and bounds of the motion of G bodies in them."""

    rotations: FloatArray  # (N, m, 3, 3)
    origins: FloatArray  # (N, m, 3) [m]
    travel: FloatArray  # (N, G) [m]


class RobotBodies:
    """The moving bodies of a robot, of `links`, as hulls in the frames of their joints, with balls about them.

    With a tube of widths (n,), each body is enlarged by the largest distance that the tube allows.
    """

    def __init__(self, robot: Robot, tube: Sequence[float] = ()) -> None:
        self.robot = robot
        joints, links = robot.bounds.body_corners[0], robot.shared.body_links
        self.moving = np.flatnonzero(joints).tolist()
        hulls = [robot.bounds.body_hulls[k] for k in self.moving]
        self.links = tuple(links[k] for k in self.moving)
        carriers = joints[self.moving] - 1
        first: IntArray = np.cumsum([0] + [len(hull.points) for hull in hulls]).astype(np.intp)
        middles = np.array([hull.points.mean(axis=0) for hull in hulls]).reshape(-1, 3)
        extents = [np.linalg.norm(h.points - c, axis=1).max() for h, c in zip(hulls, middles, strict=True)]
        wider = robot.bounds.displacement_radii[self.moving] @ (np.array(tube) if tube else np.zeros(robot.n))
        self.hulls = BodyHulls(
            carriers,
            np.ascontiguousarray(np.concatenate([np.zeros((0, 3)), *(hull.points for hull in hulls)])),
            first,
            np.array([hull.radius for hull in hulls]) + wider,
            middles,
            np.array(extents),
        )
        self._first_axis = robot.joint_frames(np.zeros((1, robot.n)))[2][0, 0]
        self.speeds = BodySpeeds(robot)  # bodies and tip

    def frames(self, Q: FloatArray, travel: FloatArray = _NOWHERE) -> CellFrames:
        """Return the frames of the joints at `Q: (B, n)` with bounds `travel` (B, G) of the motion of bodies [m]."""
        return CellFrames(*self.robot.joint_frames(Q)[:2], travel)

    def vertices(self, body: int, frames: CellFrames) -> FloatArray:
        """Return the vertices (B, V, 3) of a body in the world [m], in these frames of the joints."""
        joint, (first, last) = self.hulls.carriers[body], self.hulls.first_vertex[body : body + 2]
        turned = np.einsum("bxy,vy->bvx", frames.rotations[:, joint], self.hulls.vertices[first:last])
        return np.asarray(turned + frames.origins[:, joint, None])

    @cached_property
    def turning(self) -> BoolArray:
        """Mask (G,) of the moving bodies that only rotate about the axis of the first joint."""
        return np.asarray((self.hulls.carriers == 0) & ~self.robot.shared.chain.prismatic[0])

    def swept(self, body: int, frames: CellFrames, axes: FloatArray) -> FloatArray:
        """Return by how much (K,) [m] a rotating body may advance against `axes: (K, 3)` at any angle."""
        vertices, turn = self.vertices(body, frames)[0], self._first_axis
        arms = vertices - frames.origins[0, 0]
        along, heights = arms @ turn, axes @ turn
        radii = np.sqrt(np.maximum((arms * arms).sum(axis=1) - along * along, 0.0))
        across = np.sqrt(np.maximum(1.0 - heights * heights, 0.0))
        nearest = (np.outer(along, heights) - np.outer(radii, across)).min(axis=0)
        return np.asarray((arms @ axes.T).min(axis=0) - nearest)


def averaging_window(limits: RateLimits) -> float:
    """Return about the window w [s] with which a joint stops soonest; 0 if the jerk is not limited.

    With the jerk limit J and the shares K, a plan may brake with K J w. A stop from v takes v/(K J w) + w. Braking is
    also limited by the acceleration a.
    """
    if limits.jerk is None:
        return 0.0
    of_plan = BRAKING * (1 - REPLANNED_CURVE_JERK_SHARE) * limits.jerk
    windows = np.minimum(np.sqrt(limits.velocity / of_plan), limits.acceleration / of_plan)
    return max(float(windows.max()), _LEAST_CELL_TIME)


class StopLaw(NamedTuple):
    """A motion of one tick along a path, and the stop after it: W pieces of constant acceleration.

    With a `window` [s] the pieces are those of the plan. They begin a window before the motion, at negative times.
    """

    # The cell of the path in which each piece lies (W,).
    cells: IntArray
    # The values of s, ṡ² and the time since the motion began [s] where pieces meet (W + 1, 3).
    places: FloatArray
    squared_speeds: FloatArray
    times: FloatArray
    window: float = 0.0

    @property
    def duration(self) -> float:
        """Duration until the robot stands [s]."""
        return float(self.times[-1]) + self.window

    def at(self, time: float) -> tuple[float, float, float]:
        """Return s, ṡ and s̈ at a time since the motion began [s]; after its end the robot is at rest."""
        if time >= self.duration:
            return float(self.places[-1]), 0.0, 0.0
        now = max(time, 0.0)
        if self.window:
            ends = self._plan(np.array([now - self.window, now]))
            place, speed, acceleration = (float(values[1] - values[0]) / self.window for values in ends)
            return min(max(place, 0.0), float(self.places[-1])), max(speed, 0.0), acceleration
        k = max(int(np.searchsorted(self.times, time, side="right")) - 1, 0)
        span, since = self.times[k + 1] - self.times[k], now - self.times[k]
        speed, after = np.sqrt(self.squared_speeds[k]), np.sqrt(self.squared_speeds[k + 1])
        acceleration = (after - speed) / span if span > 0 else 0.0
        place = self.places[k] + since * (speed + 0.5 * since * acceleration)
        return float(min(place, self.places[k + 1])), float(max(speed + since * acceleration, 0.0)), float(acceleration)

    def _plan(self, at: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return ∫σ since the first time, σ and σ̇, each (T,), at times (T,)."""
        speeds, spans = np.sqrt(self.squared_speeds), np.diff(self.times)
        areas = np.cumsum(spans * (self.places[:-1] + spans * (2 * speeds[:-1] + speeds[1:]) / 6))
        k = np.clip(np.searchsorted(self.times, at, side="right") - 1, 0, len(spans) - 1)
        since = np.clip(at - self.times[k], 0.0, spans[k])
        acceleration = np.diff(speeds)[k] / np.where(spans[k] > 0, spans[k], 1.0)
        place = self.places[k] + since * (speeds[k] + since * acceleration / 2)
        area = np.append(0.0, areas)[k] + since * (self.places[k] + since * (speeds[k] / 2 + since * acceleration / 6))
        after = np.maximum(at - self.times[-1], 0.0)  # it stands
        return area + after * self.places[-1], place, np.where(after > 0, 0.0, speeds[k] + since * acceleration)

    def past(self, time: float) -> StopLaw:
        """Return the plan in the window before a time. Times are shifted so that this time is 0."""
        between = (self.times > time - self.window) & (self.times < time)
        times = np.concatenate([[time - self.window], self.times[between], [time]])
        _, (first, last), ends = self._plan(times[[0, -1]])
        begin, end = np.square(ends)
        k = np.searchsorted(self.times, (times[1:] + times[:-1]) / 2, side="right") - 1
        return StopLaw(
            self.cells[np.clip(k, 0, len(self.cells) - 1)],
            np.concatenate([[first], self.places[between], [last]]),
            np.concatenate([[begin], self.squared_speeds[between], [end]]),
            times - time,
            self.window,
        )

    def visits(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return the cells (V,) that the robot visits, their last times [s], and bounds of ṡ² there."""
        fastest = np.maximum(self.squared_speeds[:-1], self.squared_speeds[1:])
        if not self.window:
            return self.cells, self.times[1:], fastest
        ahead = self.places[1:] > self.at(0.0)[0]
        first, last = self.times[:-1] - self.window, self.times[1:] + self.window
        near = (self.times[:-1] <= last[ahead, None]) & (self.times[1:] >= first[ahead, None])
        return self.cells[ahead], last[ahead], np.where(near, fastest, 0.0).max(axis=1, initial=0.0)


@dataclass(frozen=True)
class BoundedPath:
    """A curve divided into cells, with bounds of ṡ² and |s̈| in each cell, so that the joints stay within their limits.

    With a jerk limit these are the bounds of a plan; see `StopLaw`.
    """

    bodies: RobotBodies  # The robot's
    # The path, which is proven among still obstacles.
    curve: Motion
    # The limits that motions on the path keep.
    limits: SpeedLimits
    cells: Cells  # The N cells
    # Bounds X of ṡ² in the cells (N,).
    squared_limits: FloatArray
    # Bounds b of |s̈| in the cells (N,). |q′|b + |q″|X is within the accelerations of the joints.
    brakes: FloatArray
    # The joint frames at the centres of the cells, and how far bodies move from there.
    frames: CellFrames
    # What time laws keep in these cells if the jerk is limited.
    smooth: SmoothLimits | None = None
    # What `_borne` knows of these cells, at whatever speeds; NaN in cells that it was not asked for
    contacts: dict[ContactLimits, tuple[FloatArray, FloatArray]] = field(default_factory=dict)

    @classmethod
    def along(
        cls,
        bodies: RobotBodies,
        curve: Motion,
        limits: SpeedLimits,
        step: float = STEP,
        corner_limit: Callable[[Cells, RateLimits], FloatArray] = bending_velocity_limit,
    ) -> BoundedPath:
        """Return the path along a curve, in cells no longer than a step [rad]; ṡ is at most `corner_limit` (N,)."""
        cells, joints = curve.cells(step), limits.joints
        speeds = np.minimum(joint_velocity_limit(cells, joints), corner_limit(cells, joints))
        of_bodies = bodies.speeds.bounds(curve, cells)
        for limit in body_speed_limits(of_bodies, limits.tool_speed, limits.link_speed):
            speeds = np.minimum(speeds, limit.speeds)
        travel = np.ascontiguousarray(of_bodies[:, bodies.moving] * cells.sizes[:, None] / 2)
        frames = bodies.frames(curve.at(cells.centres), travel)
        smooth = None
        if joints.jerk is not None:
            smooth = SmoothLimits.of(
                cells, joints, speeds, averaging_window(joints), stops=True, share=REPLANNED_CURVE_JERK_SHARE
            )
            speeds = smooth.cone(smooth.velocity_limit)
        brakes = _brakes(cells, joints, speeds, smooth)
        return cls(bodies, curve, limits, cells, speeds * speeds, brakes, frames, smooth)

    def __repr__(self) -> str:
        return f"BoundedPath({self.length:.3g} rad, {len(self.brakes)} cells)"

    @property
    def edges(self) -> FloatArray:
        """Ends (N + 1,) of the cells [rad]."""
        return self.cells.edges

    @property
    def length(self) -> float:
        """Arc length [rad]."""
        return float(self.edges[-1])

    @cached_property
    def ceiling(self) -> FloatArray:
        """The largest ṡ² (N + 1,) at the ends of the cells from which all stops are reached."""
        return np.asarray(ceilings(self.cells.sizes, self.squared_limits, self.brakes, self.cells.stops))

    @cached_property
    def accelerations(self) -> FloatArray:
        """Bounds (N, G) of ‖x″‖ of all points of the moving bodies [m/rad²]."""
        return np.asarray(self.bodies.speeds.accelerations(self.cells)[:, self.bodies.moving])

    def prepare(self) -> None:
        """Compute the values that retreats need before a command is due."""
        _ = self.accelerations, self._slow, self.ceiling

    @cached_property
    def _slow(self) -> FloatArray:
        """The largest ṡ² (N, G) at which no point of the bodies is faster than `RETREAT_SPEED`."""
        bodies = 2 * self.frames.travel / np.diff(self.edges)[:, None]
        return np.asarray(np.square(RETREAT_SPEED / np.maximum(bodies, 1e-9)))

    @cached_property
    def coarse(self) -> BoundedPath:
        """The same path in large cells, for estimates."""
        return BoundedPath.along(self.bodies, self.curve, self.limits, _ESTIMATE_CELL)

    @cached_property
    def fine(self) -> BoundedPath:
        """The same path in cells that are not larger than the cells of paths that are executed."""
        short = np.diff(self.edges).max() <= STEP * (1 + 1e-9)
        return self if short else BoundedPath.along(self.bodies, self.curve, self.limits)

    def slowed(self, speeds: FloatArray, hardest: float) -> BoundedPath:
        """Return the same path with ṡ bounded by `speeds: (N,)`; cached results on contacts are shared.

        |s̈| is bounded by the joints' limits at these speeds and by `hardest`.
        """
        brakes = _brakes(self.cells, self.limits.joints, speeds, self.smooth)
        return replace(self, squared_limits=speeds * speeds, brakes=np.minimum(brakes, hardest))

    def motion_from(self, s: float, square: float, share: float, tick: float, past: StopLaw | None = None) -> StopLaw:
        """Return the motion of a tick [s] from (s, ṡ²) and its stop; s̈ is `share`, from −1 to 1, times the `brakes`.

        With a jerk limit the plan continues from its `past` along this path, and accelerates less than it brakes.
        """
        grid = self.edges, self.squared_limits, self.brakes, self.ceiling
        if self.limits.joints.jerk is None:
            return StopLaw(*drive(*grid, s, square, share, tick))
        past = self.past(s, float(np.sqrt(square))) if past is None else past
        here, now = float(past.places[-1]), float(past.squared_speeds[-1])
        share = min(share, share * (1 - BRAKING) / BRAKING)
        cells, places, squared_speeds, times = drive(*grid, here, now, share, tick)
        # In a corner the plan waits until the robot stands, and then for the next tick.
        corner = np.abs(places[:, None] - self.edges[self.cells.stops]).min(axis=1, initial=np.inf) < _EQUAL_PLACES
        waits = corner & (squared_speeds == 0.0)
        waits[0] &= past.places[0] < here - _EQUAL_PLACES
        end = int(np.flatnonzero(waits)[0]) if waits.any() else len(cells)
        return StopLaw(
            np.append(self._cells_at(past.places), cells[:end]),
            np.append(past.places, places[1 : end + 1]),
            np.append(past.squared_speeds, squared_speeds[1 : end + 1]),
            np.append(past.times, times[1 : end + 1]),
            past.window,
        )

    def past(self, s: float, speed: float, acceleration: float = 0.0) -> StopLaw:
        """Return the plan of constant s̈ = `acceleration` with the robot at s and ṡ; |s̈| is at most 2 ṡ/w."""
        window = averaging_window(self.limits.joints)
        now = max(speed + acceleration * window / 2, 0.0)
        here = s + speed * window / 2 + acceleration * window * window / 12
        first = here - window * (now - acceleration * window / 2)
        inside = self.edges[(first < self.edges) & (self.edges < here)]
        places = np.concatenate([[first], inside, [here]])
        squared_speeds = np.maximum(now * now + 2 * acceleration * (places - here), 0.0)
        both = np.sqrt(squared_speeds) + now
        times = np.divide(2 * (places - here), both, out=np.zeros(len(places)), where=both > 0)
        times[0] = -window
        return StopLaw(self._cells_at(places), places, squared_speeds, times, window)

    def _cells_at(self, places: FloatArray) -> IntArray:
        """Return the cells (W,) between places (W + 1,)."""
        middles = (places[1:] + places[:-1]) / 2
        return np.asarray(np.clip(np.searchsorted(self.edges, middles) - 1, 0, len(self.brakes) - 1))

    def admits(self, speed: float, acceleration: float = 0.0) -> bool:
        """Return whether the robot may begin with ṡ and s̈; s̈ is only used if the jerk is limited."""
        square, here, cells = speed * speed, 0.0, np.zeros(1, dtype=np.intp)
        if self.limits.joints.jerk is not None:
            past = self.past(0.0, speed, acceleration)
            square, here, cells = float(past.squared_speeds.max()), float(past.places[-1]), past.cells
            low, high = -self.brakes[cells].min(), self.brakes[cells].min() * (1 - BRAKING) / BRAKING
            if not low * (1 + _NEARLY) <= acceleration <= high * (1 + _NEARLY):
                return False
        k = int(cells[-1])
        most = self.ceiling[k + 1] + 2 * self.brakes[k] * (self.edges[k + 1] - here)
        return bool(min(self.squared_limits[cells].min(), most) >= square * (1 - _NEARLY))

    def margin(
        self, motion: StopLaw, around: Around, *, exact: bool = False, receding: BoolArray | None = None
    ) -> MotionMargin:
        """Return the smallest margin along a motion on this path; see `BodyHulls.gaps`.

        An exact margin has an error below 0.1 mm. Else only the sign is exact; the first negative margin is returned.
        Where contact is allowed, who bears it at the speed of the motion need not be kept from; nor need those from
        whom a body is `receding: (G, M)`, no faster than `RETREAT_SPEED`.
        """
        sets, since, clearance, contact = around
        # Whether contact matters costs less to find out than which speeds it allows.
        if contact is not None and not exact:
            alone = self.margin(motion, around._replace(contact=None), receding=receding)
            if alone.margin >= 0:
                return alone
        cells, times, fastest = motion.visits()
        enough, close = (np.inf, _CLOSE) if exact else (0.0, 0.0)
        most = _NO_CONTACT if contact is None else self._borne(contact, cells)[0]
        if receding is not None:
            rows = np.unique(cells)  # other rows are unused
            known = most
            most = np.empty((len(self.brakes), *receding.shape))
            most[rows] = np.where(receding, self._slow[rows][:, :, None], -1.0)
            if len(known):
                bears = known.shape[2]
                most[rows, :, :bears] = np.maximum(known[rows], most[rows, :, :bears])
        query = MarginQuery(clearance, enough, close, not exact)
        found = self.bodies.hulls.gaps(cells, since + times, (fastest, most), self.frames, sets.arrays, query)
        margin, window, body, who = found
        if body < 0:
            return MotionMargin(np.inf)
        rule = SEPARATION
        if contact is not None and who < len(contact.bears) and contact.bears[who] > 0:
            at = cells[window], body, who
            most, free = self._borne(contact, cells)
            rule = CLAMPING if most[at] < free[at] else CONTACT
        return MotionMargin(float(margin), self.bodies.links[body], sets.names[who], rule)

    def _borne(self, contact: ContactLimits, at: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the largest ṡ² (N, G, M) at which contact is harmless, with and without clamping, in cells (W,)."""
        if contact not in self.contacts:
            unknown = np.full((len(self.brakes), self.frames.travel.shape[1], len(contact.limbs)), np.nan)
            self.contacts[contact] = unknown, unknown.copy()
        most, free = self.contacts[contact]
        new = np.unique(at[np.isnan(most[at, 0, 0])]) if most.size else at[:0]
        if len(new):
            sizes = self.edges[new + 1] - self.edges[new]
            Q = self.curve.at(self.edges[new] + 0.5 * sizes)
            bodies = 2 * self.frames.travel[new] / sizes[:, None]
            most[new], free[new] = np.square(contact.speeds(Q, sizes, self.cells.dq_ds[new], bodies))
        return most, free

    def pace(self, around: Around, tick: float) -> tuple[FloatArray, float]:
        """Estimate the time (N,) [s] of each cell among people at their present positions, and how long it holds [s].

        If people need a time τ to reach a cell, the robot must be able to stop there within τ − T. T is the time from
        the measurement until the robot brakes, one tick [s] later. A cell that allows less than 1/50 of the full speed
        is blocked (inf). The times hold until somebody can be so near that a cell takes longer; the second value is 0
        if this is already so. If contact is allowed, the speed need not be lower than the contact speed tolerated
        without clamping. The estimate only compares paths; `margin` proves the motions that are executed.
        """
        times, left = self._cell_times(around, tick)
        barred = np.isinf(times)
        if not barred.any() or barred[_ENDS:-_ENDS].any() or self.fine is self:
            return times, left
        # A robot that stands near something leaves it in cells that are shorter than the distance.
        fine = self.fine
        sums = np.zeros(len(times))
        inside = np.searchsorted(self.edges, 0.5 * (fine.edges[1:] + fine.edges[:-1])) - 1
        np.add.at(sums, inside, fine._cell_times(around, tick)[0])
        return np.where(barred, sums, times), left

    def _cell_times(self, around: Around, tick: float) -> tuple[FloatArray, float]:
        """Return the result of `pace` for the bounds of these cells only."""
        sets, since, clearance, contact = around
        reaction = tick + since
        full = np.sqrt(self.squared_limits)
        speeds, left = full, _AHEAD
        if len(sets.names):
            needed = reaction + full / self.brakes
            longest = float(needed.max())
            grown = sets.grown(longest) - sets.grown(0.0)
            fastest = max(float(grown.max()) / longest, _LEAST_PERSON_SPEED)
            far = fastest * (longest + _AHEAD)
            arrays = self.frames, sets.arrays, clearance, far, _ROUGH_PRECISION
            cells, no = np.arange(len(self.brakes)), np.zeros(len(self.brakes))
            margins = self.bodies.hulls.cell_gaps(cells, (no, _NO_CONTACT), *arrays)
            left = max(0.0, float((margins / fastest - needed).min()))
            speeds = self.brakes * (margins / fastest - reaction)
            if contact is not None and (speeds < full).any() and contact.bears.any():
                touched = contact.bears > 0
                bodies = 2 * self.frames.travel.max(axis=1) / np.diff(self.edges)
                shape = len(cells), self.frames.travel.shape[1], len(touched)
                most = np.broadcast_to(np.where(touched, np.inf, -1.0), shape)
                others = self.bodies.hulls.cell_gaps(cells, (no, np.ascontiguousarray(most)), *arrays)
                slow = contact.bears[touched].min() / np.maximum(bodies, 1e-9)
                speeds = np.minimum(np.maximum(speeds, slow), self.brakes * (others / fastest - reaction))
            speeds = np.minimum(full, speeds)
        barred = speeds < _BARRED * full
        return np.where(barred, np.inf, np.diff(self.edges) / np.where(barred, 1.0, speeds)), left

    def from_to(self, first: float, last: float) -> BoundedPath:
        """Return the path between two arc lengths; it begins at the start of the piece that contains the first one."""
        begin = float(self.curve.times[self.curve.piece_at(np.array([first]))[0]])
        a = int(np.searchsorted(self.edges, begin - _EQUAL_PLACES))
        b = max(int(np.searchsorted(self.edges, last - _EQUAL_PLACES)), a + 1)
        curve, edges = self.curve.part(begin, last), np.append(self.edges[a:b], last) - begin
        frames = CellFrames(*(part[a:b] for part in self.frames))
        return self._on(curve, edges, self.squared_limits[a:b], self.brakes[a:b], frames)

    def then(self, other: BoundedPath) -> BoundedPath:
        """Return this path and, after a stop at its end, another one that begins there."""
        return self._on(
            self.curve.then(other.curve),
            np.concatenate([self.edges, self.length + other.edges[1:]]),
            np.concatenate([self.squared_limits, other.squared_limits]),
            np.concatenate([self.brakes, other.brakes]),
            CellFrames(*map(np.concatenate, zip(self.frames, other.frames, strict=True))),
        )

    def _on(
        self, curve: Motion, edges: FloatArray, squared_limits: FloatArray, brakes: FloatArray, frames: CellFrames
    ) -> BoundedPath:
        """Return a path with the same limits along a curve, with given bounds in the cells between the edges."""
        return BoundedPath(self.bodies, curve, self.limits, curve.between(edges), squared_limits, brakes, frames)


def _brakes(cells: Cells, joints: RateLimits, speeds: FloatArray, smooth: SmoothLimits | None) -> FloatArray:
    """Return bounds (N,) of |s̈| in cells, at ṡ of `speeds: (N,)`."""
    if smooth is None:
        return braking(cells, joints, speeds)
    return np.asarray(np.minimum(braking(smooth.cells, joints, speeds), smooth.brakes))
