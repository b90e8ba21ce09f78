"""Planners by name: which there are, how they are built, and the parameters that they take and refuse."""

import inspect

import numpy as np
import pytest
from ompl import base as ob

from safe_ompl import InputError, Scenario, UnknownNameError, WorkspaceGoal, make_planner, planner_names
from safe_ompl.apps.cli.arguments import parameter
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners import accepts, is_ours, needs_place
from safe_ompl.scene import find_scenario

OURS = [name for name in planner_names() if is_ours(name)]
PRINTED = [name for name in planner_names() if name.startswith("Paper")]


@pytest.fixture(scope="module")
def setup():
    return setup_scenario(Scenario.load(find_scenario("planar3")))


@pytest.fixture(scope="module")
def si(setup):
    return setup.getSpaceInformation()


@pytest.mark.parametrize("name", [*OURS, *PRINTED])
def test_at_most_two_of_our_classes_are_below_ompls(si, name):
    classes = inspect.getmro(type(make_planner(name, si)))
    assert classes.index(ob.Planner) <= 2


@pytest.mark.parametrize("name", [*OURS, "RRTConnect"])
def test_a_planner_says_what_goals_it_plans_to(setup, si, name):
    place, region = WorkspaceGoal(si, setup.robot, [0.5, 0.5, 0.0]), ob.GoalStates(si)
    planner = make_planner(name, si)
    assert accepts(planner, place)
    assert accepts(planner, region) is not needs_place(name)


def test_goals_that_cannot_be_sampled_are_refused_by_ours(si):
    for name in OURS:
        assert not make_planner(name, si).accepts(ob.GoalRegion(si))


@pytest.mark.parametrize(
    ("name", "key", "other"),
    [
        ("ClassicRRTConnect", "alpha", 3),
        ("ClassicPRM", "alpha", 0.1),
        ("ClassicBubble", "alpha", 1.0),
        ("ClassicJTRRT", "alpha", 2.0),
        ("ClassicJTRRT", "transpose", False),
    ],
)
def test_what_is_fixed_for_a_classical_planner_is_refused(si, name, key, other):
    with pytest.raises(InputError, match=f"{key!r} of {name} is fixed to"):
        make_planner(name, si, {key: other})


def test_what_is_fixed_may_be_said(si):
    assert make_planner("ClassicRRTConnect", si, {"alpha": 0}).getAlpha() == 0


@pytest.mark.parametrize("name", ["SafeRRTConnect", "RRTConnect"])
def test_the_seed_is_no_parameter(setup, name):
    with pytest.raises(InputError, match="seed"):
        setup.plan(name, parameters={"seed": 3})


def test_the_seed_is_not_among_the_known_parameters(si):
    with pytest.raises(UnknownNameError) as error:
        make_planner("SafeRRTConnect", si, {"sed": 3})
    assert "alpha" in str(error.value)
    assert "seed" not in str(error.value)


BOOLEANS = [("SafeRRTConnect", "short_steps"), ("SafeJTRRT", "transpose")]


@pytest.mark.parametrize(("name", "key"), BOOLEANS)
@pytest.mark.parametrize("value", ["off", "no", "", 0, 1, None, 0.0])
def test_booleans_are_booleans(si, name, key, value):
    with pytest.raises(InputError, match=f"{key} must be"):
        make_planner(name, si, {key: value})


@pytest.mark.parametrize(("name", "key"), BOOLEANS)
@pytest.mark.parametrize("value", [False, True, np.False_])
def test_booleans_are_taken(si, name, key, value):
    getter = "get" + "".join(map(str.capitalize, key.split("_")))
    assert getattr(make_planner(name, si, {key: value}), getter)() is bool(value)


@pytest.mark.parametrize(
    ("text", "value"), [("yes", True), ("On", True), ("true", True), ("no", False), ("OFF", False), ("false", False)]
)
def test_the_command_line_reads_booleans(text, value):
    assert parameter(f"transpose={text}") == ("transpose", value)


@pytest.mark.parametrize(("name", "key"), BOOLEANS)
def test_nonsense_on_the_command_line_is_refused_with_the_parameters_name(si, name, key):
    with pytest.raises(InputError, match=key):
        make_planner(name, si, dict([parameter(f"{key}=maybe")]))


@pytest.mark.parametrize("name", PRINTED)
def test_the_printed_forms_have_no_parameters_that_are_ours(si, name):
    ours = ("slide", "nearest_fraction", "clearance", "threshold_rise", "danger_decay", "short_steps")
    for key in (*ours, "random_starts"):
        with pytest.raises(UnknownNameError, match=f"unknown parameter of {name} {key!r}"):
            make_planner(name, si, {key: 0.5})
