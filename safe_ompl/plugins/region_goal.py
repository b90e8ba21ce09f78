"""A region of the robot's tip as an OMPL goal that any planner can sample."""

from __future__ import annotations

from typing import Any

from safe_ompl.danger.field import DangerField
from safe_ompl.errors import InputError
from safe_ompl.inputs import shown
from safe_ompl.plugins.goals import WorkspaceGoal
from safe_ompl.robot.inverse_kinematics import Place
from safe_ompl.robot.region import GoalRegion, RegionPlace
from safe_ompl.robot.robot import Robot

REGION_TOLERANCE = 1e-3  # [m]


class RegionGoal(WorkspaceGoal):
    """The configurations whose tip is in a region: its position and its orientation within bounds.

    All that holds of a `WorkspaceGoal` holds of it. Solutions are those of the inverse kinematics for poses drawn at
    random from the region; `distanceGoal` is the distance of the tip from the region, 0 inside.

    Parameters
    ----------
    si : ob.SpaceInformation
        Its space must have the robot's joints as coordinates (see `joint_space`).
    robot : Robot
        The robot.
    region : GoalRegion
        Where its tip may be.
    tolerance : float
        How far outside of the region is near enough [m]; a radian counts as 0.25 m.
    field : DangerField, optional
        Ranks the solutions.
    seed : int, optional
        Seed of the random numbers; by default another every time.

    Attributes
    ----------
    region : GoalRegion
        As given.

    Raises
    ------
    InputError
        If the region is none, or the tolerance is not positive.
    """

    def __init__(
        self,
        si: Any,
        robot: Robot,
        region: GoalRegion,
        *,
        tolerance: float = REGION_TOLERANCE,
        field: DangerField | None = None,
        seed: int | None = None,
    ) -> None:
        if not isinstance(region, GoalRegion):
            raise InputError(f"region must be a GoalRegion, got {shown(region)}")
        self.region = region
        self._inside = RegionPlace(robot, region)
        super().__init__(si, robot, self._inside, tolerance=tolerance, field=field, seed=seed)

    def __repr__(self) -> str:
        return f"RegionGoal({self.region!r}, tolerance={self.tolerance:g}, seed={self.getSeed()})"

    def _target(self) -> Place:
        return self._inside.sample(self._rng)
