"""Obstacles that move in place, against checkers made anew."""

from contextlib import contextmanager
from threading import Event, Thread
from time import sleep

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import CollisionChecker, InputError, MotionProver, Scene, UnknownNameError
from safe_ompl.collision import PairDistances, Separation
from safe_ompl.geometry import STANDING, Box, Cylinder, Obstacle, Person, PointCloud, Pose, Sphere

MOVES = 60
MOVABLE = ("box", "ball", "colleague", "cloud", "specks")


def cloud_points(rng, count):
    return rng.uniform(-0.15, 0.15, (count, 3)) + rng.uniform(-0.6, 0.6, 3)


@pytest.fixture
def scene(rng):
    return Scene(
        (
            Obstacle("table", Box((1.2, 0.8, 0.05)), Pose((0.4, 0.0, -0.2))),
            Obstacle("box", Box((0.1, 0.2, 0.3)), Pose((0.5, 0.3, 0.4)), weight=0.5),
            Obstacle("ball", Sphere(0.1), Pose((-0.4, 0.3, 0.6))),
            Obstacle("colleague", Person(), Pose((0.9, 0.2, -0.8))),
            Obstacle("post", Cylinder(0.05, 1.0), Pose((-0.5, -0.5, 0.5))),
            Obstacle("cloud", PointCloud(0.02, points=cloud_points(rng, 60))),
            Obstacle("specks", PointCloud(0.02, points=cloud_points(rng, 4))),
        )
    )


def random_pose(rng, reach=0.8):
    turn = pin.Quaternion(rng.normal(size=4)).normalized()
    return Pose(tuple(rng.uniform(-reach, reach, 3)), tuple(turn.coeffs()))


def key_points(rng):
    """All key points of someone who stands somewhere, each of them shaken."""
    place = np.array([*rng.uniform(-0.9, 0.9, 2), -0.8])
    return {name: 1.75 * point + place + rng.normal(0.0, 0.03, 3) for name, point in STANDING.items()}


def random_places(rng):
    """Return new places for some of the obstacles."""
    makers = {
        "box": random_pose,
        "ball": random_pose,
        "colleague": lambda rng: key_points(rng) if rng.random() < 0.8 else random_pose(rng),
        "cloud": lambda rng: cloud_points(rng, rng.integers(40, 80)) if rng.random() < 0.5 else random_pose(rng),
        "specks": lambda rng: cloud_points(rng, 4),
    }
    chosen = rng.choice(MOVABLE, rng.integers(1, 4), replace=False)
    return {str(name): makers[str(name)](rng) for name in chosen}


@pytest.mark.parametrize("name", ["panda", "twin_arm"])
def test_after_any_moves_answers_are_those_of_a_checker_made_anew(robot_named, scene, rng, name):
    robot = robot_named(name)
    checker = CollisionChecker(robot, scene, movable=MOVABLE)
    wide, near = checker.pairs_within(0.1), PairDistances(checker, 0.1)
    motion = MotionProver(checker, separation=Separation(margin=0.02))
    touched = free = 0
    for _ in range(MOVES // 3):
        scene = scene.moved(random_places(rng))
        checker.move(scene)
        anew = CollisionChecker(robot, scene, movable=MOVABLE)
        pruned = CollisionChecker(robot, scene)
        assert checker.scene is scene
        np.testing.assert_array_equal(checker.pairs.radii, anew.pairs.radii)
        np.testing.assert_array_equal(wide.radii, anew.pairs_within(0.1).radii)
        Q = rng.uniform(robot.lower, robot.upper, (4, robot.n))
        for q in Q:
            assert checker.in_collision(q) == anew.in_collision(q) == pruned.in_collision(q)
            assert checker.colliding_pair(q) == anew.colliding_pair(q)
            assert wide.within_margins(q, wide.margins(0.1)) == anew.pairs_within(0.1).within_margins(
                q, wide.margins(0.1)
            )
            np.testing.assert_allclose(checker.distances(q), anew.distances(q), rtol=0, atol=1e-12)
            np.testing.assert_allclose(checker.distances(q), pruned.distances(q), rtol=0, atol=1e-12)
            np.testing.assert_allclose(checker.pair_distances(q), anew.pair_distances(q), rtol=0, atol=1e-12)
            np.testing.assert_array_equal(checker.pair_radii_at(q), anew.pair_radii_at(q))
            touched += checker.in_collision(q)
        found, expected = near.near(Q, 0.1), PairDistances(anew, 0.1).near(Q, 0.1)
        apart = found.table[:, 2] > 0
        np.testing.assert_array_equal(found.table[apart], expected.table[apart])
        proof = MotionProver(anew, separation=Separation(margin=0.02))
        for q in Q[:2]:
            end = np.clip(q + rng.normal(0.0, 0.1, robot.n), robot.lower, robot.upper)
            verdict = motion.check(q, end)
            assert verdict == proof.check(q, end)
            free += verdict.verdict.value == "free"
    assert touched > 10, "both answers occur"
    assert free > 5


def test_an_obstacle_that_was_out_of_reach_is_seen_when_it_comes(panda):
    far = Scene((Obstacle("ball", Sphere(0.1), Pose((5.0, 0.0, 0.0))),))
    checker = CollisionChecker(panda, far, movable=["ball"])
    q = (panda.lower + panda.upper) / 2
    assert not checker.in_collision(q)
    checker.move(far.moved({"ball": Pose(tuple(panda.tip_pose(q).translation))}))
    assert checker.in_collision(q)
    assert checker.revision == 1


def test_what_does_not_move_changes_nothing(panda, scene):
    checker = CollisionChecker(panda, scene, movable=["box"])
    checker.move(scene.moved({"box": scene["box"].pose}))
    assert checker.revision == 0


def test_only_places_of_movable_obstacles_may_differ(panda, scene):
    checker = CollisionChecker(panda, scene, movable=("box", "specks"))
    q = np.zeros(panda.n)
    before = checker.distances(q)
    elsewhere = Pose((2.0, 0.0, 0.0))
    bigger = [Obstacle("box", Box((0.2, 0.2, 0.3))) if o.name == "box" else o for o in scene]
    for other, why in (
        (scene.moved({"box": elsewhere, "ball": elsewhere}), "'ball' is not movable"),
        (scene.without("post"), "must have the same obstacles"),
        (Scene(tuple(bigger)), "'box' may only be moved, but not changed"),
        (scene.moved({"specks": np.zeros((3, 3))}), "'specks' has other parts than before"),
    ):
        with pytest.raises(InputError, match=why):
            checker.move(other)
    np.testing.assert_allclose(checker.distances(q), before, rtol=0, atol=1e-12)
    assert checker.scene is scene


def test_names_of_movable_obstacles_are_checked(panda, scene):
    with pytest.raises(UnknownNameError, match="boxx"):
        CollisionChecker(panda, scene, movable=["boxx"])
    with pytest.raises(InputError, match="list of names"):
        CollisionChecker(panda, scene, movable="box")


def test_threads_that_ask_a_new_set_of_pairs_at_once_do_not_wait_for_each_other(panda, clutter, monkeypatch):
    checker = CollisionChecker(panda, clutter)
    pairs, q = checker.pairs_within(0.5), np.zeros(panda.n)
    read_lock, held = checker.changes.read_lock, Event()

    @contextmanager
    def held_for_long():
        with read_lock():
            held.set()
            sleep(0.2)  # meanwhile the other thread wants the bounds
            yield

    late = Thread(target=lambda: held.wait(10.0) and pairs.bounds, daemon=True)
    late.start()
    monkeypatch.setattr(checker.changes, "read_lock", held_for_long)
    early = Thread(target=lambda: pairs.within_margins(q, pairs.margins(0.1)), daemon=True)
    early.start()
    for thread in (early, late):
        thread.join(10.0)
        assert not thread.is_alive()
