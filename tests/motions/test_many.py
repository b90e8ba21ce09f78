"""Many motions at once: the same is said of each as alone, whatever the number of workers."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import safe_ompl
from safe_ompl import CollisionChecker, Constraints, DangerField, DangerLimit, InputError, MotionProver, RateLimits
from safe_ompl.collision import Separation


def ways(robot, number, seed=0):
    """Return way points (number, 4, n) within the limits."""
    rng = np.random.default_rng(seed)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    Q = rng.uniform(lower, upper, (number, 1, robot.n))
    return np.clip(Q + np.cumsum(rng.normal(0.0, 0.15, (number, 4, robot.n)), axis=1), lower, upper)


@pytest.mark.parametrize("name", ["panda", "kinova", "twin_arm"])
@pytest.mark.parametrize("margin", [0.0, 0.03])
def test_motions_are_proven_together_as_alone(robot_named, clutter, name, margin):
    robot = robot_named(name)
    starts, ends = ways(robot, 500)[:, :2].swapaxes(0, 1)
    ends[::70] = robot.upper + 1.0
    proof = MotionProver(CollisionChecker(robot, clutter), separation=Separation(margin=margin))
    alone = np.array([proof.is_free(start, end) for start, end in zip(starts, ends, strict=True)])
    assert 60 < alone.sum() < 440
    for workers in (1, 3):
        np.testing.assert_array_equal(proof.are_free(starts, ends, workers=workers), alone)
    np.testing.assert_array_equal(proof.are_free(np.asfortranarray(starts), np.asfortranarray(ends)), alone)
    if not margin:
        inside = robot.within_limits(ends).all(axis=1)
        found = safe_ompl.prove_many(starts[inside], ends[inside], robot, clutter, workers=2)
        np.testing.assert_array_equal(found, alone[inside])


def test_constraints_are_proven_too(panda, clutter):
    Q = ways(panda, 120)
    field = DangerField(panda, np.array([[0.5, 0.1, 0.5]]))
    wanted = Constraints(danger=DangerLimit(field, float(np.median(field.values(Q[:, 0])))))
    motion = MotionProver(CollisionChecker(panda, clutter), limits=wanted.limits)
    alone = [motion.is_free(way[0], way[1]) for way in Q]
    found = safe_ompl.prove_many(Q[:, 0], Q[:, 1], panda, clutter, constraints=wanted)
    assert found.tolist() == alone
    assert 0 < sum(alone) < safe_ompl.prove_many(Q[:, 0], Q[:, 1], panda, clutter).sum()


def test_no_motion_at_all(panda, clutter):
    none = np.empty((0, panda.n))
    assert safe_ompl.prove_many(none, none, panda, clutter, workers=2).shape == (0,)
    assert safe_ompl.check_many([], panda, clutter, workers=2) == []


def test_checks_are_those_of_each_motion_alone(panda, clutter):
    limits = RateLimits.of(panda, acceleration=20.0)
    motions = [*ways(panda, 4), *(CubicSpline([0.0, 1.0, 2.0, 3.0], way) for way in ways(panda, 3, seed=1))]
    alone = [safe_ompl.check(motion, panda, clutter, limits=limits, tube=0.001) for motion in motions]
    assert {True, False} == {bool(check) for check in alone}
    for workers in (1, 2):
        found = safe_ompl.check_many(iter(motions), panda, clutter, limits=limits, tube=0.001, workers=workers)
        assert len({check.proof for check in found}) == 1
        for check, other in zip(found, alone, strict=True):
            assert (str(check), check.claims, repr(check.limits)) == (str(other), other.claims, repr(other.limits))
            np.testing.assert_array_equal(check.motion.coefficients, other.motion.coefficients)
            assert check.proof.checker.scene is clutter
            assert check.separation.tube == other.separation.tube


@pytest.mark.parametrize("workers", [1, 2])
def test_bad_input_is_named(panda, clutter, workers):
    Q = ways(panda, 2)
    with pytest.raises(InputError, match="motion 1: "):
        safe_ompl.check_many([Q[0], Q[0][:, :3], Q[1]], panda, clutter, workers=workers)
    for starts, ends in ((Q[:, 0], Q[1:, 1]), (Q[:, 0], Q[:, 1, :3]), (Q[:, 0], Q[:, 1] * np.inf)):
        with pytest.raises(InputError, match="motions"):
            safe_ompl.prove_many(starts, ends, panda, clutter, workers=workers)
    for call in (safe_ompl.check_many, lambda Q, *about, **more: safe_ompl.prove_many(Q, Q, *about, **more)):
        with pytest.raises(InputError, match="workers"):
            call(Q[0], panda, clutter, workers=0)
