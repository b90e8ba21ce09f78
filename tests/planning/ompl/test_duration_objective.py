"""Duration as an objective of OMPL: what is exact of it, what a bound, and that it falls with what it leaves out."""

from itertools import pairwise

import numpy as np
import pytest
from ompl import base as ob

from safe_ompl import CollisionChecker, DurationObjective, InputError, MotionProver, PathTimer, RateLimits
from safe_ompl.planning.ompl import StateBridge, joint_space
from safe_ompl.scene import People, Scenario, find_scenario


@pytest.fixture(scope="module")
def shelf():
    return Scenario.load(find_scenario("panda_shelf"))


@pytest.fixture(scope="module")
def made(panda, shelf):
    """Return objectives without and with people, and a function that makes states."""
    si = ob.SpaceInformation(joint_space(panda))
    motion = MotionProver(CollisionChecker(panda, shelf.scene))
    limits = RateLimits.of(panda, acceleration=[15, 7.5, 10, 12.5, 15, 20, 20])
    timers = PathTimer(panda, limits), PathTimer(panda, limits, motion=motion, people=People())
    bridge = StateBridge(si.getStateSpace())

    def state(q):
        made = si.allocState()
        bridge.write(np.asarray(q, dtype=float), made)
        return made

    return *(DurationObjective(si, timer) for timer in timers), state


EDGES = [
    ([1.45, 0.1, 0.0, -1.7, 0.0, 3.37, 0.785], [0.7, -0.6, 0, -2.2, 0, 3.0, 0.785]),
    ([0.7, -0.6, 0, -2.2, 0, 3.0, 0.785], [-0.7, -0.6, 0, -2.4, 0, 2.6, 0.785]),
]


@pytest.mark.parametrize("edge", EDGES)
def test_alone_it_is_the_time_at_full_speed(made, panda, edge):
    alone, _, state = made
    expected = (np.abs(np.subtract(*edge)) / alone.timer.limits.velocity).max()
    a, b = map(state, edge)
    assert alone.motionCost(a, b).value() == pytest.approx(expected)
    assert alone.motionCostHeuristic(a, b).value() == pytest.approx(expected)
    assert alone.motionCost(a, a).value() == 0
    assert alone.timer.time(edge).duration > expected  # it must also accelerate


@pytest.mark.parametrize("edge", EDGES)
def test_beside_people_it_takes_longer_and_the_heuristic_stays_below(made, edge):
    alone, beside, state = made
    a, b = map(state, edge)
    assert beside.motionCost(a, b).value() >= alone.motionCost(a, b).value()
    assert beside.motionCostHeuristic(a, b).value() <= beside.motionCost(a, b).value()
    assert beside.motionCost(*map(state, EDGES[1])).value() > 1.5 * alone.motionCost(*map(state, EDGES[1])).value()


def test_the_integral_is_as_exact_as_it_says(made, panda):
    _, beside, state = made
    a, b = (np.array(q) for q in EDGES[1])
    Q = a + np.linspace(0, 1, 100)[:, None] * (b - a)
    dense = sum(beside.motionCost(state(p), state(q)).value() for p, q in pairwise(Q))
    assert beside.motionCost(state(a), state(b)).value() == pytest.approx(dense, rel=0.03)


def test_times_left_are_those_of_all_pairs(made, panda, shelf):
    distances = made[1].timer.distances
    Q = np.array(EDGES[0])
    fresh = [distances.times_at(q[None])[0] for q in Q]
    np.testing.assert_allclose(distances.times_at(Q), fresh)
    assert made[1].values(Q).min() >= made[0].values(Q).min()


def test_the_worst_and_the_options(made):
    alone, beside, state = made
    slow = beside.values(np.array([[0.0, 0.9, 0.0, -1.2, 0.0, 2.0, 0.785]]))[0]
    assert slow <= 50 * alone.values(np.zeros((1, 7)))[0] * (1 + 1e-9)
    assert "duration" in beside.getDescription()
    assert beside.stateCost(state(EDGES[0][0])).value() > 0
    with pytest.raises(InputError, match="tolerance"):
        DurationObjective(beside.getSpaceInformation(), beside.timer, tolerance=0)
