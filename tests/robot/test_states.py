"""The bridge between OMPL states and arrays: round trips, wrapping, bounds, and spaces that it refuses."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, strategies as st
from ompl import base as ob

from safe_ompl import InputError, PlanningError
from safe_ompl.robot import Coordinates, OwnState, ScratchState, StateBridge, joint_space, states

angles = st.floats(-100.0, 100.0)


def bounded(space, *bounds):
    """Return a space with bounds."""
    box = ob.RealVectorBounds(len(bounds))
    for k, (low, high) in enumerate(bounds):
        box.setLow(k, low)
        box.setHigh(k, high)
    space.setBounds(box)
    return space


def real_vector(*bounds):
    return bounded(ob.RealVectorStateSpace(len(bounds)), *bounds)


def compound(*parts):
    space = ob.CompoundStateSpace()
    for part in parts:
        space.addSubspace(part, 1.0)
    return space


@pytest.mark.parametrize("name", ["panda", "kinova", "twin_arm"])
def test_the_space_of_a_robot(robot_named, rng, name):
    robot = robot_named(name)
    space = joint_space(robot)
    bridge = StateBridge(space)
    assert space.getDimension() == bridge.n == robot.n
    np.testing.assert_array_equal(bridge.circular, robot.continuous)
    np.testing.assert_allclose([bridge.lower, bridge.upper], [robot.lower, robot.upper])
    assert isinstance(space, ob.RealVectorStateSpace) or robot.continuous.any()
    first, second, between = (ScratchState(bridge) for _ in range(3))
    for q1, q2 in rng.uniform(robot.lower, robot.upper, (20, 2, robot.n)):
        np.testing.assert_array_equal(bridge.read(first.set(q1)), np.where(robot.continuous, bridge.wrapped(q1), q1))
        assert space.satisfiesBounds(first.state)
        space.interpolate(first.state, second.set(q2), 0.3, between.state)
        expected = bridge.wrapped(q1 + 0.3 * bridge.difference(q1, q2))
        np.testing.assert_allclose(bridge.read(between.state), expected, atol=1e-12)
        np.testing.assert_allclose(bridge.difference(q1, q2), robot.difference(q1, q2), atol=1e-12)
    with pytest.raises(ValueError, match="broadcast"):
        first.set(np.zeros(robot.n - 1))


def test_each_thread_has_a_scratch_state_of_its_own():
    bridge = StateBridge(real_vector((-1.0, 1.0)))
    scratch = ScratchState(bridge)
    mine = scratch.set(np.array([0.5]))
    with ThreadPoolExecutor(1) as other:
        other.submit(scratch.set, np.array([-0.5])).result()
    assert bridge.read(mine) == 0.5


@given(angles, angles)
def test_angles_wrap_and_differences_are_the_short_way(first, second):
    bridge = StateBridge(ob.SO2StateSpace())
    wrapped = bridge.wrapped(np.array([first]))[0]
    delta = bridge.difference(np.array([first]), np.array([second]))[0]
    assert max(abs(wrapped), abs(delta)) <= np.pi + 1e-9
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * first), abs=1e-9)
    assert np.exp(1j * (first + delta)) == pytest.approx(np.exp(1j * second), abs=1e-9)
    assert bridge.space.satisfiesBounds(ScratchState(bridge).set(np.array([first])))


def test_a_step_leads_to_the_target_or_a_part_of_the_way_and_descends_at_right_angles(kinova, rng):
    space, bridge = Coordinates(kinova.lower, kinova.upper, kinova.continuous), StateBridge(joint_space(kinova))
    steps = rng.uniform(0.0, 8.0, 100)
    for q, target, gradient, step in zip(
        *rng.uniform(kinova.lower, kinova.upper, (3, 100, kinova.n)), steps, strict=True
    ):
        way = bridge.difference(q, target)
        length, found = space.steer(q, target, step)
        assert length == pytest.approx(np.linalg.norm(way))
        place, direction = found.copy()
        np.testing.assert_allclose(place, target if length <= step else q + step / length * way)
        np.testing.assert_allclose(direction, way / length)
        across = gradient - (gradient @ direction) * direction
        across *= 0.3 / max(1.0, np.linalg.norm(across))
        assert space.descend(found, gradient, 0.3)
        np.testing.assert_allclose(found[1], bridge.inside(place - across), atol=1e-12)
    assert not space.descend(found, np.zeros(kinova.n), 0.3)


def test_bounds_and_shares_of_the_way_between_them():
    space = compound(real_vector((-1.0, 2.0), (0.0, 0.5)), ob.SO2StateSpace())
    bridge, scratch = StateBridge(space), ScratchState(StateBridge(space))
    np.testing.assert_allclose(bridge.inside(np.array([5.0, 0.25, 4.0])), [2.0, 0.25, 4.0 - 2 * np.pi])
    np.testing.assert_allclose(bridge.inside(np.array([[-3.0, -1.0, 1.0]])), [[-1.0, 0.0, 1.0]])
    np.testing.assert_array_equal(bridge.between_bounds(np.zeros(3)), [-1, 0, -np.pi])
    np.testing.assert_array_equal(bridge.between_bounds(np.array([[0.5, 0.5, 0.5]])), [[0.5, 0.25, 0]])

    def holds(q):
        return bool((bridge.held[0] <= q).all() and (q <= bridge.held[1]).all())

    drawn = np.random.default_rng(0).uniform([-1.5, -0.2, -3.0], [2.5, 0.7, 3.0], (200, 3))
    corners = np.array([[-1.0, 0.0, 3.0], [2.0, 0.5, -3.0], [2.0 + 1e-12, 0.5, 0.0]])
    said = [holds(q) for q in np.concatenate([drawn, corners])]
    assert said == [space.satisfiesBounds(scratch.set(q)) for q in np.concatenate([drawn, corners])]
    assert 20 < sum(said) < 180
    assert holds(np.array([0.0, 0.1, 40.0])), "angles wrap"
    assert not holds(np.array([0.0, np.nan, 0.0]))


def test_compounds_of_compounds():
    inner = compound(ob.SO2StateSpace(), real_vector((-1, 1), (-2, 2)))
    bridge = StateBridge(compound(real_vector((0, 3), (0, 4)), inner))
    assert bridge.circular.tolist() == [False, False, True, False, False]
    np.testing.assert_allclose(bridge.upper, [3, 4, np.pi, 1, 2])
    one = ScratchState(bridge)
    rows = bridge.between_bounds(np.random.default_rng(0).random((20, 5)))
    np.testing.assert_array_equal([bridge.read(one.set(q)) for q in rows], rows)
    plane = bounded(ob.SE2StateSpace(), (-1, 1), (-1, 1))
    assert StateBridge(compound(plane, ob.SO2StateSpace())).circular.tolist() == [False, False, True, True]


def test_rotations_turn_along_ompls_arcs(rng):
    body = bounded(ob.SE3StateSpace(), (-1, 1), (-1, 1), (-1, 1))
    space = compound(ob.SO2StateSpace(), body, ob.SO3StateSpace())
    bridge = StateBridge(space)
    assert (bridge.n, bridge.rotations.tolist()) == (12, [4, 8])
    assert bridge.extent == pytest.approx(np.sqrt((2 * np.pi) ** 2 + 3 * 2**2 + 2 * np.pi**2))
    compiled = Coordinates(bridge.lower, bridge.upper, bridge.circular, bridge.rotations)
    first, second, between = (ScratchState(bridge) for _ in range(3))
    drawn = bridge.between_bounds(rng.random((60, 2, 12)))
    drawn[..., 1:4] *= 0.5  # where no bound is near
    arcs = bridge.difference(drawn[:, 0], drawn[:, 1])
    for (q, end), motion, share in zip(drawn, arcs, rng.random(60), strict=True):
        np.testing.assert_array_equal(bridge.read(first.set(q)), q)
        assert space.satisfiesBounds(first.state)
        space.interpolate(first.state, second.set(end), share, between.state)
        place = bridge.wrapped(bridge.moved(q, share * motion))
        length, (stepped, _) = compiled.steer(q, end, share * np.linalg.norm(motion))
        assert length == pytest.approx(np.linalg.norm(motion))
        for found in (place, bridge.wrapped(stepped)):
            np.testing.assert_allclose(bridge.difference(bridge.read(between.state), found), 0.0, atol=1e-12)
        rotation = ScratchState(StateBridge(ob.SO3StateSpace()))
        other = ScratchState(StateBridge(ob.SO3StateSpace()))
        distance = ob.SO3StateSpace().distance(rotation.set(q[8:]), other.set(end[8:]))
        assert np.linalg.norm(motion[8:]) == pytest.approx(distance)
        np.testing.assert_allclose(bridge.difference(q, np.concatenate([q[:8], -q[8:]])), 0.0, atol=1e-12)
        across = rng.normal(size=12)
        step = np.array([q, motion / length])
        assert compiled.descend(step, across, 0.1)
        np.testing.assert_allclose(bridge.inside(step[1]), step[1], atol=1e-12)
        assert -0.7 < bridge.difference(q, step[1]) @ across < 0
        np.testing.assert_allclose(bridge.difference(q, step[1]) @ motion, 0.0, atol=0.01)
    turns = StateBridge(ob.SO3StateSpace()).between_bounds(rng.random((20_000, 4)))
    np.testing.assert_allclose(turns.T @ turns / len(turns), np.eye(4) / 4, atol=0.01)
    np.testing.assert_array_equal(StateBridge(ob.SO3StateSpace()).wrapped(np.zeros(4)), [0, 0, 0, 1])
    with pytest.raises(InputError, match="quaternions must be four of 3 coordinates"):
        Coordinates(np.zeros(3), np.ones(3), np.zeros(3, bool), [0])


PLANAR = (ob.DubinsStateSpace, ob.ReedsSheppStateSpace, ob.TrochoidStateSpace)


@pytest.mark.parametrize(
    ("space", "message"),
    [
        (lambda: ob.DiscreteStateSpace(0, 3), "only real vectors, SO"),
        *(
            (lambda kind=kind: bounded(kind(), (-1, 1), (-1, 1)), rf"{kind.__name__}.*motions are curves")
            for kind in PLANAR
        ),
    ],
)
def test_other_spaces_are_refused(space, message):
    for refused in (space(), compound(space())):
        with pytest.raises(InputError, match=message):
            StateBridge(refused)


@pytest.mark.parametrize("elsewhere", [False, True])
def test_bindings_that_know_no_such_buffer_are_refused(kinova, monkeypatch, elsewhere):
    space, other, make = joint_space(kinova), np.zeros(kinova.n), states._new_capsule
    StateBridge(space)

    def capsule(address, *rest):
        return make(other.ctypes.data, *rest) if elsewhere else object()

    monkeypatch.setattr(states, "_new_capsule", capsule)
    monkeypatch.setattr(states, "_WORKING", set())
    with pytest.raises(PlanningError, match="version of OMPL's bindings"):
        StateBridge(space)


def test_states_are_used_again_once_nobody_holds_them(kinova):
    bridge, q = StateBridge(joint_space(kinova)), np.linspace(-1.0, 1.0, kinova.n)
    first = ScratchState(bridge)
    held = first.set(q)
    del first
    other = ScratchState(bridge)
    assert other.set(2 * q) is not held, "it is held here"
    np.testing.assert_array_equal(bridge.read(held), q)
    unused = id(other.state)
    del other
    assert id(ScratchState(bridge).state) == unused
    lines = [OwnState(StateBridge(space)).state for space in (ob.RealVectorStateSpace(2), ob.RealVectorStateSpace(3))]
    assert lines[0] is not lines[1]
