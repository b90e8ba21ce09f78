"""A short motion of the arm planar3, which every planner finds in no time, and what comes after it."""

from itertools import count

import numpy as np
from ompl import base as ob

from safe_ompl import Box, Obstacle, Pose, SafeSetup, Scenario

# Planners that optimise go on until they are stopped. Two of them stand for all.
OPTIMISING = ("RRTstar", "BITstar")
MOTION = np.array([0.4, 0.2, -0.15])
OTHER_START = np.array([0.05, 0.05, 0.0])
FAR = Obstacle("far", Box((0.1, 0.1, 0.1)), Pose((20.0, 0.0, 0.0)))


def build():
    """Return a setup that is asked for the motion, as configurations and as a place, and the start."""
    scenario = Scenario.load("planar3")
    setup = SafeSetup(scenario.build_robot(), scenario.scene.with_obstacles(FAR), movable=["far"])
    start = scenario.start_configuration(setup.robot)
    setup.setWorkspaceGoal(setup.robot.tip_pose(start + MOTION).translation)
    setup.setConfigurations(start, start + MOTION)
    return setup, start


def state(setup, q):
    """Return a new state of the setup's space."""
    made = setup.getStateSpace().allocState()
    setup.bridge.write(q, made)
    return made


def limit(name):
    """Return a limit [s], or one of steps for planners that would use all of their time; no machine is too slow."""
    steps = count()
    return ob.PlannerTerminationCondition(lambda: next(steps) >= 300) if name in OPTIMISING else 60.0


def solved(setup, name):
    """Plan, and return the path, which is proven."""
    assert setup.solve(limit(name)).getStatus() == ob.PlannerStatus.EXACT_SOLUTION
    path = setup.solution()
    assert setup.report(path).certified
    return path


def begun(name):
    """Return a setup that has solved its first query by a planner, and the start."""
    setup, start = build()
    setup.prepare(name, 0)
    solved(setup, name)
    assert setup.haveSolutionPath()
    return setup, start
