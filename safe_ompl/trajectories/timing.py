"""From a path to a trajectory: blends, caps of the speed, and the fastest law within them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.errors import InputError
from safe_ompl.inputs import number
from safe_ompl.robot.robot import Robot
from safe_ompl.trajectories.blends import blended
from safe_ompl.trajectories.limits import JointLimits
from safe_ompl.trajectories.time_law import TimeLaw, fastest_law, velocity_cap
from safe_ompl.trajectories.trajectory import SpeedCap, Trajectory

TOLERANCE = 0.05  # [rad] of blends
_STEP = 0.02  # [rad] largest cell
_CELLS = 400  # at least, on the whole path


def time_path(
    path: ArrayLike,
    robot: Robot,
    limits: JointLimits | None = None,
    *,
    motion: CertifiedMotion | None = None,
    tolerance: float = TOLERANCE,
) -> Trajectory:
    """Return the fastest trajectory along a path that keeps its limits at every instant.

    Parameters
    ----------
    path : array_like, shape (N, n)
        Way points, such as those of `PlanResult.path`; straight motions between them.
    robot : Robot
        The robot.
    limits : JointLimits, optional
        Joint velocities and accelerations; default: `JointLimits.of(robot)`.
    motion : CertifiedMotion, optional
        What proves the arcs that round the corners. Without it the robot stops in every corner.
    tolerance : float
        How far arcs may be from the path [rad].

    Raises
    ------
    InputError
        If the path has fewer than two way points, is not finite, does not move or leaves the joint limits; if limits
        are zero, missing, or of other joints; if the tolerance is negative.
    """
    points = checked_path(path, robot)
    limits = JointLimits.of(robot) if limits is None else limits
    if limits.joint_names != robot.joint_names:
        raise InputError(
            f"the limits are for the joints {limits.joint_names}, the robot's are {robot.joint_names}"
        )
    curve = blended(points, robot, number("tolerance", tolerance, at_least=0.0), motion)
    cells = curve.cells(min(_STEP, curve.length / _CELLS))
    caps = (SpeedCap("joint velocity", velocity_cap(cells, limits)),)
    squares = fastest_law(cells, limits, caps[0].speeds)
    return Trajectory(curve, TimeLaw.through(cells.edges, squares), limits, caps)


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
