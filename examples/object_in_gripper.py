"""An object in the gripper: checked against the scene and against the robot, from the moment it is held."""

import numpy as np
import pinocchio as pin

from safe_ompl import Box, CollisionChecker, Cylinder, Obstacle, Pose, Robot, SafeSetup, Scene

fence = Obstacle("fence", Box((0.04, 0.6, 0.3)), Pose((-0.1, 0.6, 0.12)), weight=1.0)
scene = Scene((fence,))
empty = Robot.from_example("ur5")
rod = Cylinder(0.02, 0.3)
holding = empty.with_attached("rod", rod, pose=(0.0, 0.0, 0.16))

start, goal = [1.0, -1.4, 1.4, -1.5, -1.57, 0.0], [2.2, -1.4, 1.4, -1.5, -1.57, 0.0]
for robot in (empty, holding):
    setup = SafeSetup(robot, scene)
    setup.setConfigurations(start, goal)
    result = setup.plan("SafeRRTConnect", time=10.0, simplify=True)
    assert result, result.status
    nearest = result.report.clearance
    held = ", ".join(item.name for item in robot.attached) or "nothing"
    print(f"holding {held}: {result.report.length:.2f} rad, {1e3 * nearest.min:.0f} mm, nearest: {nearest.link}")

# Put down, it is an obstacle, where the gripper left it.
place = Pose.of(empty.tip_pose(result.path[-1]) * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.16])))
left = scene.with_obstacles(Obstacle("rod", rod, place))
apart = CollisionChecker(empty, left).clearance(result.path[-1])
print(f"the gripper that has let go is {1e3 * apart.distance:.0f} mm from the {apart.obstacle}")
