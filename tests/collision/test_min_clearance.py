"""Distances that must be kept: proven along whole motions, from obstacles that stand still and from those that move."""

import pickle

import numpy as np
import pytest

from safe_ompl import InputError, Obstacle, Pose, Scene, Sphere, UnknownNameError
from safe_ompl.collision import CollisionChecker, MotionProver, Separation, Verdict


def balls(**places):
    """Balls of 0.05 m on the x axis."""
    return Scene(tuple(Obstacle(name, Sphere(0.05), Pose((x, 0, 0)), weight=1.0) for name, x in places.items()))


def near(checker, *wanted, **options):
    """Return what proves another distance from chosen obstacles."""
    return MotionProver(checker, separation=Separation().with_min_clearance(checker, *wanted, **options))


START, END = np.array([-0.7]), np.array([0.8])  # the ball on the crank passes the x axis at 0.5 m


# ------------------------------------------------------------------------------------------- obstacles at rest


def test_what_never_touches_may_come_too_near(crank):
    checker = CollisionChecker(crank, balls(far=0.65))  # 50 mm beyond reach
    motion = MotionProver(checker)
    assert checker.pair_names == (), "left out of the collision queries"
    assert motion.is_free(START, END)
    assert near(checker, 0.04).is_free(START, END)
    farther = near(checker, 0.06)
    assert checker.pair_names == (), "nothing changes what the checker looks at"
    found = farther.check(START, END)
    assert (found.verdict, found.pair) == (Verdict.BLOCKED, ("ball", "far"))
    assert found.at == pytest.approx(0.7 / 1.5, abs=0.1)
    required = farther.separation.required(checker)
    assert required.pairs.names == (("ball", "far"),)
    assert required.violated(np.zeros(1))
    assert required.violating_pair(np.zeros(1)) == ("ball", "far")
    assert not required.violated(np.ones(1))
    assert required.violating_pair(np.ones(1)) is None
    assert not checker.in_collision(np.zeros(1))


def test_pairs_that_come_within_a_reach_follow_those_that_may_touch(crank, clutter, panda):
    for robot, scene, number in ((crank, balls(far=0.65, near=0.5), 1), (panda, clutter, None)):
        checker = CollisionChecker(robot, scene)
        names, radii = checker.pair_names, checker.pairs.radii
        assert number in (None, len(names))
        wide = checker.pairs_within(1.0)
        assert len(wide.names) > len(names)
        assert wide.names[: len(names)] == names
        np.testing.assert_array_equal(wide.radii[: len(names)], radii)
        assert checker.pairs.names == checker.pair_names == names


def test_exempt_pairs_and_chosen_obstacles(crank):
    checker = CollisionChecker(crank, balls(far=0.65, near=0.62))
    assert near(checker, 0.04).check(START, END).pair == ("ball", "near")
    with pytest.raises(InputError, match=r"must leave a moving link that keeps away from 'near', got .*ball"):
        near(checker, 0.04, exempt=[("ball", "near")])
    chosen = near(checker, 0.04, ["far"])
    assert chosen.is_free(START, END)
    assert chosen.separation.min_clearance.obstacles == ("far",)
    assert near(checker, 0.0).separation == MotionProver(checker).separation == Separation()
    assert not MotionProver(checker).required.any
    both = Separation(margin=0.04).with_min_clearance(checker, 0.01, ["far"])
    assert MotionProver(checker, separation=both).check(START, END).pair == ("ball", "near"), "the margin holds beside"


def test_people_by_default(crank):
    scene = Scene((Obstacle("box", Sphere(0.05), Pose((0.62, 0, 0))), *balls(person=-0.9)))
    motion = near(CollisionChecker(crank, scene), 0.1)
    assert motion.separation.min_clearance.obstacles == ("person",)
    assert motion.is_free(START, END)


@pytest.mark.parametrize("bad", [-0.1, np.nan, np.inf, "0.1"])
def test_what_is_kept_is_given_in_numbers(crank, bad):
    checker = CollisionChecker(crank, balls(walker=0.9))
    for make, message in (
        (lambda: near(checker, bad), "min clearance: must be a finite length"),
        (lambda: Separation(margin=bad), "margin: must be a finite length"),
        (lambda: Separation(speeds={"walker": bad}, time=1.0), "speed of 'walker': must be a finite number"),
        (lambda: Separation(speeds={"walker": 1.0}, time=bad), "time: must be a finite number of seconds"),
        (lambda: MotionProver(checker, bad), "floor: must be a positive length"),
        (lambda: MotionProver(checker, 0.0), "floor: must be a positive length"),
    ):
        with pytest.raises(InputError, match=message):
            make()


def test_a_separation_is_a_value(crank):
    speeds = {"walker": 0.5}
    separation = Separation(margin=0.1, speeds=speeds, time=2.0)
    speeds["walker"] = 9.0
    assert separation == Separation(None, 0.1, {"walker": 0.5}, 2.0) == pickle.loads(pickle.dumps(separation))
    assert separation.reach == pytest.approx(1.1)
    with pytest.raises(TypeError):
        separation.speeds["walker"] = 0.0
    with pytest.raises(AttributeError):
        separation.margin = 0.0


def test_names_are_checked(crank):
    checker = CollisionChecker(crank, balls(a=0.9, b=0.8))
    for arguments, message in (
        ((0.1, ["c"]), "unknown obstacle 'c'; known: a, b"),
        ((0.1, None, [("bal", "a")]), "unknown link 'bal'; did you mean 'ball'"),
        ((0.1, None, [("ball", "c")]), "unknown obstacle 'c'"),
        ((0.1, "a", []), "obstacles must be a list of names, got 'a'"),
        ((0.1, ["a"], [("ball",)]), "exempt must be pairs of a link and an obstacle, not "),
        ((0.1, ["a"], [("ball", "b")]), "exempt from keeping a distance to 'b', which has no min clearance"),
    ):
        with pytest.raises(InputError, match=message):
            near(checker, *arguments)
    harmless = Scene((Obstacle("box", Sphere(0.05), Pose((0.9, 0, 0))),))
    with pytest.raises(InputError, match="no obstacle has a danger weight"):
        near(CollisionChecker(crank, harmless), 0.1)


# ----------------------------------------------------------------------------------------- obstacles that move


def test_obstacles_that_move_come_on_top_of_a_clearance(crank):
    checker = CollisionChecker(crank, balls(walker=1.0))  # 0.4 m from where the crank passes

    def proof(speed, time, clearance=0.0):
        kept = Separation(speeds={"walker": speed}, time=time)
        return MotionProver(checker, separation=kept.with_min_clearance(checker, clearance))

    assert proof(0.5, 0.7).is_free(START, END)
    assert proof(0.5, 0.9).check(START, END).pair == ("ball", "walker")
    assert not proof(0.5, 0.9).is_free(START, END)
    assert not proof(0.5, 0.7, 0.06).is_free(START, END)
    assert proof(0.5, 0.7, 0.04).is_free(START, END)
    assert proof(0.0, 9.0).is_free(START, END)
    with pytest.raises(UnknownNameError, match="unknown obstacle 'runner'; known: walker"):
        MotionProver(checker, separation=Separation(speeds={"runner": 1.0}, time=1.0))
