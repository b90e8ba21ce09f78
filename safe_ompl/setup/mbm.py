"""Setups of MotionBenchMaker problems."""

from __future__ import annotations

import logging

from safe_ompl.robot.robot import Robot
from safe_ompl.scenario.mbm import MbmProblem
from safe_ompl.setup.safe_setup import SafeSetup

_log = logging.getLogger(__name__)


def setup_problem(problem: MbmProblem, robot: Robot) -> SafeSetup:
    """Return a SafeSetup with the scene, start and goals of a problem.

    Limits of joints are widened, with a warning, where a goal is slightly outside; see `MbmProblem.widened_limits`.

    Raises
    ------
    InputError
        If the joints are not those of the robot, or start or goals are outside the limits or in collision.
    """
    limits = problem.widened_limits(robot)
    if limits:
        listed = ", ".join(f"{joint} to [{low:g}, {high:g}]" for joint, (low, high) in limits.items())
        _log.warning("%s %d: a goal is outside the limits: widened %s", problem.family, problem.index, listed)
        robot = robot.with_limits(limits)
    setup = SafeSetup(robot, problem.scene)
    setup.setConfigurations(problem.start_configuration(robot), problem.goal_configurations(robot))
    return setup
