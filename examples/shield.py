"""A noisy policy hands over a tool beside a person who walks about; what is driven of it is proven at every tick."""

import sys

import numpy as np

from safe_ompl import Box, Obstacle, People, Pose, RateLimits, Robot, Scene, Shield, Surroundings, Tracker, time_path
from safe_ompl.live.simulation import ALL_KEYPOINTS, Simulation, Walker

PICK, GIVE = [-1.2, 0, 0, -2.0, 0, 2.2, 0.785], [0.9, 0.3, 0, -1.8, 0, 2.1, 0.785]
RATE = 20.0  # [Hz]


class Policy:
    """Sees where the robot is and proposes the next 0.8 s of a motion that it knows, with noise; here is your own."""

    def __init__(self, shield):
        self.shield, self.robot, self.tick = shield, shield.robot, shield.tick
        self.surroundings, self.update = shield.surroundings, shield.update
        self.rng, self.log = np.random.default_rng(0), None

    def start(self, trajectory):
        self.known, self.now = trajectory, 0.0
        self.q = trajectory.at(0.0).q
        self.shield.start(self.q)

    def command(self, time):
        near = np.clip(self.now + np.arange(-0.1, 0.5, 0.01), 0.0, self.known.duration)
        self.now = near[np.linalg.norm(self.known.at(near).q - self.q, axis=1).argmin()]
        if self.now + 0.4 < self.known.duration:  # else the robot goes on to the end of the last chunk
            chunk = self.known.at(self.now + np.arange(16) / RATE).q
            self.shield.propose(chunk + 5e-4 * self.rng.normal(size=chunk.shape), rate=RATE)
        command = self.shield.command(time)  # your controller follows command.at(t)
        self.q = command.at(time + self.tick).q
        if self.log:
            self.log.write(self.shield.log_tick())
        return command

    def think(self): ...


robot = Robot.from_example("panda")
scene = Scene((Obstacle("table", Box((1.6, 1.6, 0.04)), Pose((0.0, 0.0, -0.1))),))
people, tracker = People(speed=1.6), Tracker(ALL_KEYPOINTS)
shield = Shield(robot, Surroundings(scene, {"anna": tracker}, people=people))
slow = RateLimits.of(robot, velocity=1.5, acceleration=4.0)
ways = [time_path(way, robot, slow, motion=shield.prover) for way in ([PICK, GIVE], [GIVE, PICK])]
anna = Walker(people, np.array([0.0, 0.0, -0.8]), np.array([1.2, 0.5]), seed=1)
policy = Policy(shield)
if sys.argv[1:2] == ["--mcap"]:  # and a file, for Foxglove and `safe-ompl view FILE`
    from safe_ompl.live.ros import McapLog  # pip install 'safe-ompl[mcap]'

    policy.log = McapLog(sys.argv[2], shield.log_header())
simulation = Simulation(policy, ways, {"anna": anna})
ticks, result = list(simulation.ticks(15.0)), simulation.summary
print(f"{result.tasks} tools handed over, {result.contacts_while_moving} contacts while moving")
print("; ".join(sorted({tick["reason"].split(" (")[0] for tick in ticks if tick["reason"]})[:3]))
if policy.log:
    policy.log.close()
