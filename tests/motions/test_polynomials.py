"""Motions hold what they were made of: SciPy's splines, ROS's interpolation, samples, paths."""

from fractions import Fraction
from math import comb
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.polynomial import Chebyshev, Polynomial
from ompl import base as ob, geometric as og
from scipy import interpolate

from safe_ompl import InputError, Motion, PlanResult
from safe_ompl.collision.motion import place
from safe_ompl.robot import ScratchState, StateBridge, joint_space

N = 3


def splines(seed):
    """Return SciPy's objects of every kind through the same knots, with velocities and accelerations at them."""
    rng, count = np.random.default_rng(seed), 8
    t = np.cumsum(rng.uniform(0.02, 1.0, count)) - 1.0
    q, v, a = rng.normal(size=(3, count, N))
    knots = np.sort(np.concatenate([rng.uniform(-2, 2, count + 2), [0.3, 0.3]]))
    made = [
        interpolate.CubicSpline(t, q),
        interpolate.Akima1DInterpolator(t, q),
        interpolate.PchipInterpolator(t, q),
        interpolate.make_interp_spline(t, q, k=5),
        interpolate.BSpline(knots, q, len(knots) - len(q) - 1),
        interpolate.BPoly.from_derivatives(t, np.stack([q, v, a], axis=1)),
    ]
    return t, q, v, a, made


@settings(max_examples=15)
@given(st.integers(0, 10**6))
def test_motions_of_scipy_and_of_ros_controllers_are_the_same_functions(seed):
    t, q, v, a, found = splines(seed)
    steady = interpolate.make_interp_spline(t, q, k=1), interpolate.CubicHermiteSpline(t, q, v), found[-1]
    of_ros = [(Motion.hermite(t, q, *(v, a)[:k]), expected) for k, expected in enumerate(steady)]
    for motion, thing in [*((Motion.of(thing, names=["a", "b", "c"]), thing) for thing in found), *of_ros]:
        t = np.linspace(motion.times[0], motion.times[-1], 200)[1:-1]
        allowed = motion.allowance.max() + 1e-12 * np.abs(thing(t)).max()
        assert allowed < 1e-6
        np.testing.assert_allclose(motion.at(t), thing(t), rtol=0, atol=allowed)
        for order in range(1, 1 + min(2, getattr(thing, "k", 2))):
            expected = thing.derivative(order)(t)
            np.testing.assert_allclose(
                motion.derivative(t, order), expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max()
            )


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.booleans())
def test_boxes_of_cells_hold_all_derivatives_and_no_more_than_they_must(seed, timed):
    rng = np.random.default_rng(seed)
    for thing in splines(seed)[-1]:
        motion = Motion.of(thing)
        motion = Motion(motion.times, motion.coefficients, timed=timed)
        edges = np.union1d(motion.times, rng.uniform(motion.times[0], motion.times[-1], 200))
        cells = motion.between(edges)
        boxes = (*cells.boxes, -cells.d3q_ds3, cells.d3q_ds3)
        s = edges[:-1] + rng.uniform(0.01, 0.99, len(cells)) * cells.sizes
        for order, (found, low, high) in enumerate(zip(motion.places(s)[1:], boxes[::2], boxes[1::2], strict=True), 1):
            expected = motion.derivative(s, order)
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
            assert (low <= found).all()
            assert (found <= high).all()
            if not timed and order < 3:  # jumps between pieces count in time
                changes = np.abs(motion.derivative(np.clip(s, *edges[[0, -1]]), order + 1)) * cells.sizes[:, None]
                assert np.median((high - low) - changes) <= 1e-3 * np.abs(expected).max()


@pytest.mark.parametrize(("first", "last"), [(-0.9, -0.4), (-0.8, 2.1), (0.3, 0.31), (-1.0 + 1e-14, 1.0)])
def test_parts_and_paths_after_another_are_where_the_whole_is(first, last):
    t, q, *_ = splines(0)
    t = np.linspace(-1.0, 2.2, len(t))
    for degree, thing in ((1, q), (3, interpolate.CubicSpline(t, q))):
        made = Motion.through(thing, t) if degree == 1 else Motion.of(thing)
        whole = Motion(made.times, made.coefficients, timed=False, corners=(1, 4, 6))
        part = whole.part(first, last)
        s = np.linspace(0.0, last - first, 100)
        assert part.length == pytest.approx(last - first)
        np.testing.assert_allclose(part.at(s), whole.at(first + s), atol=1e-12)
        inside = [float(whole.times[k]) for k in whole.corners if first < whole.times[k] < last]
        np.testing.assert_allclose(part.times[list(part.corners)] + first, inside)
        both = part.then(Motion.through([part.knots[-1], q[0]]))
        assert both.corners == (*part.corners, part.pieces)
        np.testing.assert_allclose(both.at(s), part.at(s), atol=1e-12)
        np.testing.assert_allclose(both.at(part.length + 0.5), 0.5 * (part.knots[-1] + q[0]), atol=1e-12)


def exact(row):
    return [Fraction(float(value)) for value in row]


def de_boor(knots, held, degree, t):
    """Return the value of a B-spline, exactly."""
    at = max(k for k in range(degree, len(held)) if knots[k] <= t and knots[k] < knots[k + 1])
    row = held[at - degree : at + 1]
    for level in range(1, degree + 1):
        shares = [
            (t - knots[at - degree + r]) / (knots[at + r + 1 - level] - knots[at - degree + r])
            for r in range(level, degree + 1)
        ]
        row = [(1 - w) * a + w * b for w, a, b in zip(shares, row, row[1:], strict=False)]
    return row[0]


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.sampled_from([1, 3, 5, 9, 15]))
def test_rounding_is_within_its_bound(seed, degree):
    rng = np.random.default_rng(seed)
    knots, held = np.sort(rng.uniform(-2, 2, 2 * degree + 6)), rng.uniform(-3, 3, (degree + 5, 1))
    pieces, grid = rng.uniform(-3, 3, (1, degree + 1, 1)), [0.0, 0.7]
    t = exact(knots[[degree, degree + 5]])
    places = [t[0] + (t[1] - t[0]) * Fraction(k, 17) for k in range(18)]
    b = exact(pieces[0, :, 0])
    spline = Motion.of(interpolate.BSpline(knots, held, degree))
    bezier, grown = (Motion.of(kind(pieces[0, :, None], grid)) for kind in (interpolate.BPoly, interpolate.PPoly))
    h = Fraction(grid[1])
    found = [
        (spline, *inside(spline, place), de_boor(exact(knots), exact(held[:, 0]), degree, place)) for place in places
    ]
    for w in (Fraction(k, 17) for k in range(18)):
        shares = [comb(degree, k) * w**k * (1 - w) ** (degree - k) for k in range(degree + 1)]
        found.append((bezier, 0, w, sum(c * share for c, share in zip(b, shares, strict=True))))
        found.append((grown, 0, w, sum(c * (w * h) ** (degree - k) for k, c in enumerate(b))))
    for motion, piece, share, expected in found:
        taken = sum(c * share**k for k, c in enumerate(exact(motion.coefficients[piece, :, 0])))
        assert abs(taken - expected) <= motion.rounding[piece, 0]


def inside(motion, place):
    """Return the piece at a time, and the share of it that has gone, exactly."""
    t = exact(motion.times)
    piece = max(k for k in range(motion.pieces) if t[k] <= place)
    return piece, (place - t[piece]) / (t[piece + 1] - t[piece])


def test_where_coefficients_cancel_proofs_allow_for_the_rounding_of_the_places_that_they_look_at():
    """Of degree 15, 10¹¹ times as large as what is left, they give places that are 5 µrad off for each rad."""
    waves = Chebyshev.basis(15, domain=[0, 1]).convert(kind=Polynomial).coef
    motion = Motion([0.0, 1.0], waves[None, :, None])
    wrong = 0.0
    for t in np.linspace(0, 1, 200):
        exact = sum(Fraction(c) * Fraction(t) ** k for k, c in enumerate(waves.tolist()))
        wrong = max(wrong, abs(float(Fraction(place(motion.coefficients[0], t).item()) - exact)))
    assert 1e-6 < wrong < motion.allowance.item()
    assert not Motion([0.0, 1.0], [[[3.0], [1.0], [-2.0]]]).allowance.any()


def test_pieces_beside_a_point_without_rates_are_of_lower_degree():
    t, q, v, a = (rows[:5] for rows in splines(1)[:4])
    motion = Motion.hermite(t, q, [v[0], v[1], v[2], None, v[4]], [a[0], a[1], None, None, None])
    assert [int(np.flatnonzero(piece.any(axis=1)).max()) for piece in motion.coefficients] == [5, 3, 1, 1]
    np.testing.assert_allclose(motion.knots, q, atol=1e-12)
    with pytest.raises(InputError, match="point 3 has accelerations, but no velocities"):
        Motion.hermite(t, q, [v[0], v[1], v[2], None, v[4]], a)


@settings(max_examples=25)
@given(st.integers(0, 10**6))
def test_no_motion_of_bounded_velocity_leaves_the_slack_of_its_samples(seed):
    rng = np.random.default_rng(seed)
    fine = np.linspace(0.0, 1.0, 201)
    limit = np.array([1.0, 2.0, 0.5])
    drive = limit * np.clip(np.cumsum(rng.normal(size=(200, N)), axis=0), -1, 1)
    q = np.vstack([np.zeros(N), np.cumsum(drive / 200, axis=0)])
    motion = Motion.sampled(fine[::20], q[::20], limit)
    piece = np.clip(np.searchsorted(motion.times, fine, side="right") - 1, 0, 9)
    assert (np.abs(motion.at(fine) - q) <= motion.slack[piece] + 1e-12).all()
    assert (motion.slack <= 0.5 * limit * 0.1 * (1 + 1e-12)).all()
    assert not motion.rated


def test_it_rests_before_and_after_and_its_slack_is_reached():
    motion = Motion.through([[0.0, 0.0], [1.0, 2.0]], [1.0, 2.0])
    np.testing.assert_array_equal(motion.at([0.0, 1.5, 9.0]), [[0, 0], [0.5, 1], [1, 2]])
    np.testing.assert_array_equal(motion.derivative([0.0, 1.5, 9.0]), [[0, 0], [1, 2], [0, 0]])
    assert (motion.pieces, motion.degree, motion.n, motion.duration) == (1, 1, 2, 1.0)
    assert repr(motion) == "Motion(1 pieces of degree 1, 2 joints, 1.000 s)"
    bare = Motion.sampled([0.0, 1.0], [[0.0], [0.5]], 1.0)
    assert bare.slack[0, 0] == pytest.approx(0.75 - 0.375)  # at full speed for 0.75 s, and back


def test_paths_of_all_kinds(kinova):
    points = np.random.default_rng(2).uniform(-1, 1, (4, 6))
    names = kinova.joint_names
    result = PlanResult("Exact solution", points, None, "PRM", 1, names, 0.1)
    space = joint_space(kinova)
    path = og.PathGeometric(ob.SpaceInformation(space))
    scratch = ScratchState(StateBridge(space))
    for q in points:
        path.append(scratch.set(q))
    solved = SimpleNamespace(getSolutionPath=lambda: path, getStateSpace=lambda: space)  # as a SimpleSetup is
    for thing in (points, points.tolist(), result, Motion.through(points, names=names), path, solved):
        motion = Motion.of(thing, space=space).for_robot(kinova)
        np.testing.assert_allclose(motion.knots, points, atol=1e-15)
        assert motion.joint_names == names
        assert not motion.timed
        np.testing.assert_array_equal(motion.times, range(4))
        assert Motion.of(motion) is motion
    with pytest.raises(InputError, match="does not know its state space: pass `space`"):
        Motion.of(path)
    with pytest.raises(InputError, match="no path"):
        Motion.of(PlanResult("Timeout", None, None, "PRM", 1, names, 0.1))


def test_numbers_of_continuous_joints_stand_but_states_of_angles_go_the_short_way(kinova):
    rng = np.random.default_rng(3)
    points = rng.uniform(-3.1, 3.1, (20, 6))
    assert np.abs(np.diff(points, axis=0)).max() > np.pi
    for motion in (Motion.through(points), Motion.through(points, range(20)), Motion.hermite(range(20), points)):
        np.testing.assert_allclose(motion.for_robot(kinova).knots, points, atol=1e-13)
    for wraps in (True, False):
        space = joint_space(kinova) if wraps else ob.RealVectorStateSpace(6)
        if not wraps:
            space.setBounds(-4.0, 4.0)
        states, scratch = og.PathGeometric(ob.SpaceInformation(space)), ScratchState(StateBridge(space))
        for q in points:
            states.append(scratch.set(q))
        steps = np.diff(Motion.of(states, space=space).knots, axis=0)
        expected = kinova.difference(points[:-1], points[1:]) if wraps else np.diff(points, axis=0)
        np.testing.assert_allclose(steps, expected, atol=1e-13)
    with pytest.raises(InputError, match=r"PathGeometric: its states are .*: give the space"):
        Motion.of(states, space=kinova)


def test_joints_come_by_name(twin_arm):
    names = list(twin_arm.joint_names)
    order = np.random.default_rng(4).permutation(twin_arm.n)
    points = np.random.default_rng(5).uniform(-1, 1, (3, twin_arm.n))
    motion = Motion.through(points[:, order], [0.0, 1.0, 3.0], [names[k] for k in order])
    np.testing.assert_array_equal(motion.for_robot(twin_arm).knots, points)
    degrees = np.where(twin_arm.prismatic, points, np.degrees(points))
    turned = Motion.through(degrees[:, order], names=[names[k] for k in order]).for_robot(twin_arm, degrees=True)
    np.testing.assert_allclose(turned.knots, points, atol=1e-15)
    with pytest.raises(InputError, match=r"moves to .* rad.*degrees=True, --degrees"):
        Motion.through(100 * degrees).for_robot(twin_arm)
    for given_names, message in (
        ([*names[1:], "nose"], f"lacks the joints {names[0]}; has joints that the robot has not: nose"),
        (names[:-1], f"lacks the joints {names[-1]}$"),
        ([*names, "nose"], "has joints that the robot has not: nose$"),
    ):
        with pytest.raises(InputError, match=message):
            Motion.through(np.zeros((2, len(given_names))), names=given_names).for_robot(twin_arm)
    with pytest.raises(InputError, match=f"must have {twin_arm.n} columns, for .*, got 2"):
        Motion.through(np.zeros((2, 2))).for_robot(twin_arm)


T, Q = [0.0, 1.0, 2.0], np.zeros((3, 2))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Motion.through(Q, [0.0, 2.0, 1.0]), r"times: must increase, got 1 after 2 \(times\[2\]\)"),
        (lambda: Motion.hermite([0.0, 1.0, 1.0], Q), r"times: must increase, got 1 after 1 \(times\[2\]\)"),
        (lambda: Motion.hermite(T[:2], Q), r"positions: must have shape \(2, any\), got \(3, 2\)"),
        (lambda: Motion.hermite(T, Q * np.nan), "positions: must be finite"),
        (lambda: Motion.hermite(T, Q, Q[:, :1]), r"velocities: must have shape \(3, 2\), got \(3, 1\)"),
        (lambda: Motion.through(Q, names=["a", "a"]), "joint names: must differ, got a, a"),
        (lambda: Motion.through(Q, names=["a"]), "joint names: must be 2, one for each column, got 1"),
        (lambda: Motion.through(Q[:1], [0.0]), "way points: must be at least two, got 1"),
        (lambda: Motion([0, 1], np.zeros((1, 17, 2)) + 1), "degree of at most 15, .*got 16"),
        (lambda: Motion([0, 1], np.zeros((1, 2, 2)), slack=[[0, -1.0]]), "slack: must not be negative, got -1"),
        (lambda: Motion([0, 1, 2], [[[0.0], [1.0]], [[1.1], [0.0]]], ("hip",)), "joint 'hip' jumps by 0.1 at 1 s"),
        (lambda: Motion.of(interpolate.PPoly([[0.0, 1.0]], [0, 1, 2])), r"PPoly: must have values of shape \(n,\)"),
        (lambda: Motion.of(interpolate.BSpline(range(4), Q, 0)), r"degree of the B-spline: .* \[1, 15\], got 0"),
        (lambda: Motion.sampled(T, [[0.0], [0.5], [3.0]], 1.0), "column 0 moves at 2.5 after 1 s, faster than"),
        (lambda: Motion.sampled(T, Q, 0.0), "largest velocity: must be a finite number in"),
        (lambda: Motion.of(interpolate.CubicSpline(T, Q + 1j)), r"coefficients: must be numbers, got array"),
        (lambda: Motion.of(interpolate.PPoly(np.ones((2, 2, 2)), T[::-1])), "times: must increase, got 1 after 2"),
        (lambda: Motion.hermite([0.0, 1.0, 1.0 + 1e-12], Q), "times: must increase by at least 1e-9, got 1 after 1"),
        (lambda: Motion.hermite(T, Q, 3.0), r"velocities: must have shape \(3, 2\), got \(\)"),
        (lambda: Motion.hermite(T, Q, names="ab"), "joint names: must be a list, got str 'ab'"),
        (lambda: Motion.of(interpolate.KroghInterpolator(T, Q)), "motion: must be a Motion, SciPy's"),
        (lambda: Motion.through(Q, T).at(np.nan), "time must be a number of seconds, got nan"),
    ],
)
def test_bad_input_is_named_in_one_line(make, message):
    with pytest.raises(InputError, match=message) as error:
        make()
    assert "\n" not in str(error.value)
