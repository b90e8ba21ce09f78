"""OMPL's own planners in an ordinary SimpleSetup: with these two lines every path they return is proven."""

from ompl import geometric as og, util as ou

import safe_ompl as so
from safe_ompl.robot import StateBridge, joint_space

ou.setLogLevel(ou.LogLevel.LOG_WARN)
ou.RNG.setSeed(1)
robot = so.Robot.from_example("ur5")
checker = so.CollisionChecker(
    robot, so.Scene((so.Obstacle("pillar", so.Box((0.15, 0.15, 1.0)), so.Pose((0.45, 0.0, 0.4))),))
)

ss = og.SimpleSetup(joint_space(robot))
si = ss.getSpaceInformation()
ss.setStateValidityChecker(so.CollisionFreeValidity(si, checker))
si.setMotionValidator(so.CertifiedMotionValidator(si, checker))  # proves edges instead of sampling them

bridge = StateBridge(ss.getStateSpace())
start, goal = ss.getStateSpace().allocState(), ss.getStateSpace().allocState()
bridge.write([0.9, -1.2, 1.4, -1.8, -1.57, 0.0], start)
bridge.write([-0.9, -1.2, 1.4, -1.8, -1.57, 0.0], goal)
ss.setStartAndGoalStates(start, goal)

for planner in (og.RRTConnect, og.LBKPIECE1, og.KPIECE1):
    ss.clear()
    ss.setPlanner(planner(si))
    assert ss.solve(10.0)
    path = [bridge.read(state) for state in ss.getSolutionPath().getStates()]
    report = so.PathReport.of(path, checker)
    print(f"{planner.__name__}: {report.length:.2f} rad, clearance {1e3 * report.clearance.min:.1f} mm, ", end="")
    print("proven free" if report.certified else f"not proven: {report.refused}")
