"""A robot that stands gets away from who comes too near for any other motion, and goes on once its way is open."""

import numpy as np
import pytest
from scipy.optimize import nnls
from swinging import drive_replanner

from safe_ompl import Pose, RateLimits
from safe_ompl.live import ReachSets
from safe_ompl.live.replanning import Action, SpeedLimits
from safe_ompl.live.replanning.bounded_path import RETREAT_SPEED, BoundedPath, RobotBodies, line
from safe_ompl.live.replanning.replanner import Receding, Retreats

FAR = Pose((3.0, 0.0, 0.0))


def balls(places):
    """Return the sets of balls of 30 mm that stand at places (M, 3)."""
    places = np.array(places, dtype=float).reshape(-1, 1, 3)
    names = tuple((f"ball {k}", "") for k in range(len(places)))
    growth = np.tile([0.0, 1.6], (len(places), 1))
    return ReachSets.of(names, places, np.full(len(places), 0.03), growth)


@pytest.fixture(scope="module")
def bodies(panda):
    return RobotBodies(panda)


@pytest.fixture(scope="module")
def limits(panda):
    return SpeedLimits(RateLimits.of(panda, acceleration=10.0))


def core_distances(bodies, q, places):
    """Return distances (G, M) of hulls from points: of the nearest convex combinations of the vertices.

    The x ≥ 0 that minimise ‖V x‖² + (1ᵀx − 1)², for vertices V as seen from a point, are weights of the nearest
    combination but for a factor. A large weight of the sum instead makes results depend on SciPy's version.
    """
    frames = bodies.frames(q[None])
    found = np.empty((len(bodies.links), len(places)))
    for g in range(len(bodies.links)):
        for m, place in enumerate(places):
            seen = (bodies.vertices(g, frames)[0] - place).T
            weights = nnls(np.vstack([seen, np.ones(seen.shape[1])]), [0.0, 0.0, 0.0, 1.0])[0]
            found[g, m] = np.linalg.norm(seen @ weights) / weights.sum()
    return found


@pytest.mark.parametrize("seed", range(4))
def test_who_is_receded_from_is_nowhere_nearer_than_at_the_start(panda, bodies, limits, seed):
    rng = np.random.default_rng(seed)
    q = rng.uniform(panda.lower, panda.upper) * 0.5
    tip = panda.tip_pose(q).translation
    places = tip + rng.normal(size=(6, 3)) * 0.2
    way = rng.normal(size=panda.n)
    path = BoundedPath.along(bodies, line(q, q + 0.3 * way / np.linalg.norm(way)), limits)
    motion = path.motion_from(0.0, 0.0, 1.0, 0.1)
    away = Receding(path, motion.places[0], balls(places)).along(motion)
    assert not away.all()
    away[bodies.turning] = False  # they stay behind what they sweep
    at_first = core_distances(bodies, q, places)
    for s in np.linspace(0.0, motion.places[-1], 12):
        now = core_distances(bodies, path.curve.places(np.array([s])).q[0], places)
        assert (now[away] >= at_first[away] - 1e-5).all()
    assert away.any()


def test_what_is_touched_already_or_passed_a_corner_does_not_recede(panda, bodies, limits):
    q = np.array([0.0, -0.4, 0, -2.0, 0, 2.0, 0.785])
    out, back = line(q, q - 0.05), line(q - 0.05, q)
    path = BoundedPath.along(bodies, out, limits)
    inside = panda.tip_pose(q).translation - 0.02 * np.eye(3)[2]
    motion = path.motion_from(0.0, 0.0, 1.0, 0.1)
    assert not Receding(path, motion.places[0], balls([inside])).along(motion)[bodies.links.index("panda_hand")].any()
    both = path.then(BoundedPath.along(bodies, back, limits))
    corner = both.motion_from(path.length - 0.01, 0.0, 1.0, 0.3)
    assert corner.places[0] < path.length < corner.places[-1]
    assert not Receding(both, corner.places[0], balls([inside - 0.3 * np.eye(3)[1]])).along(corner).any()


def test_a_retreat_leads_away_from_all_who_are_near_and_back_and_none_if_nobody_is(
    panda, replanner_for, bodies, limits
):
    retreats = Retreats(replanner_for("ball").prover, bodies, limits)
    q = np.array([0.0, -0.4, 0, -2.0, 0, 2.0, 0.785])
    goal = q + 0.6 * np.eye(7)[0]
    way = BoundedPath.along(bodies, line(q, goal), limits)
    places = panda.tip_pose(q).translation + np.array([[0.12, 0.05, 0.0], [0.12, -0.05, 0.05]])
    path = retreats.search(way, 0.0, balls(places))
    start, away, back, end = path.curve.places(path.curve.times).q
    np.testing.assert_allclose([start, back, end], [q, q, goal], atol=1e-12)
    at_first, then = (core_distances(bodies, each, places)[7:] for each in (q, away))
    assert (then >= at_first - 1e-5).all()
    assert then.min() > at_first.min() + 0.02
    assert retreats.search(way, 0.0, balls([[3.0, 0.0, 0.0]])) is None


def beside_the_tip(replanner, commands, gone):
    """Return what is seen: a ball that is put beside the tip once the robot is on its way, until a time [s]."""
    ball = []

    def see(time):
        if not ball and time >= 0.5:
            tip = replanner.robot.tip_pose(replanner._last.at(np.inf).q).translation
            ball.append(tip + np.array([0.0, 0.22, 0.0]))
            commands.append(ball[0])
        return {}, {"ball": Pose(tuple(ball[0])) if ball and time < gone else FAR}

    return see


def test_it_retreats_from_who_came_too_near_waits_and_goes_on(replanner_for, to_and_fro, bodies):
    for retreats in (False, True):
        replanner, placed = replanner_for("ball", detours=False, retreats=retreats), []
        way = to_and_fro(replanner)[0]
        commands = drive_replanner(replanner, way, beside_the_tip(replanner, placed, 4.0), 8.0)
        actions = [command.action for command in commands]
        assert (Action.RETREATING in actions) is retreats
        assert actions[-1] is Action.DONE  # after the ball has gone
        assert commands[-1].time > 4.0
    retreating = [command for command in commands if command.action is Action.RETREATING]
    assert {command.rule for command in retreating} == {"separation"}
    for command in retreating:  # who could be touched before the next command recedes slowly
        for g in np.flatnonzero(core_distances(bodies, command.at(command.time).q, placed)[:, 0] < 0.1 + 0.07 * 1.6):
            for t in np.linspace(command.time, command.standstill, 5):
                frames = bodies.frames(np.array([command.at(t).q, command.at(t + 1e-5).q]))
                moved = np.diff(bodies.vertices(g, frames), axis=0)
                assert np.linalg.norm(moved, axis=2).max() <= RETREAT_SPEED * 1.01e-5


def test_the_first_link_recedes_however_it_turns_from_who_is_beside_all_that_it_sweeps(panda, bodies, limits):
    q = np.array([0.3, -0.4, 0, -2.0, 0, 2.0, 0.785])
    first = bodies.links.index("panda_link1")
    angles = np.linspace(q[0], q[0] + 2 * np.pi, 721)
    turned = bodies.frames(q + np.outer(angles - q[0], np.eye(7)[0]))
    vertices = bodies.vertices(first, turned)
    axes = np.array([[1.0, 0, 0], [0.6, 0.64, 0.48], [0, 0, 1]])
    lost = bodies.swept(first, bodies.frames(q[None]), axes)
    heights = vertices @ axes.T
    np.testing.assert_allclose(heights[0].min(axis=0) - heights.min(axis=(0, 1)), lost, atol=1e-5)
    assert (heights[0].min(axis=0) - heights.min(axis=(0, 1)) <= lost + 1e-12).all()
    path = BoundedPath.along(bodies, line(q, q + 0.5 * np.eye(7)[0]), limits)
    motion = path.motion_from(0.0, 0.0, 1.0, 0.3)
    for far, recedes in ((0.02, False), (0.4, True)):
        place = [far, 0.0, vertices[0, :, 2].mean()]
        assert Receding(path, 0.0, balls([place])).along(motion)[first, 0] == recedes


def test_whoever_is_lost_stops_a_retreat(replanner_for, to_and_fro):
    replanner = replanner_for("ball", detours=False)
    seen = beside_the_tip(replanner, [], 9.0)
    commands = drive_replanner(replanner, to_and_fro(replanner)[0], lambda t: seen(t) if t < 3.0 else ({}, {}), 4.0)
    assert Action.RETREATING in {command.action for command in commands}
    assert commands[-1].action is Action.STANDING
    assert "was not seen" in commands[-1].reason
