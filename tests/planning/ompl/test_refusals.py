"""What is asked of OMPL's objects is answered or refused in words; no refusal fails itself."""

import inspect

import numpy as np
import pytest
from ompl import base as ob, geometric as og

from safe_ompl import InputError, SafePRM, SafeRRTConnect, SafeSetup, Scene, make_planner, planner_names
from safe_ompl.common import told_apart
from safe_ompl.planning.planners.base import UnansweredRequest
from safe_ompl.robot import ScratchState


class OnPlane(ob.Constraint):
    """x = 0 in three dimensions."""

    def __init__(self):
        super().__init__(3, 1)

    def function(self, x, out):
        out[0] = x[0]


@pytest.mark.parametrize("kind", ["ProjectedStateSpace", "AtlasStateSpace", "TangentBundleStateSpace"])
def test_constrained_spaces_are_refused_by_name(kind):
    ambient, bounds = ob.RealVectorStateSpace(3), ob.RealVectorBounds(3)
    bounds.setLow(-1.0)
    bounds.setHigh(1.0)
    ambient.setBounds(bounds)
    si = ob.SpaceInformation(getattr(ob, kind)(ambient, OnPlane()))
    with pytest.raises(InputError, match=f"state space .*{kind}.*can be planned in"):
        SafeRRTConnect(si)


class Unpriced(ob.OptimizationObjective):
    """Its costs of states are plain numbers."""

    def stateCost(self, state):
        return 3.0

    def motionCost(self, start, end):
        return ob.Cost(1.0)


@pytest.mark.parametrize("planner", [SafeRRTConnect, SafePRM])
def test_costs_that_are_plain_numbers_are_refused(ur5, planner):
    setup = SafeSetup(ur5, Scene(()))
    setup.setConfigurations(np.zeros(6), np.full(6, 0.5))
    setup.setOptimizationObjective(Unpriced(setup.getSpaceInformation()))
    setup.setPlanner(planner(setup.getSpaceInformation()))
    with pytest.raises(InputError, match=r"Unpriced.stateCost must return an ob.Cost, got 3.0"):
        setup.solve(1.0)


OVER_THE_HALF_TURN = [[first, 2.9, 1.3, 3.0, 1.8, -3.0] for first in (3.0, -3.0)]


@pytest.mark.parametrize(
    ("name", "rows", "length"),
    [("ur5", [np.zeros(6), np.full(6, 0.5)], 0.5 * 6**0.5), ("kinova", OVER_THE_HALF_TURN, 2 * np.pi - 6)],
)
def test_a_path_of_ompl_is_reported_as_its_way_points_the_short_way_round(robot_named, name, rows, length):
    setup = SafeSetup(robot_named(name), Scene(()))
    path, scratch = og.PathGeometric(setup.getSpaceInformation()), ScratchState(setup.bridge)
    for q in rows:
        path.append(scratch.set(np.array(q)))
    assert setup.report(path).certified
    assert setup.is_free(path)
    assert setup.report(path).length == pytest.approx(length)


OUTSIDE = [
    (3.14159265359, (-3.14159265358, 3.14159265358), "3.14159265359"),
    (3.2, (-3.14159265358, 3.14159265358), "3.2"),
    (np.nextafter(1.0, 2.0), (-1.0, 1.0), "1.0000000000000002"),
]


@pytest.mark.parametrize(("value", "limits", "shown"), OUTSIDE)
def test_a_value_outside_is_told_from_its_limits(value, limits, shown):
    assert told_apart(value, *limits)[0] == shown


# What OMPL's bindings call in Python without harm. `getPlannerData`, `printSettings` and `printProperties` end the
# process when C++ calls them, and what else is virtual is mostly never called.
COSTS = ["stateCost", "motionCost", "initialCost", "terminalCost", "averageStateCost", "identityCost", "infiniteCost"]
COSTS += ["motionCostHeuristic", "motionCostBestEstimate", "combineCosts", "subtractCosts", "betterCost"]
COSTS += ["isCostBetterThan", "isCostEquivalentTo", "isFinite", "isSatisfied", "isSymmetric"]
CALLED = {
    ob.Planner: {"solve", "setup", "clear", "clearQuery"},
    ob.StateValidityChecker: {"isValid", "clearance"},
    ob.MotionValidator: {"checkMotion"},
    ob.OptimizationObjective: set(COSTS),
    ob.GoalSampleableRegion: {"sampleGoal", "maxSampleCount", "couldSample", "distanceGoal"},
}


def descendants(kind):
    own = [c for c in kind.__subclasses__() if c.__module__.startswith("safe_ompl.")]
    return {*own, *(below for c in own for below in descendants(c))}


@pytest.mark.parametrize("base", CALLED)
def test_only_what_the_bindings_call_without_harm_is_overridden(base, ur5):
    si = SafeSetup(ur5, Scene(())).getSpaceInformation()
    for name in planner_names():
        make_planner(name, si)  # imports its class
    kinds = descendants(base)
    assert kinds
    for kind in kinds:
        ours = [c for c in kind.__mro__ if c.__module__.startswith("safe_ompl.")]
        names = {name for c in ours for name in vars(c) if hasattr(base, name) and not name.startswith("__")}
        # To C++ this is OMPL's own method, which gives nothing.
        kept = {name for name in names if inspect.getattr_static(kind, name).__class__ is UnansweredRequest}
        assert names - kept <= CALLED[base], kind
        assert kept <= {"getPlannerData"}


@pytest.mark.parametrize("name", planner_names())
def test_no_attribute_of_a_planner_has_the_name_of_a_method_of_ompls(ur5, name):
    planner = make_planner(name, SafeSetup(ur5, Scene(())).getSpaceInformation())
    assert not {*getattr(planner, "__dict__", {})} & {*dir(ob.Planner)} - {"__dict__", "__weakref__"}
