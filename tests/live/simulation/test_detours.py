"""Detours: found where the way is barred, taken over only when proven, and with what is known kept."""

from itertools import pairwise

import numpy as np
import pytest
from swinging import drive_replanner

from safe_ompl import CollisionChecker, InputError, MotionProver, RateLimits, Replanner, Scene, Surroundings, time_path
from safe_ompl.collision import Separation
from safe_ompl.geometry import Box, Obstacle, Pose
from safe_ompl.live.replanning import Action, SpeedLimits
from safe_ompl.live.replanning.bounded_path import Around, BoundedPath, RobotBodies, line
from safe_ompl.live.replanning.detours import Detours

BARRED = {}, {"ball": Pose((0.55, 0.0, 0.45))}


def paths(commands):
    return len({id(command.path) for command in commands})


def fastest_tip(panda, commands):
    """Return the largest speed of the tip [m/s]."""
    states = [command.at(command.time + t) for command in commands for t in np.linspace(0.0, 0.048, 5)]
    return max(np.linalg.norm(panda.tip_jacobian(state.q)[:3] @ state.qd) for state in states)


@pytest.mark.parametrize(("bound", "limit"), [(0.1, None), (0.1, 1.0), (0.0, 1.0), (0.5, None)])
def test_where_the_way_is_barred_another_one_is_taken_under_the_same_limits(
    replanner_for, to_and_fro, panda, bound, limit
):
    """The slower it is, the nearer to an obstacle it comes before it stands: nearer than large cells can tell."""
    replanner = replanner_for("ball", ball=bound)
    way = to_and_fro(replanner, tool_speed=limit)[0]
    commands = drive_replanner(replanner, way, lambda t: BARRED, 20.0)
    assert commands[-1].action is Action.DONE
    assert paths(commands) > 1
    np.testing.assert_allclose(commands[-1].at(100.0).q, way.at(way.duration).q, atol=1e-6)
    if limit is None:
        waiting = drive_replanner(replanner_for("ball", ball=bound), way, lambda t: BARRED, 5.0, think=False)
        assert waiting[-1].action is Action.STANDING
        assert fastest_tip(panda, commands) > 1.2
    else:
        assert 0.5 < fastest_tip(panda, commands) <= 1.001 * limit


def test_other_ways_keep_the_limits_of_the_motion(panda, table, to_and_fro):
    scene = Scene((*table, Obstacle("post", Box((0.05, 0.05, 0.6)), Pose((0.75, 0.0, 0.9)))))
    checker = CollisionChecker(panda, scene.without("ball"))
    motion = MotionProver(checker, separation=Separation().with_min_clearance(checker, 0.1, ["post"]))
    surroundings = Surroundings(scene, objects={"ball": 0.1})
    replanner = Replanner(panda, surroundings, prover=motion)
    commands = drive_replanner(replanner, to_and_fro(replanner)[0], lambda t: BARRED, 20.0)
    assert paths(commands) > 1
    required = replanner.prover.separation.required(motion.checker)
    assert not any(
        required.violating_pair(command.at(t).q)
        for command in commands
        for t in np.linspace(command.time, command.time + 0.05, 4)
    )
    for around, without, message in (
        (table, (), "its scene contains 'ball', which moves"),
        (scene, ("ball", "post"), "its scene lacks the obstacle 'post'"),
    ):
        prover = MotionProver(CollisionChecker(panda, around.without(*without)))
        with pytest.raises(InputError, match=f"prover: {message}"):
            Replanner(panda, surroundings, prover=prover)


def test_a_small_budget_finds_a_free_way_in_the_end_and_what_is_known_is_kept(replanner_for, to_and_fro, panda):
    replanner, turns, found = replanner_for("ball", ball=0.1), 0, None
    roadmap = Detours(replanner.prover, RobotBodies(panda), SpeedLimits(RateLimits.of(panda, acceleration=10.0)), 0.05)
    way = to_and_fro(replanner)[0]
    start, goal = way.at([0.0, way.duration]).q
    roadmap.cover(way.curve)
    replanner.update(*BARRED, 1.0)
    around = Around(replanner.surroundings.sets, 0.02)
    while found is None and turns < 200:
        roadmap.left, turns = 20, turns + 1
        found = roadmap.quickest(start, goal, around, 0.0, 30.0)
    assert 1 < turns < 200
    np.testing.assert_allclose([found[0][0], found[0][-1]], [start, goal], atol=1e-9)
    assert all(replanner.prover.is_free(a, b) for a, b in pairwise(found[0]))
    roadmap.left = 0  # no proof and no look anew
    np.testing.assert_array_equal(roadmap.quickest(start, goal, around, 0.1, 30.0)[0], found[0])
    assert roadmap.quickest(start, goal, around, 0.1, 0.1) is None


def test_other_limits_make_other_detours(replanner_for, to_and_fro):
    replanner = replanner_for("ball", ball=0.1)
    replanner.start(to_and_fro(replanner)[0])
    first = replanner.detours
    replanner.start(to_and_fro(replanner)[0])
    assert replanner.detours is first
    replanner.start(to_and_fro(replanner, tool_speed=1.0)[0])
    assert replanner.detours is not first
    assert replanner.detours.limits.tool_speed == 1.0


def test_where_a_goal_is_barred_another_one_is_served(replanner_for, to_and_fro, panda):
    replanner = replanner_for("ball", ball=0.1)
    there = to_and_fro(replanner)[0]
    middle, goal = there.at([0.5 * there.duration, there.duration]).q
    other = middle + 0.3 * np.eye(7)[1]
    on_goal = {}, {"ball": Pose(panda.tip_pose(goal).translation)}
    commands = drive_replanner(replanner, there, lambda t: on_goal, 4.0)
    assert commands[-1].action is not Action.DONE
    short = time_path([there.at(0.0).q, middle], panda, there.limits, motion=replanner.prover)
    far = time_path([there.at(0.0).q, [-2.4, 0.0, 0, -2.0, 0, 2.2, 0.785]], panda, there.limits)
    replanner.update(*on_goal, 10.0)
    assert replanner.soonest([there, short]) == 1
    replanner.update({}, {"ball": Pose(panda.tip_pose(middle).translation)}, 10.05)
    assert replanner.soonest([there, far, short]) == 1  # the others are barred
    replanner = replanner_for("ball", ball=0.1)
    commands = drive_replanner(replanner, there, lambda t: on_goal, 20.0, others=[other])
    assert commands[-1].action is Action.DONE
    np.testing.assert_allclose(commands[-1].at(100.0).q, other, atol=1e-6)


# ------------------------------------------------------------------------------------------------- guarded paths


def test_a_path_under_a_cap_of_link_speed_keeps_it_everywhere(panda, to_and_fro, replanner_for):
    way = to_and_fro(replanner_for("ball"))[0]
    path = BoundedPath.along(RobotBodies(panda), way.curve, SpeedLimits(way.limits, link_speed=0.7))
    for s, square in zip(0.5 * (path.edges[1:] + path.edges[:-1]), path.squared_limits, strict=True):
        place = path.curve.places(np.array([s]))
        step = 1e-5 * np.sqrt(square)
        moved = panda.keypoints(place.q[0] + step * place.dq_ds[0]) - panda.keypoints(place.q[0])
        assert np.linalg.norm(moved, axis=1).max() <= 0.7 * 1e-5 * 1.001
    free = BoundedPath.along(path.bodies, way.curve, SpeedLimits(way.limits))
    assert path.squared_limits.min() < free.squared_limits.min()


def test_joined_paths_have_an_acceleration_in_every_cell_however_lengths_are_rounded(panda):
    limits, bodies = SpeedLimits(RateLimits.of(panda, acceleration=10.0)), RobotBodies(panda)
    points = np.array([0, 0, 0, -2.0, 0, 2, 0.7]) + 0.1 * np.random.default_rng(0).uniform(size=(31, 7))
    ways = [BoundedPath.along(bodies, line(a, b), limits) for a, b in pairwise(points)]
    whole = ways[-1]
    for way in ways[-2::-1]:
        whole = way.then(whole)
        assert whole.length == whole.curve.length
        assert len(whole.accelerations) == len(whole.brakes)
