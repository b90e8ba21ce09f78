"""Planners by name, and parameters that are declared once: their methods, keywords, checks and words."""

import inspect
import math

import pytest
from ompl import base as ob
from plane import PlaneProblem

from safe_ompl import InputError, SafeRRTConnect, UnknownNameError, WorkspaceGoal, make_planner, planner_names
from safe_ompl.apps.cli.arguments import parameter
from safe_ompl.planning.planners import Parameter, SafePlanner, accepts, is_ours, needs_place
from safe_ompl.planning.planners.base import camel_case, parameters_of

OURS = [name for name in planner_names() if is_ours(name)]
PRINTED = [name for name in planner_names() if name.startswith("Paper")]


class Part:
    """Keeps a value."""

    length = 0.0


class Declared(SafePlanner):
    """A planner that only has parameters.

    References
    ----------
    .. [1] Nobody.
    """

    share = Parameter(0.5, "A share.", at_most=1)
    length = Parameter(2.0, "A length.", unit="m", above=0, kept_in="part.length")
    turns = Parameter(3, "A number of turns.", at_least=1)
    works = Parameter(True, "Whether it works.")

    def getTurns(self):
        """Return the turns in another way."""
        return -self.turns

    def _make_parts(self):
        self.part = Part()

    def _forget(self):
        pass


@pytest.fixture(scope="module")
def point():
    return PlaneProblem(SafeRRTConnect).si


@pytest.fixture(scope="module")
def si(planar3):
    return planar3.getSpaceInformation()


def test_defaults_keywords_setters_attributes_and_parts_are_one_value(point):
    planner, other = Declared(point, share=0.25, length=4), Declared(point)
    assert planner.getName() == "Declared"
    assert (planner.share, planner.getShare(), planner.turns, planner.getTurns(), planner.works) == (
        *(0.25, 0.25, 3, -3),
        True,
    )
    planner.setShare(1)
    assert planner.share == 1.0
    assert isinstance(planner.share, float)
    assert planner.part.length == planner.length == 4.0
    planner.part.length = 6.0
    assert planner.getLength() == 6.0
    assert (other.share, other.length) == (0.5, 2.0)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("share", 1.5, r"share: must be a finite number in \[0, 1\], got 1.5"),
        ("share", math.nan, "share: must be"),
        ("share", True, "share: must be"),
        ("length", 0.0, "length: must be a positive number, got 0.0"),
        ("length", math.inf, "length: must be"),
        ("turns", 0, "turns: must be a whole number >= 1, got 0"),
        ("turns", 2.0, "turns: must be"),
        ("works", 1, "works: must be true or false, got 1"),
        ("works", "off", "works: must be true or false"),
        ("works", None, "works: must be true or false"),
        ("colour", "red", "unknown parameter of Declared 'colour'; known: length, range, share"),
    ],
)
def test_what_makes_no_sense_is_refused_in_the_same_words_everywhere(point, name, value, message):
    planner = Declared(point)
    with pytest.raises(InputError, match=message):
        planner.setParameter(name, value)
    with pytest.raises(InputError, match=message):
        Declared(point, **{name: value})


def test_help_finds_methods_with_their_words():
    assert Declared.setLength.__qualname__ == "Declared.setLength"
    assert "length : float > 0, default 2.0 [m]\n    A length." in Declared.setLength.__doc__
    assert Declared.getTurns.__doc__ == "Return the turns in another way."
    assert list(inspect.signature(Declared).parameters)[:4] == ["si", "name", "share", "length"]
    text = inspect.getdoc(Declared)
    assert text.index("turns : int >= 1, default 3") < text.index("References\n----------")


@pytest.mark.parametrize("name", [*OURS, *PRINTED])
def test_every_parameter_has_words_and_comes_back(si, name):
    planner = make_planner(name, si)
    assert inspect.getmro(type(planner)).index(ob.Planner) <= 2, "parts instead of parents"
    for key, declared in parameters_of(type(planner)).items():
        assert declared.doc.endswith(".")
        assert key in type(planner).__doc__
        value = getattr(planner, key)
        getattr(planner, f"set{camel_case(key)}")(value)
        assert getattr(planner, key) == value


# --------------------------------------------------------------------------------------------------------- by name


@pytest.mark.parametrize("name", [*OURS, "RRTConnect"])
def test_a_planner_says_what_goals_it_plans_to(planar3, si, name):
    planner = make_planner(name, si)
    assert accepts(planner, WorkspaceGoal(si, planar3.robot, [0.5, 0.5, 0.0]))
    assert accepts(planner, ob.GoalStates(si)) is not needs_place(name)
    assert accepts(planner, ob.GoalRegion(si)) is (name == "RRTConnect"), "it cannot be sampled"


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("ClassicRRTConnect", {"alpha": 3}, "'alpha' of ClassicRRTConnect is fixed to"),
        ("ClassicPRM", {"alpha": 0.1}, "'alpha' of ClassicPRM is fixed to"),
        ("ClassicJTRRT", {"transpose": False}, "'transpose' of ClassicJTRRT is fixed to"),
        (
            "SafeRRTConnect",
            {"sed": 3},
            "unknown parameter of SafeRRTConnect 'sed'; known: alpha, clearance, danger_decay",
        ),
        ("SafeRRTConnect", {"seed": 3}, "the seed is the run's"),
        ("RRTConnect", {"seed": 3}, "the seed is the run's"),
        ("RRTConnect", {"ranges": 3}, "unknown parameter of RRTConnect 'ranges'"),
        ("RRTConnect", {"range": "far"}, "'far' has the wrong type"),
        ("SafeJTRRT", dict([parameter("transpose=maybe")]), "transpose: must be"),
        ("AnyPlanner", {}, "unknown planner 'AnyPlanner'"),
        *((name, {"slide": 0.5}, f"unknown parameter of {name} 'slide'") for name in PRINTED),
    ],
)
def test_what_a_planner_of_a_name_does_not_take_is_refused(si, name, given, message):
    with pytest.raises(InputError, match=message) as error:
        make_planner(name, si, given)
    assert isinstance(error.value, UnknownNameError) == ("unknown" in message)


@pytest.mark.parametrize(
    ("text", "value"), [("yes", True), ("On", True), ("true", True), ("no", False), ("OFF", False), ("false", False)]
)
def test_the_command_line_reads_booleans(text, value):
    assert parameter(f"transpose={text}") == ("transpose", value)
