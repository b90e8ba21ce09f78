"""A Panda in MuJoCo follows a planned motion; its errors make a tube, which is proven (pip install mujoco)."""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from servo_robot import STEP, Servo, ServoRobot

from safe_ompl import Motion, RateLimits, SafeSetup, Scenario, check
from safe_ompl.motions import measured_tube

scenario = Scenario.load("panda_shelf")
robot, scene = scenario.build_robot(), scenario.scene
setup = SafeSetup(robot, scene)
setup.setTube(0.015)  # what we expect of the controller: every joint within 15 mrad
setup.setConfigurations([1.3, -0.6, 0, -2.2, 0, 3.0, 0.785], [-0.9, -0.6, 0, -2.4, 0, 2.6, 0.785])
limits = RateLimits.of(robot, acceleration=5.0)
trajectory = setup.plan("SafeRRTConnect", time=5.0, seed=0, simplify=True).timed(limits)

body = ServoRobot(robot, scene, trajectory.at(0.0).q, Servo(payload=0.5))
times = np.arange(0.0, trajectory.duration, STEP)
states = trajectory.at(times)
measured, nearest = [trajectory.at(0.0).q], np.inf
for q, qd in zip(states.q[:-1], states.qd[:-1], strict=True):
    measured.append(body.step(q, qd))
    nearest = min(nearest, body.distance(nearest if np.isfinite(nearest) else 1.0))

names = robot.joint_names
commanded = Motion.hermite(times, states.q, names=names)
tube = measured_tube(commanded, Motion.hermite(times, np.array(measured), names=names))
print(f"errors up to {1e3 * tube.errors.max():.1f} mrad, a tube of {1e3 * tube.widths.max():.1f} mrad is needed")
print(check(commanded, robot, scene, tube=tube.widths))
print(f"in physics the robot was {1e3 * nearest:.0f} mm from the nearest obstacle")
