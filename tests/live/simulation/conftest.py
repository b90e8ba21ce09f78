"""A Panda that goes to and fro over a table, a replanner for it, and drives at which all promises are checked."""

from itertools import pairwise

import numpy as np
import pytest
from swinging import HOME

from safe_ompl import (
    Box,
    CollisionChecker,
    MotionProver,
    Obstacle,
    People,
    Pose,
    RateLimits,
    Replanner,
    Scene,
    Shield,
    Sphere,
    Surroundings,
    Tracker,
    time_path,
)
from safe_ompl.collision import Separation, ToolOrientation
from safe_ompl.live import TrackedBody, find_skeleton
from safe_ompl.live.replanning import Action, ReplanningOptions, SpeedLimits

PANDA_ACCELERATIONS = [15, 7.5, 10, 12.5, 15, 20, 20]
WAYS = [[-1.2, 0.0, 0, -2.0, 0, 2.2, 0.785], [0.0, -0.4, 0, -2.0, 0, 2.0, 0.785], [1.2, 0.0, 0, -2.0, 0, 2.2, 0.785]]
ONLY = ("head", "torso", "shoulders", "right_upper_arm", "right_forearm", "right_hand")


@pytest.fixture(scope="session")
def table():
    return Scene(
        (
            Obstacle("table", Box((1.6, 1.6, 0.04)), Pose((0.0, 0.0, -0.1))),
            Obstacle("ball", Sphere(0.1), Pose((1.2, 0.0, 0.5))),
        )
    )


@pytest.fixture(scope="session")
def tracker():
    return Tracker(find_skeleton("coco17"), TrackedBody(1.75, ONLY))


@pytest.fixture
def replanner_for(panda, table, tracker):
    """Return a function that makes a replanner: with a person, a ball, or both."""

    def make(*who, ball=1.6, trackers=None, people=None, **options):
        trackers = trackers or {name: tracker for name in who if name != "ball"}
        return Replanner(
            panda,
            Surroundings(table, trackers, {"ball": ball} if "ball" in who else {}, people or People(speed=1.6)),
            options=ReplanningOptions(**options),
        )

    return make


@pytest.fixture
def shield_for(panda, table):
    """Return a function that makes a shield beside a ball of 1.6 m/s.

    It may have a tube [rad], limits of the jerk (7,), a lag of the robot [s], and a largest tilt of the tool [rad].
    """

    def make(tube=0.0, jerk=None, lag=0.0, tilt=None):
        limits = SpeedLimits(RateLimits.of(panda, acceleration=PANDA_ACCELERATIONS, jerk=jerk))
        checker = CollisionChecker(panda, table.without("ball"))
        axis = panda.tip_pose(HOME).rotation.T @ [0.0, 0.0, 1.0]
        upright = () if tilt is None else [ToolOrientation(panda, axis, [0.0, 0.0, 1.0], tilt)]
        proof = MotionProver(checker, separation=Separation(tube=(tube,) * 7 if tube else ()), limits=upright)
        around, options = Surroundings(table, objects={"ball": 1.6}), ReplanningOptions(limits=limits, lag=lag)
        shield = Shield(panda, around, options=options, prover=proof)
        shield.start(HOME)
        return shield

    return make


@pytest.fixture
def to_and_fro(panda):
    """Return a function that makes the trajectories there and back for a replanner, perhaps with limits of speed."""

    def make(replanner, **speeds):
        limits = RateLimits.of(panda, acceleration=PANDA_ACCELERATIONS)
        return [time_path(way, panda, limits, motion=replanner.prover, **speeds) for way in (WAYS, WAYS[::-1])]

    return make


@pytest.fixture
def drive():
    """Return a function that drives with what is seen at each tick, checks the commands, and returns them."""

    def run(replanner, trajectory, see, seconds, think=True, others=()):
        replanner.start(trajectory, others)
        commands = []
        for k in range(round(seconds / replanner.tick)):
            seen = see(k * replanner.tick)
            replanner.update(*seen, k * replanner.tick)
            commands.append(replanner.command(k * replanner.tick + 0.02))
            if commands[-1].action is Action.DONE:
                break
            if think:
                replanner.think()
        check_commands(replanner, trajectory.limits, commands)
        return commands

    return run


def check_commands(pilot, limits, commands):
    """Fail where commands jump, break limits, touch what stands still, or do not end at rest."""
    for before, after in pairwise(commands):
        np.testing.assert_allclose(before.at(after.time).q, after.at(after.time).q, atol=1e-6)
        np.testing.assert_allclose(before.at(after.time).qd, after.at(after.time).qd, atol=1e-4)
    for command in {id(command): command for command in commands}.values():
        for t in np.linspace(command.time, command.standstill, 8)[:-1]:  # at rest a corner may have two slopes
            state = command.at(t)
            assert (np.abs(state.qd) <= limits.velocity * (1 + 1e-9)).all()
            assert (np.abs(state.qdd) <= limits.acceleration * (1 + 1e-6)).all()
            assert not pilot.prover.checker.in_collision(state.q)
        assert np.abs(command.at(command.standstill).qd).max() < 1e-6
