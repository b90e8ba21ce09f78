"""Planners by name, and parameters that are declared once: their methods, keywords, checks and descriptions."""

import inspect
import math
import re

import pytest
from ompl import base as ob
from plane import PlaneProblem

from safe_ompl import InputError, SafeRRTConnect, UnknownNameError, WorkspaceGoal, make_planner, planner_names
from safe_ompl.apps.cli.arguments import parameter
from safe_ompl.planning.planners import Parameter, SafePlanner, accepts, is_ours, needs_place, settings_of
from safe_ompl.planning.planners.base import camel_case, parameters_of

OURS = [name for name in planner_names() if is_ours(name)]
PRINTED = [name for name in planner_names() if name.startswith("Paper")]


class Declared(SafePlanner):
    """A planner that only has parameters."""

    share = Parameter(0.5, at_most=1)
    setShare, getShare = share.methods()
    length = Parameter(2.0, above=0)
    turns = Parameter(3, at_least=1)
    works = Parameter(True)

    def _forget(self):
        pass


@pytest.fixture(scope="module")
def point():
    return PlaneProblem(SafeRRTConnect).si


@pytest.fixture(scope="module")
def si(planar3):
    return planar3.getSpaceInformation()


def test_defaults_keywords_setters_and_attributes_are_one_value(point):
    planner, other = Declared(point, share=0.25, length=4), Declared(point)
    assert planner.getName() == "Declared"
    assert (planner.share, planner.getShare(), planner.turns, planner.works) == (0.25, 0.25, 3, True)
    planner.setShare(1)
    assert planner.share == 1.0
    assert isinstance(planner.share, float)
    assert planner.length == 4.0
    assert (other.share, other.length) == (0.5, 2.0)


def test_ompls_flag_in_the_place_of_the_name_has_no_effect_and_that_is_said(point, caplog):
    assert Declared(point, True).getName() == "Declared"
    assert "Declared(si, True): the flag has no effect" in caplog.text
    with pytest.raises(InputError, match="name of Declared must be a string, got 3"):
        Declared(point, 3)


BAD_VALUES = [
    ("share", 1.5, r"share: must be a finite number in \[0, 1\], got 1.5"),
    ("share", math.nan, "share: must be"),
    ("share", True, "share: must be"),
    ("length", 0.0, "length: must be a positive number, got 0.0"),
    ("length", math.inf, "length: must be"),
    ("turns", 0, "turns: must be a whole number >= 1, got 0"),
    ("turns", 2.0, "turns: must be"),
    ("works", 1, "works: must be true or false, got 1"),
    ("works", "off", "works: must be true or false"),
    ("colour", "red", "unknown parameter of Declared 'colour'; known: length, range, share"),
]


@pytest.mark.parametrize(("name", "value", "message"), BAD_VALUES)
def test_what_makes_no_sense_is_refused_in_the_same_words_everywhere(point, name, value, message):
    planner = Declared(point)
    with pytest.raises(InputError, match=message):
        planner.setParameter(name, value)
    with pytest.raises(InputError, match=message):
        Declared(point, **{name: value})
    if name in parameters_of(Declared):
        with pytest.raises(InputError, match=message):
            setattr(planner, name, value)


def entry(key, declared):
    """Return the line of a docstring that describes a parameter, without its unit."""
    kind = type(declared.default).__name__
    if kind != "bool":
        kind += f" >= {declared.at_least:g}" if declared.above is None else f" > {declared.above:g}"
        kind += "" if declared.at_most is None else f", <= {declared.at_most:g}"
    default = "1 / 3" if declared.default == 1 / 3 else repr(declared.default)
    return f"{key} : {kind}, default {default}"


@pytest.mark.parametrize("name", [*OURS, *PRINTED])
def test_every_parameter_is_described_as_it_is_and_has_ompls_methods(si, name):
    planner = make_planner(name, si)
    assert inspect.getmro(type(planner)).index(ob.Planner) <= 2, "parts instead of parents"
    for key, declared in parameters_of(type(planner)).items():
        owner = SafePlanner if key == "range" else type(planner)
        assert re.search(rf"^{re.escape(entry(key, declared))}( \[\w+\])?$", inspect.getdoc(owner), re.MULTILINE)
        before = declared.default
        value = {bool: not before, int: before + 1, float: before / 2 + 0.25}[type(before)]
        getattr(planner, f"set{camel_case(key)}")(value)
        assert getattr(planner, key) == getattr(planner, f"get{camel_case(key)}")() == value != before
        assert f", {key}={value!r}" in repr(planner)
        assert settings_of(planner)[key] == value


@pytest.mark.parametrize("name", ["SafeRRTConnect", "SafePRM", "SafeJTRRT", "BubblePlanner"])
def test_values_that_are_set_at_any_time_reach_the_parts(si, name):
    planner = make_planner(name, si, {"alpha": 0.5})
    planner.setup()
    assert (planner._danger.alpha, planner._margin.largest) == (0.5, 0.05)
    planner.setAlpha(0.25)
    planner.clearance = 0.02
    planner.setup()
    assert (planner._danger.alpha, planner._margin.largest) == (0.25, 0.02)


# --------------------------------------------------------------------------------------------------------- by name


@pytest.mark.parametrize("name", [*OURS, "RRTConnect"])
def test_a_planner_says_what_goals_it_plans_to(planar3, si, name):
    planner = make_planner(name, si)
    assert accepts(planner, WorkspaceGoal(si, planar3.robot, [0.5, 0.5, 0.0]))
    assert accepts(planner, ob.GoalStates(si)) is not needs_place(name)
    assert accepts(planner, ob.GoalRegion(si)) is (name == "RRTConnect"), "it cannot be sampled"


NOT_TAKEN = [
    ("ClassicRRTConnect", {"alpha": 3}, "'alpha' of ClassicRRTConnect is fixed to"),
    ("ClassicPRM", {"alpha": 0.1}, "'alpha' of ClassicPRM is fixed to"),
    ("ClassicJTRRT", {"transpose": False}, "'transpose' of ClassicJTRRT is fixed to"),
    ("SafeRRTConnect", {"sed": 3}, "unknown parameter of SafeRRTConnect 'sed'; known: alpha, clearance, danger_decay"),
    ("SafeRRTConnect", {"seed": 3}, "the seed is the run's"),
    ("RRTConnect", {"seed": 3}, "the seed is the run's"),
    ("RRTConnect", {"ranges": 3}, "unknown parameter of RRTConnect 'ranges'"),
    ("RRTConnect", {"range": "far"}, "'far' has the wrong type"),
    ("SafeJTRRT", dict([parameter("transpose=maybe")]), "transpose: must be"),
    ("AnyPlanner", {}, "unknown planner 'AnyPlanner'"),
    *((name, {"slide": 0.5}, f"unknown parameter of {name} 'slide'") for name in PRINTED),
]


@pytest.mark.parametrize(("name", "given", "message"), NOT_TAKEN)
def test_what_a_planner_of_a_name_does_not_take_is_refused(si, name, given, message):
    with pytest.raises(InputError, match=message) as error:
        make_planner(name, si, given)
    assert isinstance(error.value, UnknownNameError) == ("unknown" in message)


@pytest.mark.parametrize(
    ("text", "value"), [("yes", True), ("On", True), ("true", True), ("no", False), ("OFF", False), ("false", False)]
)
def test_the_command_line_reads_booleans(text, value):
    assert parameter(f"transpose={text}") == ("transpose", value)
