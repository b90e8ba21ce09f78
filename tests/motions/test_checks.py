"""Motions of others: what is proven holds everywhere, what is not is named, and repairs keep ends and form."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from crank import CRANK
from hypothesis import given, settings, strategies as st
from numpy.polynomial import Chebyshev, Polynomial
from scipy.interpolate import CubicSpline

from safe_ompl import (
    Box,
    CollisionChecker,
    Constraints,
    DangerField,
    DangerLimit,
    Mesh,
    Motion,
    MotionProver,
    Obstacle,
    People,
    Pose,
    RateLimits,
    Robot,
    SafeSetup,
    Scene,
    Sphere,
    TipBounds,
    ToolOrientation,
    Verdict,
)
from safe_ompl.collision import MinClearance
from safe_ompl.motions import check, check_with, repair_with, widest_tube

seeds = st.integers(0, 2**32 - 1)


def spline(robot, seed, knots=6, spread=0.5):
    """Return a clamped spline through random configurations near each other, within the limits."""
    rng = np.random.default_rng(seed)
    room = 0.2 * (robot.upper - robot.lower)
    q = rng.uniform(robot.lower + room, robot.upper - room)
    points = q + np.cumsum(spread * rng.normal(size=(knots, robot.n)) / np.sqrt(robot.n), axis=0)
    return CubicSpline(
        np.arange(float(knots)), np.clip(points, robot.lower + room, robot.upper - room), bc_type="clamped"
    )


@pytest.mark.parametrize("name", ["panda", "kinova", "twin_arm", "slider"])
def test_no_proven_motion_touches_and_what_is_refused_is_there(robot_named, clutter, name):
    robot = robot_named(name)
    proof = MotionProver(CollisionChecker(robot, clutter))
    verdicts = set()
    for seed in range(14):
        motion = Motion.of(spline(robot, seed)).for_robot(robot)
        found = check_with(motion, proof)
        touching = [t for t in np.linspace(0, 5, 400) if proof.checker.touches(motion.at(t))]
        verdicts.add(bool(found))
        assert not (found and touching)
        for t in touching:
            assert any(v.first <= t <= v.last for v in found.violations)
        for violation in found.violations:
            if violation.kind == "collision" and violation.decided:
                assert violation.value <= 0
                assert proof.checker.touches(motion.at(violation.at))
                assert violation.first <= violation.at <= violation.last
    assert verdicts == {True, False}


def test_what_bounds_prove_of_many_curves_is_free(panda, clutter):
    rng, proof = np.random.default_rng(0), MotionProver(CollisionChecker(panda, clutter))
    starts = rng.uniform(panda.lower, panda.upper, (60, 1, 7))
    curves = np.concatenate([starts, rng.normal(scale=0.15, size=(60, 3, 7))], axis=1)
    known, verdicts = proof.proven_by_bounds(curves), [proof.check_curve(curve) for curve in curves]
    free = np.array([found.verdict is Verdict.FREE for found in verdicts])
    left = [found.pair is not None and found.pair[1] == "its limits" for found in verdicts]
    assert free[known].all()
    assert known.sum() > 0.8 * free.sum() > 0
    assert any(left)
    assert not replace(proof, limits=(proof,)).proven_by_bounds(curves).any()  # of other limits bounds know nothing


@given(seeds)
@settings(max_examples=3)
def test_every_motion_within_a_proven_tube_is_free(ur5, clutter, seed):
    rng = np.random.default_rng(seed)
    motion = Motion.of(spline(ur5, seed, spread=0.3)).for_robot(ur5)
    proportions = rng.uniform(0.2, 1.0, ur5.n)
    tube = widest_tube(motion, ur5, clutter, proportions=proportions, tolerance=0.05)
    checker = CollisionChecker(ur5, clutter)
    if not tube.any():
        assert not check(motion, ur5, clutter)
        return
    assert np.allclose(tube / proportions, tube[0] / proportions[0])
    assert check(motion, ur5, clutter, tube=tube)
    assert not check(motion, ur5, clutter, tube=1.06 * tube)
    for t in np.linspace(0, 5, 50):
        for side in (rng.choice([-1.0, 1.0], ur5.n), rng.uniform(-1, 1, ur5.n)):
            assert not checker.touches(motion.at(t) + side * tube)


@pytest.fixture(scope="module")
def crank(tmp_path_factory):
    """One joint about z that turns a ball of 0.05 m at a distance of 0.5 m, the tip behind it."""
    urdf = tmp_path_factory.mktemp("crank") / "crank.urdf"
    hand = """<link name="hand"/><joint name="fixed" type="fixed"><parent link="ball"/><child link="hand"/>
      <origin xyz="0.5 0 0"/></joint></robot>"""
    urdf.write_text(CRANK.replace("</robot>", hand))
    return Robot.from_urdf(urdf)


@pytest.fixture(scope="module")
def post():
    """Return a ball of 0.05 m that the crank's touches from 1 ± 2 asin(0.1) rad on."""
    return Scene([Obstacle("post", Sphere(0.05), Pose((0.5 * np.cos(1), 0.5 * np.sin(1), 0.0)), weight=1.0)])


TOUCH = 1 - 2 * np.arcsin(0.1)  # [rad]


def test_the_widest_tube_is_what_is_left_to_the_contact(crank, post):
    motion = Motion.hermite([0, 1, 2], [[0.0], [0.6], [0.0]], [[0.0], [0.0], [0.0]])
    tube = widest_tube(motion, crank, post, tolerance=1e-3)
    gap = 2 * 0.5 * np.sin(0.2) - 0.1  # [m] between the balls at 0.6 rad
    assert 0.99 * gap / 0.55 < tube[0] < TOUCH - 0.6
    assert check(motion, crank, post, tube=tube)
    found = check(motion, crank, post, tube=TOUCH - 0.6)
    assert not found
    assert found.violations[0].kind == "clearance"
    assert abs(found.violations[0].at - 1.0) < 0.1


def test_no_limit_is_named_that_nobody_has_set(crank, post):
    """What a tube, or samples far apart, add to a distance is not a limit; a tool's limit is the one that was set."""
    (sampled,) = check(Motion.sampled([0, 1, 2], [[0.5], [0.51], [0.5]], 1.0), crank, post).violations
    (tubed,) = check(Motion.through([[0.5], [0.6]]), crank, post, tube=0.25).violations
    wide = Constraints().with_separation(min_clearance=MinClearance(0.2, ("post",), frozenset()))
    (limited,) = check(Motion.through([[0.5], [0.6]]), crank, post, constraints=wide, tube=0.01).violations
    for found in (sampled, tubed):
        assert (found.kind, found.limit) == ("clearance", None)
        assert "limit" not in str(found)
        assert f"({1e3 * found.nearer:.4g} mm nearer where the motion may be)" in str(found)
    assert tubed.nearer == pytest.approx(0.25 * 0.55, rel=1e-3)
    assert limited.limit == 0.2
    assert "(limit 200 mm, 5.5 mm nearer where the motion may be)" in str(limited)
    (touching,) = check(Motion.through([[0.5], [0.9]]), crank, post).violations
    assert "limit" not in str(touching)
    upright = Constraints(tool=(ToolOrientation(crank, (1, 0, 0), (1, 0, 0), 0.7),))
    (tilted,) = check(Motion.through([[0.5], [0.72]]), crank, Scene([]), constraints=upright).violations
    assert (tilted.limit, tilted.unit) == (0.7, "rad")
    assert tilted.value == pytest.approx(0.72, abs=0.01)


def test_violations_name_time_pair_and_depth(crank, post):
    for times, proven in (([0, 0.01, 0.02], True), ([0, 1, 2], False)):  # what lies between bare samples counts
        assert bool(check(Motion.sampled(times, [[0.7], [0.705], [0.71]], 1.0), crank, post)) is proven
    motion = Motion.hermite([0, 1, 2], [[0.0], [0.9], [0.0]], [[0.0], [0.0], [0.0]], names=["turn"])
    (found,) = check(motion, crank, post).violations
    enters = motion.at(found.first)[0], motion.at(found.last)[0]
    assert enters == pytest.approx((TOUCH, TOUCH), abs=0.02)
    assert (found.kind, found.names, found.decided) == ("collision", ("ball", "post"), True)
    assert found.value == pytest.approx(np.sin(0.05) - 0.1, abs=1e-3)
    assert found.at == pytest.approx(1.0, abs=0.02)
    assert "collision at 0.99" in str(found)


@pytest.mark.parametrize("degree", [9, 15])
def test_a_piece_that_oscillates_is_divided_where_its_bounds_say_so(crank, tmp_path, degree):
    """A bound of its speed over the whole piece is up to 10¹⁰ times too large: so many places were to be looked at.

    The crank is between two walls of one mesh, within its hull: kernels prove nothing, and coal is asked.
    """
    tops = [(x, side * y, z) for side in (1, -1) for x, y, z in ((2, 0.2, -1), (-2, 0.2, -1), (0, 0.2, 2), (0, 1, 0))]
    faces = [(k + a, k + b, k + c) for k in (0, 4) for a, b, c in ((1, 2, 3), (1, 2, 4), (1, 3, 4), (2, 3, 4))]
    rows = [" ".join(map(str, (letter, *row))) for letter, given in (("v", tops), ("f", faces)) for row in given]
    (tmp_path / "walls.obj").write_text("\n".join(rows))
    walls = Scene([Obstacle("walls", Mesh(tmp_path / "walls.obj", convex=False), Pose((0.0, 0.0, 0.0)))])
    waves = Chebyshev.basis(degree, domain=[0, 1]).convert(kind=Polynomial).coef
    checker = CollisionChecker(crank, walls)
    motion = Motion([0.0, 1.0], 0.08 * waves[None, :, None])
    assert check_with(motion, MotionProver(checker))
    assert 1 < checker.counts.margin_queries < 100
    late = check_with(motion, MotionProver(checker), time=1e-9)
    assert [(v.kind, v.first, v.last, v.decided) for v in late.violations] == [("out of time", 0.0, 1.0, False)]


def test_limits_of_danger_tool_and_rates_hold_between_the_knots(crank, post):
    motion = Motion.hermite([0, 1, 2], [[0.0], [0.6], [0.0]], [[0.0], [0.0], [0.0]])
    field, places = DangerField(crank, *post.danger_points()[:2]), motion.at(np.linspace(0, 2, 2001))
    dense = max(map(field.value, places))
    tip = max(crank.tip_pose(q).translation[1] for q in places)
    rates = RateLimits.of(crank, velocity=0.5, acceleration=100.0)
    loose, tight = (Constraints(danger=DangerLimit(field, factor * dense)) for factor in (1.02, 0.98))
    higher, lower = (
        Constraints(tool=(TipBounds(crank, [-1, -1, -1], [1, tip + spare, 1]),)) for spare in (1e-3, -1e-3)
    )
    for asked, kinds in (
        ({"constraints": loose}, set()),
        ({"constraints": tight}, {"danger"}),
        ({"constraints": loose, "tube": 0.05}, {"danger"}),  # a motion in the tube comes nearer
        ({"constraints": higher}, set()),
        ({"constraints": lower}, {"tip position"}),
        ({"limits": rates}, {"velocity"}),
    ):
        found = check(motion, crank, post, **asked)
        assert {v.kind for v in found.violations} == kinds
        assert all(v.value > (v.limit or 0.0) for v in found.violations if v.decided)
    assert found.violations[0].value == pytest.approx(0.9)  # 1.5 times the mean


def test_a_piece_outside_the_limits_is_never_passed_over(crank, post, monkeypatch):
    """Its collisions are not looked at; so something must be said of it, whatever the bounds of rates say."""
    outside = Motion.hermite([0, 1], [[-2.9], [-3.1]], [[0.0], [0.0]])
    (found,) = check(outside, crank, post).violations
    assert (found.kind, found.names) == ("position", ("turn",))
    monkeypatch.setattr("safe_ompl.motions.checks.rate_violations", lambda *arguments: [])
    (found,) = check(outside, crank, post).violations
    assert (found.kind, found.names) == ("position", ("turn",))
    assert found.value < crank.lower[0]


# ------------------------------------------------------------------------------------------------------- repair


def pushed_into(robot, scene, seed, degree):
    """Return a motion that touches something in the middle, and is free at both ends."""
    rng = np.random.default_rng(seed)
    checker = CollisionChecker(robot, scene)
    while True:
        motion = spline(robot, int(rng.integers(2**32)), knots=8, spread=0.6)
        times, q = motion.x, motion(motion.x)
        if checker.touches(q[0]) or checker.touches(q[-1]) or not any(map(checker.touches, motion(times[1:-1]))):
            continue
        return Motion.through(q, times) if degree == 1 else Motion.of(motion)


@pytest.mark.parametrize("degree", [1, 3])
@pytest.mark.parametrize("seed", [1, 2])
def test_repaired_motions_are_proven_near_and_of_the_same_form(panda, seed, degree):
    scene = Scene(
        [
            Obstacle("ball", Sphere(0.12), Pose((0.45, 0.1, 0.5))),
            Obstacle("box", Box((0.2, 0.2, 0.2)), Pose((0.3, -0.5, 0.6))),
        ]
    )
    given = pushed_into(panda, scene, seed, degree).for_robot(panda)
    proof = MotionProver(CollisionChecker(panda, scene))
    found = repair_with(given, proof)
    assert found, found.how
    motion = found.motion
    dense = np.linspace(*motion.times[[0, -1]], 4000)
    assert not any(map(proof.checker.touches, motion.at(dense)))
    for order in range(degree if degree == 1 else 3):
        for end in motion.times[[0, -1]]:
            np.testing.assert_allclose(motion.derivative(end, order), given.derivative(end, order), atol=1e-9)
    assert motion.degree == degree
    assert set(given.times) <= set(motion.times)
    for order in range(degree):  # as smooth as it was
        held = motion.derivative_coefficients(order)
        np.testing.assert_allclose(held[:-1].sum(axis=1), held[1:, 0], atol=1e-6 * max(1.0, abs(held).max()))
    apart = np.abs(motion.at(dense) - given.at(dense)).max(axis=1)
    assert apart.max() <= found.deviation * 1.05 + 1e-9
    for t, difference in zip(dense, apart, strict=True):
        assert difference < 1e-9 or any(first <= t <= last for first, last in found.changed)


def test_what_need_not_or_cannot_be_repaired_stays_as_it_is(crank, post):
    proof = MotionProver(CollisionChecker(crank, post))
    free = Motion.hermite([0, 1], [[0.0], [0.5]], [[0.0], [0.0]])
    assert repair_with(free, proof).how == "unchanged"
    ends_in_it = Motion.hermite([0, 1], [[0.0], [0.95]], [[0.0], [0.0]])
    assert "end" in repair_with(ends_in_it, proof).how
    through = Motion.hermite([0, 1], [[0.0], [2.0]], [[0.0], [0.0]])  # one joint cannot go round
    found = repair_with(through, proof, connect=lambda start, end: None)
    assert not found
    assert "no way round" in found.how
    dips = Motion.hermite([0, 1, 2], [[0.0], [0.82], [0.0]], [[0.0], [0.0], [0.0]])
    found = repair_with(dips, proof)
    assert found.how == "moved"
    assert found.deviation == pytest.approx(0.82 - TOUCH, abs=0.02)


@pytest.mark.parametrize(("outside", "repaired"), [(5e-9, True), (1e-5, False)])
def test_ends_that_single_precision_puts_outside_the_limits_are_moved_to_them(panda, outside, repaired):
    """VAMP's way points are single-precision numbers, and many grasps are at a joint limit."""
    start = np.array([0.0, -0.8, 0.0, -2.4, 0.0, 1.6, 0.8])
    end = start.copy()
    end[4] = panda.upper[4] + outside
    path = np.array([start, end])
    proof = MotionProver(CollisionChecker(panda, Scene()))
    (violation,) = check(path, panda, Scene()).violations
    assert len(set(violation.quantities)) == 2  # "2.897300005 rad (limit 2.8973 rad)"
    found = repair_with(Motion.through(path), proof)
    assert bool(found) == repaired
    if repaired:
        assert found.path[-1][4] == panda.upper[4]
        assert found.deviation == pytest.approx(outside, rel=1e-3)


def test_what_check_proves_is_not_changed_by_a_repair(panda):
    end = np.array([0.0, -0.8, 0.0, -2.4, panda.upper[4] + 5e-10, 1.6, 0.8])
    path = np.array([0.9 * end, end])
    assert check(path, panda, Scene())
    assert repair_with(path, MotionProver(CollisionChecker(panda, Scene()))).how == "unchanged"


def test_a_way_round_is_followed_where_pushing_fails(panda):
    """A wall across the way: gradients point through it, a planner goes over it."""
    wall = Scene([Obstacle("wall", Box((0.5, 0.04, 0.7)), Pose((0.5, 0.0, 0.35)))])
    start = np.array([-0.8, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8])
    end = start * [-1, 1, 1, 1, 1, 1, 1]
    over = np.array([0.0, -0.7, 0.0, -1.2, 0.0, 1.6, 0.8])
    proof = MotionProver(CollisionChecker(panda, wall))
    given = Motion.hermite([0, 2], [start, end], [np.zeros(7), np.zeros(7)], [np.zeros(7), np.zeros(7)])
    lift = start + np.array([0, -1.0, 0, 0.8, 0, -0.7, 0])
    way = np.array([start, lift, over, lift * [-1, 1, 1, 1, 1, 1, 1], end])
    assert all(proof.is_free(a, b) for a, b in pairwise(way))
    found = repair_with(
        given, proof, connect=lambda a, b: way if np.allclose(a, start) and np.allclose(b, end) else None
    )
    assert found, found.how
    assert check_with(found.motion, proof)


def test_a_motion_is_slowed_where_only_its_rates_or_stops_need_it(crank, post):
    """Its way stays; a jump of the velocity stays one at any pace."""
    motion = Motion.hermite([1, 2], [[0.0], [0.6]], [[0.0], [0.0]])
    limits = RateLimits.of(crank, velocity=0.5, acceleration=100.0)
    proof = MotionProver(CollisionChecker(crank, post))
    found = repair_with(motion, proof, limits)
    assert found, found
    assert (found.how, found.changed, found.slower) == ("slowed", (), pytest.approx(1.8))  # 0.9 rad/s at most
    np.testing.assert_allclose(found.motion.at([1.0, 1.9, 2.8]), motion.at([1.0, 1.5, 2.0]), atol=1e-12)
    people = People(who=("post",), speed=0.35, reaction_time=0.25)
    limits = RateLimits.of(crank, velocity=5.0, acceleration=4.0)
    late = repair_with(motion, proof, limits, people=people)
    assert late.slower > 1.5
    assert repair_with(motion, proof, limits).how == "unchanged"
    assert late.check.people == people
    assert not check(replace(late.motion, times=late.motion.times / 1.03), crank, post, limits=limits, people=people)
    through = Motion.hermite([0, 1, 2], [[0.0], [0.3], [0.2]])
    assert "jump" in repair_with(through, proof, limits).how


def test_claims_are_of_what_is_proven_and_not_of_what_is_asked(ur5, clutter):
    setup = SafeSetup(ur5, clutter)
    setup.setMaxDanger(1e3)
    setup.setStateValidityChecker(lambda state: True)
    at = [0.8, -1.6, 1.2, -1.2, -1.57, 0.0]
    found = setup.check(np.array([at, np.add(at, 0.01)]))
    assert found.claims == ("joint limits", "no collision", "max danger")
