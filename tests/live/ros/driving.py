"""A controller of a robot that does what it is told, and a person, in simulated time."""

import argparse
from concurrent.futures import Executor, Future

import numpy as np

from safe_ompl.apps.cli.ros import cell_of, trackers_of
from safe_ompl.geometry import STANDING
from safe_ompl.live.ros import ControlOptions, LiveController, TrajectoryGuard
from safe_ompl.scene import Scenario

GOAL = [-1.25, 0.4, 0.0, -2.1, 0.0, 2.5, 0.785]
START = [1.45, 0.1, 0.0, -1.7, 0.0, 3.37, 0.785]
AWAY = np.array([3.0, 0.0, -0.75])  # where a person stands who bars nothing
BODY = 1.75 * np.array(list(STANDING.values()))
OPTIONS = {"people": None, "skeleton": None, "noise": 0.0, "time": None, "seed": 0, "simplify": False, "controller": ""}


class AtOnce(Executor):
    """Does what it is given at once."""

    def submit(self, fn, /, *args, **kwargs):
        done = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except Exception as error:
            done.set_exception(error)
        return done


def panda(given="panda_shelf", shield=False, control=None):
    """Return the cell of a scenario of a Panda, or of the name of one, beside an operator who is tracked."""
    given, options = given if isinstance(given, Scenario) else Scenario.load(given), argparse.Namespace(**OPTIONS)
    options.shield = shield
    return cell_of(given, given.build_robot(), trackers_of(given, options), options, control or ControlOptions())


def ball(centre):
    """Return points (300, 3) on a ball of 8 cm."""
    directions = np.random.default_rng(0).normal(size=(300, 3))
    return centre + 0.08 * directions / np.linalg.norm(directions, axis=1, keepdims=True)


class Drive:
    """A controller, a robot that does what it is told, and a person, in simulated time."""

    def __init__(self, cell, start=START, *, guarded=False, control=None):
        self.time = 10.0
        self.controller = LiveController(cell, lambda: self.time, control or ControlOptions(), AtOnce())
        self.pilot = TrajectoryGuard(self.controller, lambda: self.time) if guarded else self.controller
        self.robot, self.q, self.qd = cell.robot, np.array(start), np.zeros(len(start))
        self.person, self.told, self.ticks = AWAY.copy(), None, []
        self.joints = self.people = self.deaf = False  # what is lost
        self.off = 0.0  # [rad] from where joints are to where they are measured

    def see(self):
        """Measure the robot and the person."""
        if not self.joints:
            self.controller.receive_joints(self.time, self.robot.joint_names, self.q + self.off, self.qd)
        if not self.people:
            self.controller.receive_people(self.time, dict.fromkeys(self.controller.cell.trackers, BODY + self.person))

    def run(self, seconds):
        """Go on, and return the ticks."""
        first = len(self.ticks)
        for _ in range(round(seconds / 0.05)):
            self.see()
            self.ticks.append(self.pilot.tick())
            if self.controller.driving and not self.deaf:
                self.take(*self.controller.stop())
            self.controller.think()
            self.time += 0.05
            self.move()
        return self.ticks[first:]

    def take(self, times, states):
        """Take a command, which ends in a stop and follows the one before."""
        assert (np.diff(times) > 0).all()
        assert np.abs(states[-1].qd).max() < 1e-9
        if self.told is not None and self.controller.command.time > self.told[0][0]:
            before, known = self.told[0], np.array([state.q for state in self.told[1]])
            expected = [np.interp(times[0], before, column) for column in known.T]
            np.testing.assert_allclose(states[0].q, expected, atol=2e-4)  # samples of 10 ms, between them lines
        self.told = times, states, self.told

    def move(self):
        """Be where the commands in force have the robot by now."""
        told = self.told
        while told is not None and told[0][0] > self.time:
            told = told[2]
        if told is None:
            return
        times, states, _ = told
        k = int(np.searchsorted(times, self.time, side="right")) - 1
        if k >= len(times) - 1:
            self.q, self.qd = states[-1].q, np.zeros(len(self.q))
        else:
            share = (self.time - times[k]) / (times[k + 1] - times[k])
            self.q = (1 - share) * states[k].q + share * states[k + 1].q
            self.qd = (1 - share) * states[k].qd + share * states[k + 1].qd

    def go(self, goal=GOAL):
        self.controller.go_to(self.robot.joint_names, goal)

    def arrives(self, goal=GOAL):
        """Assert that the robot gets to its goal."""
        self.run(8.0)
        assert self.last == ("done", "at the goal")
        np.testing.assert_allclose(self.q, goal, atol=1e-9)

    @property
    def last(self):
        return self.ticks[-1]["state"], self.ticks[-1]["reason"]
