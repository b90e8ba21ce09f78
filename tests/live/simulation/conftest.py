"""A Panda that goes to and fro over a table, and replanners and shields for it."""

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
from safe_ompl.live.replanning import ReplanningOptions, SpeedLimits

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
    """Return a function that makes the trajectories there and back, perhaps with limits of jerks (7,) and speeds."""

    def make(replanner, jerk=None, **speeds):
        limits = RateLimits.of(panda, acceleration=PANDA_ACCELERATIONS, jerk=jerk)
        return [time_path(way, panda, limits, motion=replanner.prover, **speeds) for way in (WAYS, WAYS[::-1])]

    return make
