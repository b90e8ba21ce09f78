"""OMPL goals for a position, a pose or a region of the robot's tip, which any planner can sample."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from ompl import base as ob, util as ou

from safe_ompl.common import FloatArray, InputError, PlanningError, instance, number, whole_number
from safe_ompl.danger import DangerField
from safe_ompl.planning.ompl.validity import bridge_of
from safe_ompl.robot import (
    METRES_PER_RADIAN,
    GoalRegion,
    RegionTarget,
    Robot,
    ScratchState,
    StateBridge,
    TargetPose,
    approach,
    target_pose,
    tip_reach,
)

TOLERANCE = 0.01  # [m]
# A solution is accurate to this share of the goal's tolerance.
_PRECISION = 0.01

# The first search starts from this many seeds, which finds several postures of most arms.
_FIRST_SEEDS = 16
# Later searches run while a planner plans, and start from this many seeds.
_MORE_SEEDS = 1
# A planner that has all solutions gets a new one after this many calls of `couldSample`.
_REQUESTS = 16
# Solutions nearer to each other than this count as one.
_EQUAL_SOLUTIONS = 0.05  # [rad]


def states_of(goal: Any, bridge: StateBridge) -> list[FloatArray]:
    """Return the configurations (n,) of an ob.GoalState or ob.GoalStates, valid or not; other goals have none."""
    if isinstance(goal, ob.GoalState):
        return [bridge.read(goal.getState())]
    if isinstance(goal, ob.GoalStates):
        return [bridge.read(goal.getState(k)) for k in range(goal.getStateCount())]
    return []


class WorkspaceGoal(ob.GoalSampleableRegion):  # type: ignore[misc]
    """All configurations whose tip is at a position or pose (the paper's goal region, §2).

    For planners the goal is a growing list of configurations: valid solutions of the inverse kinematics from random
    seeds, the safest of a search first. Planners that continue to sample get new solutions. The search runs in the
    planner's own thread. If no solution is found, planners wait until their time is over, and `failure` says how near
    the tip came. The same seed gives the same solutions; `setSeed` clears them.

    Parameters
    ----------
    si : ob.SpaceInformation
        Its space must have the robot's joints as coordinates (see `joint_space`).
    robot : Robot
        The robot.
    target : array_like, shape (3,), pin.SE3 or TargetPose
        Target position of the tip in the world frame [m], with any orientation; or the target pose.
    tolerance : float
        Largest distance of the tip from the target [m]. For a pose, a radian counts `safe_ompl.robot.METRES_PER_RADIAN`
        (0.25 m); see `TargetPose.distance`.
    field : DangerField, optional
        Danger field that ranks the solutions.
    seed : int, optional
        Seed of the random numbers; by default the next seed of OMPL, see `ou.RNG.setSeed`.

    Raises
    ------
    InputError
        For a wrong shape, NaN, or a tolerance that is not positive; or if the target is out of reach by a proven bound
        of the reach (`tip_reach`).

    Examples
    --------
    >>> setup = setup_scenario("ur5_handover")
    >>> goal = WorkspaceGoal(setup.getSpaceInformation(), setup.robot, [0.4, -0.3, 0.35])
    >>> setup.setGoal(goal)
    """

    def __init__(
        self,
        si: Any,
        robot: Robot,
        target: ArrayLike | Any,
        *,
        tolerance: float = TOLERANCE,
        field: DangerField | None = None,
        seed: int | None = None,
    ) -> None:
        super().__init__(si)
        self.target = target if isinstance(target, TargetPose) else target_pose(robot, target)
        self.tolerance = number("tolerance", tolerance, above=0.0, kind="length [m]")
        self.setThreshold(self.tolerance)
        self._field = field
        self._bridge = bridge_of(si)
        if self._bridge.n != robot.n:
            raise InputError(f"the space has {self._bridge.n} coordinates, but {robot.name!r} {robot.n} joints")
        self._scratch = ScratchState(self._bridge)
        self._check_reach()
        self.setSeed(ou.RNG().getLocalSeed() if seed is None else seed)

    def setSeed(self, seed: int) -> None:
        """Seed the random number generator, and clear all solutions."""
        self._seed = whole_number("seed", seed, at_least=0)
        self._rng = np.random.default_rng(self._seed)
        self._found: list[FloatArray] = []
        # The number of configurations that were offered to planners, the first ones of `_found`.
        self._offered = 0
        self._next = 0  # to be handed out
        self._asked = 0
        # The numbers of searches, and of searches that reached the target.
        self._tries = 0
        self._arrived = 0
        # The least distance to the target in the other searches, and the configuration there.
        self._nearest = np.inf, np.zeros(0)
        # The last configuration that reached the target and was not valid.
        self.refused: FloatArray | None = None

    def getSeed(self) -> int:
        """Return the seed."""
        return self._seed

    @property
    def solutions(self) -> FloatArray:
        """The goal configurations (G, n) offered so far [rad or m]."""
        return np.array(self._found[: self._offered]).reshape(-1, self._bridge.n)

    def failure(self) -> str | None:
        """Return the reason why no goal configuration was found; None if there is one, or before the first search."""
        if self._found or not self._tries:
            return None
        begin = f"{self._tries} searches of the inverse kinematics found no valid goal configuration"
        if self._arrived:
            return f"{begin}: {self._arrived} brought the tip {self.target.robot.tip!r} to the goal, all are refused"
        error = self.target.error(self._nearest[1])
        off = f"{1e3 * np.linalg.norm(error[:3]):.0f} mm"
        if len(error) > 3:
            off += f" and {np.degrees(np.linalg.norm(error[3:]) / METRES_PER_RADIAN):.1f} deg"
        centre, radius = tip_reach(self.target.robot)
        return (
            f"{begin}: the tip {self.target.robot.tip!r} comes within {off} of the goal at best; "
            f"its reach is at most {radius:.2f} m from {centre.round(3).tolist()}"
        )

    def _check_reach(self) -> None:
        """Raise InputError if the target is proven to be out of the tip's reach."""
        centre, radius = tip_reach(self.target.robot)
        nearest = self.target.nearest_position(centre)
        away = float(np.linalg.norm(nearest - centre))
        if away > radius + self.tolerance:
            raise InputError(
                f"the goal {nearest.round(3).tolist()} [m] is out of reach: it is {away:.2f} m from "
                f"{centre.round(3).tolist()}, and the tip {self.target.robot.tip!r} of {self.target.robot.name!r} is "
                f"never more than {radius:.2f} m from there"
            )

    def distanceGoal(self, state: Any) -> float:
        """Return the distance [m] of the tip from the target; for a pose see `TargetPose.distance`."""
        return self.target.distance(self._bridge.read(state))

    def maxSampleCount(self) -> int:
        """Return the number of solutions offered; if there is none, search for the first one."""
        if not self._offered:
            self._offer()
        return self._offered

    def couldSample(self) -> bool:
        """Return True, because there may be more solutions; after enough calls a new one is searched."""
        self._asked += 1
        if self._asked >= max(_REQUESTS, self._offered):
            self._offer()
        return True

    def sampleGoal(self, state: Any) -> None:
        """Write the next solution into `state`; after the last one a new solution, or the first one if none is found.

        Raises PlanningError if there is no solution; planners call `maxSampleCount` first.
        """
        if self._next >= self._offered:
            self._offer()
        if not self._offered:
            raise PlanningError(
                f"no valid configuration brings the tip to {self.target!r}, as far as known: {self.failure()}"
            )
        self._next %= self._offered
        self._bridge.write(self._found[self._next], state)
        self._next += 1

    def _offer(self) -> None:
        """Offer one more solution; search for new ones if all solutions were offered."""
        self._asked = 0
        if self._offered == len(self._found):
            self._found += self._search(_MORE_SEEDS if self._found else _FIRST_SEEDS)
        self._offered += self._offered < len(self._found)

    def _search(self, seeds: int) -> list[FloatArray]:
        """Return new valid solutions from random seeds, the safest first."""
        robot, si = self.target.robot, self.getSpaceInformation()
        new: list[FloatArray] = []
        precision = _PRECISION * self.tolerance
        for _ in range(seeds):
            seed = self._rng.uniform(robot.lower, robot.upper)
            q, distance = approach(self.target.sample(self._rng), seed, precision)
            self._tries += 1
            if distance > precision:
                self._nearest = min(self._nearest, (self.target.distance(q), q), key=lambda found: found[0])
                continue
            self._arrived += 1
            known = np.array([*self._found, *new]).reshape(-1, robot.n)
            if (np.linalg.norm(self._bridge.difference(known, q), axis=1) < _EQUAL_SOLUTIONS).any():
                continue
            state = self._scratch.set(q)
            if si.satisfiesBounds(state) and si.isValid(state):
                new.append(q)
            else:
                self.refused = q
        if self._field is None or not new:
            return new
        return [new[k] for k in np.argsort(self._field.values(np.array(new)), kind="stable")]


REGION_TOLERANCE = 1e-3  # [m]


class RegionGoal(WorkspaceGoal):
    """All configurations whose tip is in a region, given by bounds of position and orientation.

    It works as a `WorkspaceGoal`. Its solutions are solutions of the inverse kinematics for random poses of the region.
    `distanceGoal` is the distance of the tip from the region [m], 0 inside. `options` are `field` and `seed`. Raises
    InputError if `region` is no GoalRegion, or the tolerance is not positive.

    Examples
    --------
    >>> setup = setup_scenario("ur5_handover")
    >>> region = GoalRegion(Pose([0.4, -0.3, 0.35]), x=(-0.1, 0.1))
    >>> setup.setGoal(RegionGoal(setup.getSpaceInformation(), setup.robot, region))
    """

    def __init__(
        self, si: Any, robot: Robot, region: GoalRegion, *, tolerance: float = REGION_TOLERANCE, **options: Any
    ) -> None:
        instance("region", region, GoalRegion)
        self.region = region
        super().__init__(si, robot, RegionTarget(robot, region), tolerance=tolerance, **options)
