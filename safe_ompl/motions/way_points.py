"""Way points of others, once they are proven, as trajectories: as fast as limits and people beside them allow."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from safe_ompl.collision import Verdict
from safe_ompl.common import PlanningError
from safe_ompl.motions.checks import MotionCheck, check
from safe_ompl.motions.motion import Motion
from safe_ompl.paths import Constraints
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene
from safe_ompl.trajectories import RateLimits, Trajectory, time_path


def retime(
    motion: Any,
    robot: Robot,
    scene: Scene,
    limits: RateLimits | None = None,
    *,
    constraints: Constraints | None = None,
    tube: ArrayLike | None = None,
    **options: Any,
) -> Trajectory:
    """Return the fastest trajectory along way points that something else made; times that they have are thrown away.

    The straight motions between them are proven first, and blends that round the corners are, too.

    Parameters
    ----------
    motion : Motion or what `Motion.of` takes
        Such as way points (N, n), or what `read_motion` returns; of curved pieces only the ends count.
    robot, scene, constraints, tube
        As for `safe_ompl.check`.
    limits : RateLimits, optional
        Of the joints; default: `RateLimits.of(robot)`.
    **options
        Those of `time_path`: `people`, beside whom it is no faster than what is proven to stop in time, `tolerance` of
        blends, `tool_speed`, `link_speed`, `danger` and `max_danger`.

    Raises
    ------
    PlanningError
        If a way point, or the straight motion to the next one, is not proven: says which, counted from 0.
    InputError, StandstillError
        As `check` and `time_path`.
    """
    found = check(way_of(motion, robot), robot, scene, constraints=constraints, tube=tube)
    if not found:
        raise PlanningError(objection(found))
    return time_path(found.motion.knots, robot, limits, motion=found.proof, **options)


def way_of(motion: Any, robot: Robot) -> Motion:
    """Return the straight lines through the way points of a motion, without times."""
    given = Motion.of(motion, space=robot).for_robot(robot)
    return Motion.through(given.knots, names=robot.joint_names)


def objection(found: MotionCheck) -> str:
    """Return which way point of a way that is not proven is at fault, or between which two it is, and why."""
    proof = found.proof
    for k, q in enumerate(found.motion.knots):
        beyond = proof.checker.robot.beyond_limits(q)
        if beyond is not None:
            return f"way point {k}: {beyond}"
        verdict = proof.check(q, q)
        if verdict.verdict is not Verdict.FREE:
            return f"way point {k} is not proven to be free: {' – '.join(verdict.pair or ())}".rstrip(": ")
    first = found.violations[0]
    value, limit = first.quantities
    begin = min(int(first.at), found.motion.pieces - 1)
    said = ", ".join(part for part in (" – ".join(first.names), value, limit and f"limit {limit}") if part)
    return f"between way points {begin} and {begin + 1}, at {first.at:.3f}: {first.kind}: {said}"
