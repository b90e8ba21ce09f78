"""Motions of others beside people: proven stops end before anyone is there, and those that are not proven are named."""

import pickle

import numpy as np
import pytest
from limbs import Limbs, least_left
from scipy.interpolate import CubicSpline

from safe_ompl import InputError, Motion, Obstacle, People, Person, Pose, RateLimits, Scene
from safe_ompl.certificates import motion_certificate
from safe_ompl.motions import check


@pytest.fixture(scope="module")
def spline(panda, shelf):
    """Return a function that makes a spline past the operator that takes so long."""
    ends = shelf.start_configuration(panda), shelf.goal_configurations(panda)[0]
    between = [[0.7, -0.6, 0, -2.2, 0, 3.0, 0.785], [-0.7, -0.6, 0, -2.4, 0, 2.6, 0.785]]

    def make(duration, knots=4):
        path = CubicSpline(np.linspace(0, 1, 4), [ends[0], *between, ends[1]], bc_type="clamped")
        at = np.linspace(0, 1, knots)
        return CubicSpline(duration * at, path(at), bc_type="clamped")

    return make


def left_beside(found, limbs, number):
    """Return the least that is left [m] when people run at the robot while it stops, over stops from many instants."""
    motion = found.motion

    def stop_from(begin):
        law = found.stops.stop_from(begin)

        def at(t):
            _, time, rate, _ = (x[0] for x in law.at(np.array([t])))
            return motion.at(time), motion.derivative(time) * rate

        return law.duration, at

    begins = np.random.default_rng(0).uniform(*motion.times[[0, -1]], number)
    return least_left(stop_from, begins, limbs, found.people)


@pytest.mark.parametrize(
    ("people", "slow"),
    [
        (People(), 6.0),
        (People(speed=1.2, reaction_time=0.05, clearance=0.05), 3.0),
        (People(speed=1.0, speeds={"right_hand": 2.0, "head": 0.3}), 2.5),
        (People(contact=True), 5.5),
    ],
)
def test_nobody_is_reached_in_a_stop_of_a_proven_motion(panda, shelf, panda_limits, spline, people, slow):
    limbs = Limbs(panda, shelf.scene["operator"])
    found = check(spline(slow), panda, shelf.scene, limits=panda_limits, people=people)
    assert found, found
    assert pickle.loads(pickle.dumps(found)).claims == found.claims
    assert found.claims[-1].endswith("beside people")
    assert 0 < left_beside(found, limbs, 25) < 0.1
    hasty = check(spline(0.6 * slow), panda, shelf.scene, limits=panda_limits, people=people)
    (worst, *_) = [v for v in hasty.violations if v.kind == "separation" and v.decided]
    assert worst.names[1].startswith("operator (")
    assert worst.value < worst.limit == people.clearance
    assert hasty.motion.times[0] <= worst.first <= worst.at <= worst.last <= hasty.motion.times[-1]
    assert left_beside(hasty, limbs, 25) < 0  # the adversary can win


def stairs(at, count=800, step=0.99e-6, span=1e-7):
    """Return pieces at rest, each a step from the one before, at 9.9 rad/s; and a rest."""
    held = np.zeros((count + 1, 2, len(at)))
    held[:, 0] = at
    held[:, 0, 0] += step * np.minimum(np.arange(count + 1), count - 1)
    return Motion(np.append(span * np.arange(count + 1), 1.0), held)


@pytest.mark.parametrize("kind", ["staircase", "slow"])
def test_what_moves_is_not_at_rest(panda, shelf, spline, kind):
    """Neither in steps between pieces at rest, nor slower than a share of an absurd limit."""
    motion = spline(8000.0) if kind == "slow" else stairs(spline(1.0)(0.5))
    limits = RateLimits.of(panda, 999.0, 20.0)
    if kind == "slow":  # 2e-6 of the largest limit is more than its velocity
        assert 1e-4 < np.abs(motion(motion.x, 1)).max() < 999e-6
    found = check(motion, panda, shelf.scene, limits=limits, people=People(reaction_time=1.0))
    assert "separation" in {violation.kind for violation in found.violations}


def test_stops_stay_on_the_motion_within_its_panda_limits_and_end_at_rest(panda, shelf, panda_limits, spline):
    found = check(spline(5.0), panda, shelf.scene, limits=panda_limits, people=People())
    motion = found.motion
    for begin in np.linspace(0.0, 5.0, 41):
        law = found.stops.stop_from(begin)
        t = np.linspace(0.0, law.duration, 300)[:-1]
        _, at, rate, push = law.at(t)
        assert at[0] == begin
        assert (np.diff(rate) <= 1e-12).all()
        qd = motion.derivative(at) * rate[:, None]
        qdd = motion.derivative(at, 2) * rate[:, None] ** 2 + motion.derivative(at) * push[:, None]
        assert (np.abs(qd) <= panda_limits.velocity * (1 + 1e-6)).all()
        assert (np.abs(qdd) <= panda_limits.acceleration * (1 + 2e-6)).all()
        end, last = law.edges[-1], np.sqrt(law.squared_speeds[-1])
        assert np.abs(motion.derivative(end) * last).max() < 1e-6


def test_a_motion_that_waits_may_stop_where_it_waits(panda):
    """Away from a person, a rest, and back: stops end at the rest, and what is near there does not matter."""
    scene = Scene([Obstacle("person", Person(height=1.75), Pose((0.95, 0.0, -0.75)), weight=1.0)])
    near, away = np.array([[0.2, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8], [1.6, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8]])
    limits, rest = RateLimits.of(panda, acceleration=8.0), np.zeros(7)
    waits = Motion.hermite([0, 2, 30, 32], [near, away, away, near], [rest] * 4)
    found = check(waits, panda, scene, limits=limits, people=People(reaction_time=0.15))
    for begin in np.linspace(0.0, 2.0, 20)[:-1]:
        assert found.stops.stop_from(begin).edges[-1] <= 2.0
    assert found.stops.stop_from(31.0).edges[-1] > 31.0
    late = [violation for violation in found.violations if violation.kind == "separation"]
    assert late
    assert not any(violation.first < 30.0 and violation.last > 2.0 for violation in late)


def test_what_cannot_be_proven_beside_people_is_refused(panda, shelf, panda_limits, spline):
    def said(motion, **more):
        given = {"limits": panda_limits, "people": People(), **more}
        with pytest.raises(InputError) as caught:
            check(motion, panda, shelf.scene, **given)
        return str(caught.value)

    motion = spline(8.0)
    points = motion(motion.x)
    assert said(motion, limits=None).startswith("limits: give limits")
    jerk = RateLimits(
        panda_limits.joint_names, panda_limits.velocity, panda_limits.acceleration, 100 * panda_limits.acceleration
    )
    assert "trajectories of safe-ompl" in said(motion, limits=jerk)
    assert "no times" in said(points)
    assert "bare samples" in said(Motion.sampled(motion.x, points, 2.0))
    assert "must end at rest" in said(Motion.hermite(motion.x, points))
    assert "contacts" in said(motion, tube=0.005, people=People(contact=True))
    empty = Scene([])
    with pytest.raises(InputError, match="no claim"):
        motion_certificate(check(motion, panda, shelf.scene, limits=panda_limits, people=People()))
    with pytest.raises(InputError, match="no person"):
        check(motion, panda, empty, limits=panda_limits, people=People())
