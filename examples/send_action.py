"""A `Shield` in front of any robot with `send_action`, such as those of LeRobot: only proven motions are sent."""

import time

import numpy as np

from safe_ompl import Box, Obstacle, People, Pose, Robot, Scene, Shield, Surroundings, Tracker
from safe_ompl.geometry import STANDING
from safe_ompl.live.simulation import ALL_KEYPOINTS


class ShieldedRobot:
    """Wraps a robot whose actions are joint values in degrees by `JOINT.pos`; `see` returns key points of people."""

    def __init__(self, inner, shield, see, clock=time.monotonic):
        self.inner, self.shield, self.see, self.clock, self.reason = inner, shield, see, clock, ""
        self.keys = [f"{name}.pos" for name in shield.robot.joint_names]
        self.here = self.target = self.joints(inner.get_observation())
        shield.start(self.here)

    def joints(self, values):
        return np.radians([values[key] for key in self.keys])

    def send_action(self, action):
        """Send where the proven motion is one tick later. Keys of no joint, such as a gripper's, are passed on."""
        now, before, self.target = self.clock(), self.target, self.joints(action)
        self.shield.update(self.see(), {}, now)
        # The velocity of the targets [rad/s], and 5/s of what is left to them where the robot was slowed.
        self.shield.propose_velocity((self.target - before) / self.shield.tick + 5.0 * (before - self.here))
        command = self.shield.command(now)
        self.here, self.reason = command.at(now + self.shield.tick).q, command.reason
        return self.inner.send_action(action | dict(zip(self.keys, np.degrees(self.here).tolist(), strict=True)))


class StandIn:  # here is your own robot
    def __init__(self, keys, q):
        self.now = dict(zip(keys, np.degrees(q).tolist(), strict=True))

    def get_observation(self):
        return self.now

    def send_action(self, action):
        self.now = action
        return action


robot, start = Robot.from_example("panda"), np.array([-0.6, 0.3, 0.0, -2.0, 0.0, 2.3, 0.785])
scene = Scene((Obstacle("table", Box((1.6, 1.6, 0.04)), Pose((0.0, 0.0, -0.1))),))
shield = Shield(robot, Surroundings(scene, {"anna": Tracker(ALL_KEYPOINTS)}, people=People(speed=1.6)))
body, people, now, sent = 1.75 * np.array(list(STANDING.values())) + [0.0, 0.0, -0.8], {}, 0.0, []
keys = [f"{name}.pos" for name in robot.joint_names]
arm = ShieldedRobot(StandIn(keys, start), shield, see=lambda: people, clock=lambda: now)
for now in np.arange(0.0, 8.0, shield.tick):
    people["anna"] = body + np.array([2.2 - min(0.6 * now, 1.5), 0.0, 0.0])  # she walks up to the arm
    wave = start + 0.6 * (1 - np.cos(1.5 * now)) * np.eye(7)[0]
    asked = dict(zip(keys, np.degrees(wave).tolist(), strict=True)) | {"gripper.pos": 40.0}
    action = arm.send_action(asked)
    sent.append((now, max(abs(action[key] - asked[key]) for key in asked), arm.reason))
print(f"{sum(off < 1.0 for _, off, _ in sent)} of {len(sent)} actions were sent within 1° of what was asked")
print("from {0:.1f} s on: {2}".format(*next(each for each in sent if "anna" in each[2])))
