"""Replanning beside a person who moves: what is driven is proven at every tick, including its stop."""

import logging

import numpy as np

from safe_ompl import Box, Obstacle, People, Pose, RateLimits, Replanner, Robot, SafeSetup, Scene, Surroundings, Tracker
from safe_ompl.live.skeletons import find_skeleton

logging.basicConfig(level=logging.INFO, format="%(message)s")
robot = Robot.from_example("panda")
scene = Scene((Obstacle("table", Box((1.6, 1.6, 0.04)), Pose((0.0, 0.0, -0.1))),))
setup = SafeSetup(robot, scene)
setup.setConfigurations([-1.2, 0, 0, -2.0, 0, 2.2, 0.785], [1.2, 0, 0, -2.0, 0, 2.2, 0.785])
trajectory = setup.plan("SafeRRTConnect", seed=0, simplify=0.2).timed(RateLimits.of(robot, acceleration=10.0))

skeleton = find_skeleton("recording12")  # also coco17, body25, mediapipe33, azure_kinect32, smpl24
# Key points of a person about the hip [m], with the right hand stretched out towards the robot.
standing = np.zeros((12, 3))
standing[:, 2] = [0, 0.2, 0.5, 0.7, 0.5, 0.5, 0.2, 0, 0.5, 0.5, 0.5, 0.5]
standing[5:, 1] = [0.19, 0.23, 0.24, 0, -0.19, -0.2, -0.2]
standing[10:, 0] = [-0.3, -0.55]
replanner = Replanner(robot, Surroundings(scene, {"anna": Tracker(skeleton)}, people=People(speed=1.6)))
replanner.start(trajectory)
for k in range(200):
    time = 0.05 * k  # here your sensor and your clock
    away = np.array([1.5 - 0.6 * max(0.0, np.sin(0.8 * time)), 0, 0.2])  # the person comes, and goes again
    replanner.update({"anna": standing + away}, {}, time)
    command = replanner.command(time + 0.02)  # holds from then on; your controller follows command.at(t)
    replanner.think()  # in the time that is left: search a detour
    if command.action == "done":
        break
print(f"{command.action.value} after {time:.2f} s; at {np.round(command.at(time + 0.02).q, 2).tolist()}")
