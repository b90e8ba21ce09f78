"""From a path to a trajectory: blends, caps of the speed, and the fastest law within them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.danger.kinetostatic import KinetostaticField
from safe_ompl.errors import InputError
from safe_ompl.inputs import number
from safe_ompl.robot.robot import Robot
from safe_ompl.scenario.people import People
from safe_ompl.trajectories.blends import blended
from safe_ompl.trajectories.body_speeds import BodySpeeds
from safe_ompl.trajectories.caps import Standstill, StandstillError, people_caps, speed_caps
from safe_ompl.trajectories.curve import BlendedCurve, Cells
from safe_ompl.trajectories.danger import DangerCap, MovingDanger, danger_cap
from safe_ompl.trajectories.limits import RateLimits
from safe_ompl.trajectories.separation import PeopleDistances
from safe_ompl.trajectories.time_law import TimeLaw, fastest_law, velocity_cap
from safe_ompl.trajectories.trajectory import SpeedCap, Trajectory

BLEND_TOLERANCE = 0.05  # [rad] of blends
_STEP = 0.02  # [rad] largest cell
_CELLS = 400  # at least, on the whole path


def time_path(
    path: ArrayLike,
    robot: Robot,
    limits: RateLimits | None = None,
    *,
    motion: CertifiedMotion | None = None,
    tolerance: float = BLEND_TOLERANCE,
    people: People | None = None,
    tool_speed: float | None = None,
    link_speed: float | None = None,
    danger: KinetostaticField | None = None,
    max_danger: float | None = None,
) -> Trajectory:
    """Return the fastest trajectory along a path that keeps its limits at every instant.

    Parameters
    ----------
    path : array_like, shape (N, n)
        Way points, such as those of `PlanResult.path`; straight motions between them.
    robot : Robot
        The robot.
    limits : RateLimits, optional
        Joint velocities and accelerations; default: `RateLimits.of(robot)`.
    motion : CertifiedMotion, optional
        What proves the arcs that round the corners. Without it the robot stops in every corner.
    tolerance : float
        How far arcs may be from the path [rad].

    people : People, optional
        Who may come near: nowhere is the robot faster than what is proven to stop in time before she touches it.
        Needs `motion`, whose scene says where people are.
    tool_speed, link_speed : float, optional
        Largest speed of the tip, and of any point of any link [m/s].
    danger : KinetostaticField, optional
        The danger of the robot in motion, such as `DangerField(...).moving`, and
    max_danger : float, optional
        the largest that it may reach anywhere.

    Raises
    ------
    StandstillError
        If people, or the danger, allow no speed somewhere; says where, who, which link and what would have to change.
    InputError
        If only one of `danger` and `max_danger` is given, or the limit is not positive.
        If somebody touches the robot where it starts; if a speed is not positive; if the path has fewer than two way
        points, is not finite, does not move or leaves the joint limits; if limits are missing or of other joints; if
        the tolerance is negative.
    """
    points = checked_path(path, robot)
    limits = RateLimits.of(robot) if limits is None else limits
    if limits.joint_names != robot.joint_names:
        raise InputError(
            f"the limits are for the joints {limits.joint_names}, the robot's are {robot.joint_names}"
        )
    curve = blended(points, robot, number("tolerance", tolerance, at_least=0.0), motion)
    step = min(_STEP, curve.length / _CELLS)
    cells, brakes = curve.cells(step), None
    caps: list[SpeedCap] = []
    bodies = BodySpeeds(robot)
    if people is not None:
        if motion is None:
            raise InputError("give a motion: its scene says where people are", "motion")
        distances = PeopleDistances(robot, motion.checker.scene, people)
        cells, brakes, caps = people_caps(curve, cells, bodies, limits, distances)
    caps = [SpeedCap("joint velocity", velocity_cap(cells, limits)), *caps]
    if tool_speed is not None or link_speed is not None:
        speeds = bodies.bounds(curve, cells)
        caps += speed_caps(speeds, _speed("tool speed", tool_speed), _speed("link speed", link_speed))
    if danger is not None or max_danger is not None:
        most = np.min([cap.speeds for cap in caps], axis=0)
        found = _danger_cap(curve, cells, danger, max_danger, most)
        cells, caps = found.cells, [SpeedCap(cap.name, cap.speeds[found.parents]) for cap in caps]
        brakes = None if brakes is None else brakes[found.parents]
        caps.append(SpeedCap("danger", np.where(found.speeds < most[found.parents], found.speeds, np.inf)))
    squares = fastest_law(cells, limits, np.min([cap.speeds for cap in caps], axis=0))
    return Trajectory(curve, TimeLaw.through(cells.edges, squares), limits, tuple(caps), brakes, people)


def _danger_cap(
    curve: BlendedCurve,
    cells: Cells,
    danger: KinetostaticField | None,
    max_danger: float | None,
    most: FloatArray,
) -> DangerCap:
    if danger is None or max_danger is None:
        raise InputError(
            "give a danger and the largest that it may reach, or neither",
            "danger" if danger is None else "max_danger",
        )
    limit = number("max_danger", max_danger, above=0.0)
    found = danger_cap(curve, cells, MovingDanger(danger), limit, most)
    for j in np.flatnonzero(found.speeds <= 0):
        s = float(found.cells.centres[j])
        q = curve.at(np.array([s])).q[0]
        still = danger.field.value(q)
        reason = (
            f"the danger of the robot at rest is {still:.4g} there, {limit:.4g} is allowed; allow more, or keep the "
            "path farther away"
        )
        raise StandstillError(Standstill(s, q, reason))
    return found


def _speed(name: str, value: float | None) -> float | None:
    return None if value is None else number(name, value, above=0.0, kind="number of m/s")


def checked_path(path: ArrayLike, robot: Robot) -> FloatArray:
    """Return a path (N ≥ 2, n) within the limits of the joints, or raise InputError."""
    points = finite_array(path, (None, robot.n), "path")
    if len(points) < 2:
        raise InputError(f"a trajectory needs a path of two way points at least, got {len(points)}")
    for k, q in enumerate(points):
        for i in np.flatnonzero(~robot.within_limits(q)):
            raise InputError(
                f"way point {k}: joint {robot.joint_names[i]!r} = {q[i]:g} is outside its limits "
                f"[{robot.lower[i]:g}, {robot.upper[i]:g}]"
            )
    return points
