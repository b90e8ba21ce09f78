"""The bridge between OMPL states and arrays: round trips, wrapping, bounds, and spaces that it refuses."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ompl import base as ob

from safe_ompl import InputError, PlanningError
from safe_ompl.planning.ompl import ScratchState, StateBridge, joint_space, states

angles = st.floats(-100.0, 100.0)


def real_vector(*bounds):
    space = ob.RealVectorStateSpace(len(bounds))
    box = ob.RealVectorBounds(len(bounds))
    for k, (low, high) in enumerate(bounds):
        box.setLow(k, low)
        box.setHigh(k, high)
    space.setBounds(box)
    return space


@pytest.mark.parametrize("name", ["panda", "kinova", "twin_arm"])
def test_space_of_a_robot(robot_named, name):
    robot = robot_named(name)
    space = joint_space(robot)
    assert space.getDimension() == robot.n
    bridge = StateBridge(space)
    assert bridge.n == robot.n
    np.testing.assert_array_equal(bridge.circular, robot.continuous)
    np.testing.assert_allclose(bridge.lower, robot.lower)
    np.testing.assert_allclose(bridge.upper, robot.upper)
    if not robot.continuous.any():
        assert isinstance(space, ob.RealVectorStateSpace)


@pytest.mark.parametrize("name", ["panda", "kinova", "twin_arm"])
def test_round_trip(robot_named, rng, name):
    robot = robot_named(name)
    bridge = StateBridge(joint_space(robot))
    state = bridge.space.allocState()
    for q in rng.uniform(robot.lower, robot.upper, (20, robot.n)):
        bridge.write(q, state)
        np.testing.assert_array_equal(bridge.read(state), np.where(robot.continuous, bridge.wrapped(q), q))
        assert bridge.space.satisfiesBounds(state)


def test_states_agree_with_what_ompl_itself_says(kinova, rng):
    space = joint_space(kinova)
    bridge = StateBridge(space)
    first, second, between = (ScratchState(bridge) for _ in range(3))
    for q1, q2 in rng.uniform(kinova.lower, kinova.upper, (20, 2, 6)):
        space.interpolate(first.set(q1), second.set(q2), 0.3, between.state)
        expected = bridge.wrapped(q1 + 0.3 * bridge.difference(q1, q2))
        np.testing.assert_allclose(bridge.read(between.state), expected, atol=1e-12)
        np.testing.assert_allclose(bridge.difference(q1, q2), kinova.difference(q1, q2), atol=1e-12)


def test_reading_gives_a_copy_and_viewing_does_not(panda):
    bridge = StateBridge(joint_space(panda))
    first, second = ScratchState(bridge), ScratchState(bridge)
    first.set(np.full(7, -0.5))
    second.set(np.full(7, -0.1))
    copy, view = bridge.read(first.state), bridge.view(first.state)
    np.testing.assert_array_equal(view, -0.5)
    bridge.view(second.state)
    np.testing.assert_array_equal(copy, -0.5)
    np.testing.assert_array_equal(view, -0.1)


def test_a_configuration_of_the_wrong_size_is_not_written(panda):
    bridge = StateBridge(joint_space(panda))
    scratch = ScratchState(bridge)
    with pytest.raises(ValueError, match="could not broadcast"):
        scratch.set(np.zeros(6))


@given(angles)
def test_wrapped_angles_are_within_bounds_and_the_same(angle):
    bridge = StateBridge(ob.SO2StateSpace())
    wrapped = bridge.wrapped(np.array([angle]))[0]
    assert -np.pi <= wrapped <= np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)
    state = bridge.space.allocState()
    bridge.write(np.array([angle]), state)
    assert bridge.space.satisfiesBounds(state)


@given(angles, angles)
def test_differences_are_the_short_way(first, second):
    bridge = StateBridge(ob.SO2StateSpace())
    delta = bridge.difference(np.array([first]), np.array([second]))[0]
    assert abs(delta) <= np.pi + 1e-9
    assert np.cos(first + delta) == pytest.approx(np.cos(second), abs=1e-9)
    assert np.sin(first + delta) == pytest.approx(np.sin(second), abs=1e-9)


def test_nearest_configuration_inside_the_bounds():
    space = ob.CompoundStateSpace()
    space.addSubspace(real_vector((-1, 2), (0, 1)), 1.0)
    space.addSubspace(ob.SO2StateSpace(), 1.0)
    bridge = StateBridge(space)
    np.testing.assert_allclose(bridge.inside(np.array([5.0, 0.5, 4.0])), [2.0, 0.5, 4.0 - 2 * np.pi])
    np.testing.assert_allclose(bridge.inside(np.array([[-3.0, -1.0, 1.0]])), [[-1.0, 0.0, 1.0]])


def test_compounds_of_compounds():
    inner = ob.CompoundStateSpace()
    inner.addSubspace(ob.SO2StateSpace(), 1.0)
    inner.addSubspace(real_vector((-1, 1)), 0.5)
    outer = ob.CompoundStateSpace()
    outer.addSubspace(real_vector((0, 3), (0, 4)), 2.0)
    outer.addSubspace(inner, 1.0)
    bridge = StateBridge(outer)
    assert bridge.circular.tolist() == [False, False, True, False]
    np.testing.assert_allclose(bridge.upper, [3, 4, np.pi, 1])
    q = np.array([1.0, 2.0, 3.0, 0.5])
    np.testing.assert_array_equal(bridge.read(ScratchState(bridge).set(q)), q)


def test_the_plane_with_a_heading_is_such_a_compound():
    space = ob.SE2StateSpace()
    box = ob.RealVectorBounds(2)
    box.setLow(-1)
    box.setHigh(1)
    space.setBounds(box)
    assert StateBridge(space).circular.tolist() == [False, False, True]


@pytest.mark.parametrize("kind", [ob.SO3StateSpace, ob.DiscreteStateSpace])
def test_other_spaces_are_refused(kind):
    space = kind(0, 3) if kind is ob.DiscreteStateSpace else kind()
    with pytest.raises(InputError, match="only real vectors, SO"):
        StateBridge(space)
    compound = ob.CompoundStateSpace()
    compound.addSubspace(space, 1.0)
    with pytest.raises(InputError, match="only real vectors, SO"):
        StateBridge(compound)


@pytest.mark.parametrize("kind", [ob.DubinsStateSpace, ob.ReedsSheppStateSpace, ob.TrochoidStateSpace])
def test_spaces_of_curved_motions_are_refused(kind):
    space = kind()
    box = ob.RealVectorBounds(2)
    box.setLow(-1)
    box.setHigh(1)
    space.setBounds(box)
    compound = ob.CompoundStateSpace()
    compound.addSubspace(space, 1.0)
    for refused in (space, compound):
        with pytest.raises(InputError, match=rf"{kind.__name__}.*motions are curves"):
            StateBridge(refused)


def test_distances_are_ompls_own():
    inner = ob.CompoundStateSpace()
    inner.addSubspace(ob.SO2StateSpace(), 0.3)
    inner.addSubspace(real_vector((-1, 1), (-2, 2)), 0.5)
    space = ob.CompoundStateSpace()
    space.addSubspace(real_vector((0, 3), (0, 4)), 2.0)
    space.addSubspace(inner, 3.0)
    bridge = StateBridge(space)
    one, other = ScratchState(bridge), ScratchState(bridge)
    rows = bridge.between_bounds(np.random.default_rng(0).random((20, 5)))
    expected = [space.distance(one.set(q), other.set(rows[0])) for q in rows]
    np.testing.assert_allclose(bridge.distances(rows, rows[0]), expected, atol=1e-12)
    assert bridge.distances(rows[1], rows[0]) == pytest.approx(expected[1])


def test_shares_of_the_way_between_bounds():
    space = ob.CompoundStateSpace()
    space.addSubspace(real_vector((-1, 1), (2, 6)), 1.0)
    space.addSubspace(ob.SO2StateSpace(), 1.0)
    bridge = StateBridge(space)
    np.testing.assert_array_equal(bridge.between_bounds(np.zeros(3)), [-1, 2, -np.pi])
    np.testing.assert_array_equal(bridge.between_bounds(np.array([[0.5, 0.25, 0.5]])), [[0, 3, 0]])


# ---------------------------------------------------------------------------- where the bindings know no such buffer


@pytest.mark.parametrize("elsewhere", [False, True])
def test_bindings_that_know_no_such_buffer_are_refused(kinova, monkeypatch, elsewhere):
    space, other, make = joint_space(kinova), np.zeros(kinova.n), states._new_capsule
    StateBridge(space)

    def capsule(address, *rest):
        return make(other.ctypes.data, *rest) if elsewhere else object()

    monkeypatch.setattr(states, "_new_capsule", capsule)
    with pytest.raises(PlanningError, match="version of OMPL's bindings"):
        StateBridge(space)


def test_bounds_hold_what_ompl_says_they_hold():
    space = ob.CompoundStateSpace()
    space.addSubspace(real_vector((-1.0, 2.0), (0.0, 0.5)), 1.0)
    space.addSubspace(ob.SO2StateSpace(), 1.0)
    bridge, scratch = StateBridge(space), ScratchState(StateBridge(space))

    def holds(q):
        return bool((bridge.held[0] <= q).all() and (q <= bridge.held[1]).all())

    rng = np.random.default_rng(0)
    drawn = rng.uniform([-1.5, -0.2, -3.0], [2.5, 0.7, 3.0], (200, 3))
    corners = np.array([[-1.0, 0.0, 3.0], [2.0, 0.5, -3.0], [2.0 + 1e-12, 0.5, 0.0]])
    said = [holds(q) for q in np.concatenate([drawn, corners])]
    assert said == [space.satisfiesBounds(scratch.set(q)) for q in np.concatenate([drawn, corners])]
    assert 20 < sum(said) < 180
    assert holds(np.array([0.0, 0.1, 40.0])), "angles wrap"
    assert not holds(np.array([0.0, np.nan, 0.0]))
