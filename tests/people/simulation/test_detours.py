"""Detours: found where the way is barred, taken over only when proven, and with what is known kept."""

import logging
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from safe_ompl import CollisionChecker, InputError, MotionProver, RateLimits, Replanner, Scene, time_path
from safe_ompl.geometry import Box, Obstacle, Pose
from safe_ompl.people.replanning import Around, Detours, Doing, GuardedPath, PathLimits, RobotBodies, line

FAR = {}, {"ball": Pose((3.0, 0.0, 0.0))}
BARRED = {}, {"ball": Pose((0.55, 0.0, 0.45))}


def driven(replanner, trajectory, see, seconds, think=True):
    replanner.start(trajectory)
    commands = []
    for k in range(round(seconds / 0.05)):
        replanner.update(*see(0.05 * k), 0.05 * k)
        commands.append(replanner.command(0.05 * k + 0.02))
        if commands[-1].doing is Doing.DONE:
            break
        if think:
            replanner.think()
    return commands


def test_where_the_way_is_barred_another_one_is_taken(replanner_for, to_and_fro):
    replanner = replanner_for("ball", ball=0.1)
    way = to_and_fro(replanner)[0]
    commands = driven(replanner, way, lambda t: BARRED, 20.0)
    assert commands[-1].doing is Doing.DONE
    assert len({id(command.path) for command in commands}) > 1
    goal = way.at(way.duration).q
    np.testing.assert_allclose(commands[-1].at(100.0).q, goal, atol=1e-6)
    for before, after in pairwise(commands):  # no jumps where it goes over
        if after.time > before.time:
            np.testing.assert_allclose(before.at(after.time).q, after.at(after.time).q, atol=1e-7)
            np.testing.assert_allclose(before.at(after.time).qd, after.at(after.time).qd, atol=1e-4)
    waiting = driven(replanner_for("ball", ball=0.1), way, lambda t: BARRED, 5.0, think=False)
    assert waiting[-1].doing is Doing.STANDING


def test_what_is_driven_on_other_ways_is_free(replanner_for, to_and_fro):
    replanner = replanner_for("ball", ball=0.1)
    commands = driven(replanner, to_and_fro(replanner)[0], lambda t: BARRED, 20.0)
    for command in commands:
        for t in np.linspace(command.time, command.time + 0.05, 4):
            assert not replanner.prover.checker.in_collision(command.at(t).q)


def test_nothing_is_looked_for_where_the_way_is_clear(replanner_for, to_and_fro):
    replanner = replanner_for("ball")
    way = to_and_fro(replanner)[0]
    commands = driven(replanner, way, lambda t: FAR, 6.0)
    assert commands[-1].doing is Doing.DONE
    assert len({id(command.path) for command in commands}) == 1


@pytest.fixture
def roadmap(replanner_for, to_and_fro, panda):
    replanner = replanner_for("ball", ball=0.1)
    limits = PathLimits(RateLimits.of(panda, acceleration=10.0))
    found = Detours(replanner.prover, RobotBodies(panda), limits, 0.05)
    way = to_and_fro(replanner)[0]
    found.cover(way.curve)
    return found, replanner, way


def around(replanner, seen):
    replanner.update(*seen, replanner.surroundings.time + 1 if np.isfinite(replanner.surroundings.time) else 0.0)
    return Around(replanner.surroundings.sets, 0.02)


def test_what_is_known_is_kept(roadmap):
    roadmap, replanner, way = roadmap
    start, goal = way.at([0.0, way.duration]).q
    people = around(replanner, BARRED)
    roadmap.left = 2000
    found = roadmap.quickest(start, goal, people, 0.0, 30.0)
    assert found is not None
    first, roadmap.left = roadmap.left, 2000
    same = roadmap.quickest(start, goal, people, 0.1, 30.0)
    assert roadmap.left == 2000  # no proof and no look anew
    np.testing.assert_array_equal(same[0], found[0])
    roadmap.quickest(start, goal, around(replanner, BARRED), 5.0, 30.0)
    assert roadmap.left > first  # looks have aged; proofs hold for ever
    count = len(roadmap.milestones)
    roadmap.cover(way.curve)
    assert len(roadmap.milestones) == count


def test_a_small_budget_gets_there_in_the_end(roadmap):
    roadmap, replanner, way = roadmap
    start, goal = way.at([0.0, way.duration]).q
    people = around(replanner, BARRED)
    turns = 0
    for turns in range(200):  # noqa: B007
        roadmap.left = 20
        found = roadmap.quickest(start, goal, people, 0.0, 30.0)
        if found is not None:
            break
    assert found is not None
    assert turns > 1


def test_ways_are_free_and_end_where_they_must(roadmap):
    roadmap, replanner, way = roadmap
    start, goal = way.at([0.0, way.duration]).q
    roadmap.left = 2000
    points, time = roadmap.quickest(start, goal, around(replanner, FAR), 0.0, 30.0)
    np.testing.assert_array_equal(points[0], start)
    np.testing.assert_allclose(points[-1], goal, atol=1e-9)
    assert all(replanner.prover.is_free(a, b) for a, b in pairwise(points))
    assert 0 < time < 30
    assert roadmap.quickest(start, goal, around(replanner, FAR), 0.0, 0.1) is None


def slowed(replanner, to_and_fro, panda, way=0, **speeds):
    """Return the trajectory there (0) or back (1) with caps of the speed of tool or links."""
    path = [
        [-1.2, 0.0, 0, -2.0, 0, 2.2, 0.785],
        [0.0, -0.4, 0, -2.0, 0, 2.0, 0.785],
        [1.2, 0.0, 0, -2.0, 0, 2.2, 0.785],
    ]
    limits = to_and_fro(replanner)[0].limits
    return time_path(path[::-1] if way else path, panda, limits, motion=replanner.prover, **speeds)


def fastest(panda, commands, points):
    """Return the largest speed of points of the robot, by differences over 1 ms [m/s]."""
    found = 0.0
    for command in commands:
        for t in np.linspace(command.time, command.time + 0.048, 5):
            moved = points(command.at(t + 1e-3).q) - points(command.at(t).q)
            found = max(found, float(np.linalg.norm(moved, axis=-1).max()) / 1e-3)
    return found


def test_other_ways_keep_caps_of_tool_speed(replanner_for, to_and_fro, panda):
    reached = []
    for limit in (1.0, 10.0):
        replanner = replanner_for("ball", ball=0.1)
        commands = driven(replanner, slowed(replanner, to_and_fro, panda, tool_speed=limit), lambda t: BARRED, 25.0)
        assert commands[-1].doing is Doing.DONE
        assert len({id(command.path) for command in commands}) > 1
        reached.append(fastest(panda, commands, lambda q: panda.tip_pose(q).translation[None]))
    assert 0.5 < reached[0] <= 1.001
    assert reached[1] > 1.2  # it is the cap that slows it


def test_a_path_under_a_cap_of_link_speed_keeps_it_everywhere(panda, to_and_fro, replanner_for):
    way = to_and_fro(replanner_for("ball"))[0]
    path = GuardedPath.along(RobotBodies(panda), way.curve, PathLimits(way.limits, link_speed=0.7))
    for s, square in zip(0.5 * (path.edges[1:] + path.edges[:-1]), path.squares, strict=True):
        place = path.curve.at(np.array([s]))
        step = 1e-5 * np.sqrt(square)
        moved = panda.keypoints(place.q[0] + step * place.slope[0]) - panda.keypoints(place.q[0])
        assert np.linalg.norm(moved, axis=1).max() <= 0.7 * 1e-5 * 1.001
    assert path.squares.min() < GuardedPath.along(path.bodies, way.curve, PathLimits(way.limits)).squares.min()


def test_other_limits_make_other_times_but_no_other_proofs(roadmap):
    roadmap, replanner, way = roadmap
    start, goal = way.at([0.0, way.duration]).q
    people = around(replanner, FAR)
    roadmap.left = 2000
    _, fast = roadmap.quickest(start, goal, people, 0.0, 60.0)
    roadmap.keep_to(replace(roadmap.limits, tool_speed=0.3))
    roadmap.left = 20000
    _, slow = roadmap.quickest(start, goal, people, 0.0, 60.0)
    assert slow > 1.5 * fast
    assert roadmap.left < 20000
    left = roadmap.left
    roadmap.keep_to(roadmap.limits)
    assert roadmap.quickest(start, goal, people, 0.0, 60.0)[1] == slow
    assert roadmap.left == left


@pytest.mark.parametrize(("bound", "limit"), [(0.0, 1.0), (0.5, None)])
def test_a_robot_finds_away_from_what_it_stands_beside(replanner_for, to_and_fro, panda, bound, limit):
    """The slower it is, the nearer to an obstacle it comes before it stands: nearer than large cells can tell."""
    replanner = replanner_for("ball", ball=bound)
    way = slowed(replanner, to_and_fro, panda, tool_speed=limit)
    commands = driven(replanner, way, lambda t: BARRED, 15.0)
    assert Doing.STANDING in {command.doing for command in commands}
    assert commands[-1].doing is Doing.DONE


def test_a_slow_robot_finds_detours_that_take_long(replanner_for, to_and_fro, panda):
    replanner = replanner_for("ball", ball=0.0)
    way = slowed(replanner, to_and_fro, panda, tool_speed=0.04)
    assert way.duration > 30.0
    commands = driven(replanner, way, lambda t: BARRED, 6.0)
    assert len({id(command.path) for command in commands}) > 1


def test_a_new_trajectory_brings_its_limits(replanner_for, to_and_fro, panda):
    replanner = replanner_for("ball", ball=0.1)
    driven(replanner, slowed(replanner, to_and_fro, panda), lambda t: FAR, 6.0)
    replanner.start(slowed(replanner, to_and_fro, panda, 1, tool_speed=1.0))
    assert replanner.detours.limits.tool_speed == 1.0


def test_no_other_way_is_taken_where_a_cap_holds_on_its_own_curve_only(replanner_for, to_and_fro, panda, caplog):
    replanner = replanner_for("ball", ball=0.1)
    slow = slowed(replanner, to_and_fro, panda, tool_speed=0.5)
    unknown = replace(slow, caps=tuple(replace(cap, limit=None) for cap in slow.caps))
    with caplog.at_level(logging.INFO, "safe_ompl"):
        commands = driven(replanner, unknown, lambda t: BARRED, 3.0)
    assert len({id(command.path) for command in commands}) == 1
    assert "nothing proves the cap 'tool speed' on them" in caplog.text
    assert fastest(panda, commands, lambda q: panda.tip_pose(q).translation[None]) <= 0.5 * 1.001


def test_other_ways_keep_the_limits_of_the_motion(panda, table, to_and_fro):
    post = Obstacle("post", Box((0.05, 0.05, 0.6)), Pose((0.75, 0.0, 0.9)))
    scene = Scene((*table, post))
    still = MotionProver(CollisionChecker(panda, scene.without("ball")))
    motion = still.with_min_clearance(0.1, ["post"])
    replanner = Replanner(panda, scene, {}, {"ball": 0.1}, prover=motion)
    commands = driven(replanner, to_and_fro(replanner)[0], lambda t: BARRED, 20.0)
    assert len({id(command.path) for command in commands}) > 1
    nearest = [
        replanner.prover.separation.required(motion.checker).violating_pair(command.at(t).q)
        for command in commands
        for t in np.linspace(command.time, command.time + 0.05, 4)
    ]
    assert not any(nearest)
    with pytest.raises(InputError, match=r"prover: 'ball' is in its scene, but it moves"):
        Replanner(panda, table, {}, {"ball": 0.1}, prover=MotionProver(CollisionChecker(panda, table)))
    empty = MotionProver(CollisionChecker(panda, scene.without("ball", "post")))
    with pytest.raises(InputError, match=r"prover: 'post' is not in its scene"):
        Replanner(panda, scene, {}, {"ball": 0.1}, prover=empty)


def test_paths_are_cut_and_joined_as_they_were(panda):
    limits = RateLimits.of(panda, acceleration=10.0)
    bodies = RobotBodies(panda)
    points = np.array([[0, 0, 0, -2.0, 0, 2, 0.7], [0.5, 0, 0, -2.0, 0, 2, 0.7], [0.5, 0.4, 0, -2.0, 0, 2, 0.7]])
    path = GuardedPath.of(bodies, time_path(points, panda, limits))
    part = path.from_to(0.55, 0.8)
    np.testing.assert_allclose(
        part.curve.at(np.array([0.0, part.length])).q, [points[1], path.curve.at(np.array([0.8])).q[0]]
    )
    assert part.length == pytest.approx(0.3)
    rest = GuardedPath.along(
        bodies,
        time_path([part.curve.at(np.array([part.length])).q[0], points[0]], panda, limits).curve,
        PathLimits(limits),
    )
    whole = part.then(rest)
    assert whole.length == pytest.approx(part.length + rest.length)
    assert whole.ceiling[len(part.brakes)] == 0  # it stops where they meet
    np.testing.assert_allclose(whole.curve.at(np.array([whole.length])).q[0], points[0], atol=1e-12)
    assert len(whole.brakes) == len(whole.frames.travel) == len(whole.frames.origins) == len(whole.edges) - 1


def test_joined_paths_have_an_acceleration_in_every_cell_however_lengths_are_rounded(panda):
    limits, bodies = PathLimits(RateLimits.of(panda, acceleration=10.0)), RobotBodies(panda)
    points = np.array([0, 0, 0, -2.0, 0, 2, 0.7]) + 0.1 * np.random.default_rng(0).uniform(size=(31, 7))
    ways = [GuardedPath.along(bodies, line(a, b), limits) for a, b in pairwise(points)]
    whole, rounded = ways[-1], 0
    for way in ways[-2::-1]:
        whole = way.then(whole)
        rounded += whole.length != whole.curve.length
        assert len(whole.accelerations) == len(whole.brakes)
    assert rounded
