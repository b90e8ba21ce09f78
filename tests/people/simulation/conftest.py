"""A Panda that goes to and fro over a table, and a replanner for it."""

import pytest

from safe_ompl import Box, Obstacle, People, Pose, RateLimits, Replanner, Scene, Sphere, Tracker, time_path
from safe_ompl.people import TrackedBody, find_skeleton
from safe_ompl.people.replanning import ReplanningOptions

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
            table,
            trackers,
            {"ball": ball} if "ball" in who else {},
            people=People(speed=1.6) if people is None else people,
            options=ReplanningOptions(**options),
        )

    return make


@pytest.fixture
def to_and_fro(panda):
    """Return a function that makes the trajectories there and back for a replanner."""

    def make(replanner):
        limits = RateLimits.of(panda, acceleration=PANDA_ACCELERATIONS)
        return [time_path(way, panda, limits, motion=replanner.prover) for way in (WAYS, WAYS[::-1])]

    return make
