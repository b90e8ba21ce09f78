"""Parameters that are declared once: their methods, keywords, checks and words; and names that are no longer used."""

import inspect
import math

import pytest
from plane import PlaneProblem

from safe_ompl import InputError, SafeRRTConnect, UnknownNameError, make_planner, planner_names
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners import Parameter, SafePlanner
from safe_ompl.planning.planners.parameters import camel_case, parameters_of
from safe_ompl.scene import Scenario, find_scenario


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
    limit = Parameter(math.inf, "A limit.", above=0)
    turns = Parameter(3, "A number of turns.", at_least=1)
    works = Parameter(True, "Whether it works.")
    shape = Parameter("round", "A shape.", choices=("round", "flat"))

    def getShape(self):
        """Return the shape in another way."""
        return self.shape.upper()

    def _make_parts(self):
        self.part = Part()

    def _forget(self):
        pass


@pytest.fixture(scope="module")
def si():
    return PlaneProblem(SafeRRTConnect).si


@pytest.fixture(scope="module")
def arm():
    return setup_scenario(Scenario.load(find_scenario("planar3")))


def test_defaults_keywords_setters_and_attributes_are_one_value(si):
    planner = Declared(si, share=0.25)
    assert planner.getName() == "Declared"
    assert (planner.share, planner.getShare(), planner.turns, planner.works) == (0.25, 0.25, 3, True)
    planner.setShare(1)
    assert planner.share == 1.0
    assert isinstance(planner.share, float)
    planner.turns = 5
    assert planner.getTurns() == 5
    assert planner.limit == math.inf
    planner.setLimit(4.0)
    planner.setLimit(math.inf)


def test_a_part_may_keep_the_value(si):
    planner = Declared(si, length=4)
    assert planner.part.length == planner.length == 4.0
    planner.part.length = 6.0
    assert planner.getLength() == 6.0


def test_values_of_two_planners_are_their_own(si):
    first, second = Declared(si, share=0.1, length=1.0), Declared(si)
    assert (second.share, second.length) == (0.5, 2.0)
    assert (first.share, first.length) == (0.1, 1.0)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("share", 1.5, r"share must be a finite number in \[0, 1\], got 1.5"),
        ("share", math.nan, "share must be"),
        ("share", True, "share must be"),
        ("length", 0.0, "length must be a positive number, got 0.0"),
        ("length", math.inf, "length must be"),
        ("limit", -math.inf, "limit must be"),
        ("turns", 0, "turns must be a whole number >= 1, got 0"),
        ("turns", 2.0, "turns must be"),
        ("works", 1, "works must be true or false, got 1"),
        ("shape", "square", "unknown shape 'square'; known: round, flat"),
        ("shape", None, "unknown shape None"),
        ("colour", "red", "unknown parameter of Declared 'colour'; known: length, limit"),
    ],
)
def test_what_makes_no_sense_is_refused_in_the_same_words_everywhere(si, name, value, message):
    planner = Declared(si)
    with pytest.raises(InputError, match=message):
        planner.setParameter(name, value)
    with pytest.raises(InputError, match=message):
        Declared(si, **{name: value})


def test_help_finds_methods_with_their_words():
    assert Declared.setLength.__qualname__ == "Declared.setLength"
    assert "length : float > 0, default 2.0 [m]\n    A length." in Declared.setLength.__doc__
    assert Declared.getShape.__doc__ == "Return the shape in another way."
    assert list(inspect.signature(Declared).parameters)[:4] == ["si", "name", "share", "length"]
    text = inspect.getdoc(Declared)
    assert text.index("shape : {'round', 'flat'}, default 'round'") < text.index("References\n----------")


@pytest.mark.parametrize("name", [name for name in planner_names() if name[0] != "R"][:20])
def test_every_parameter_has_words_and_comes_back(arm, name):
    planner = make_planner(name, arm.getSpaceInformation())
    for key, parameter in parameters_of(type(planner)).items():
        assert parameter.doc.endswith(".")
        assert key in type(planner).__doc__
        value = getattr(planner, key)
        getattr(planner, f"set{camel_case(key)}")(value)
        assert getattr(planner, key) == value


def test_other_parameters_are_unknown_and_named(si):
    with pytest.raises(UnknownNameError, match="known: alpha, clearance, danger_decay"):
        SafeRRTConnect(si, alfa=1.0)
