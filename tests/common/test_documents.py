"""Checks of what users give: types of people's values, bounds, and messages in one voice."""

import re

import numpy as np
import pytest

from safe_ompl import InputError
from safe_ompl.common import UnknownNameError, documents


@pytest.mark.parametrize("value", [3, 3.0, np.float32(3), np.int64(3), np.uint8(3), np.array(3.0)])
def test_numbers_of_all_kinds_are_floats(value):
    number = documents.number("x", value)
    assert number == 3.0
    assert type(number) is float


@pytest.mark.parametrize(
    ("value", "bounds", "message"),
    [
        ("3", {}, "x: must be a finite number, got '3'"),
        (True, {}, "x: must be a finite number, got True"),
        (None, {}, "x: must be a finite number, got None"),
        (float("nan"), {"at_least": 0}, "x: must be a finite number >= 0, got nan"),
        (float("inf"), {"above": 0}, "x: must be a positive number, got inf"),
        (10**400, {"at_most": 2}, "x: must be a finite number <= 2, got 1000"),
        (0, {"above": 0, "kind": "length"}, "x: must be a positive length, got 0"),
        (1, {"above": 1}, "x: must be a finite number > 1, got 1"),
        (5, {"above": 0, "at_most": 4}, "x: must be a finite number in (0, 4], got 5"),
        (-1, {"at_least": 0, "at_most": 4}, "x: must be a finite number in [0, 4], got -1"),
        (np.array([1.0]), {}, "x: must be a finite number, got array([1.])"),
    ],
)
def test_what_is_no_such_number_is_refused(value, bounds, message):
    with pytest.raises(InputError) as caught:
        documents.number("x", value, **bounds)
    assert str(caught.value).startswith(message)


def test_bounds_that_are_met_exactly():
    assert documents.number("x", 0, at_least=0, at_most=0) == 0.0
    assert documents.fraction("x", 1) == 1.0
    assert documents.whole_number("n", np.int64(1), at_least=1) == 1
    assert type(documents.whole_number("n", np.int64(1))) is int
    assert documents.seed(np.uint32(2**32 - 1)) == 2**32 - 1


@pytest.mark.parametrize(
    ("check", "message"),
    [
        (lambda: documents.fraction("x", 1.1), "x: must be a finite number in [0, 1], got 1.1"),
        (lambda: documents.whole_number("n", 3.0), "n: must be a whole number, got 3.0"),
        (lambda: documents.whole_number("n", True), "n: must be a whole number, got True"),
        (lambda: documents.seed(-1), "seed: must be a whole number in [0, 4294967295], got -1"),
        (lambda: documents.flag("f", 1), "f: must be true or false, got 1"),
        (lambda: documents.text("t", "  "), "t: must be text that is not empty, got '  '"),
        (lambda: documents.finite_array([[1, 2], [3]], (None,), "q"), "q: must be numbers, got [[1, 2], [3]]"),
        (lambda: documents.finite_array([True, False], (2,), "q"), "q: must be numbers, got [True, False]"),
        (lambda: documents.finite_array(None, (2,), "q"), "q: must be numbers, got None"),
        (lambda: documents.finite_array([1, 2, 3], (None, 3), "p"), "p: must have shape (any, 3), got (3,)"),
        (lambda: documents.finite_array([1, np.nan], (2,), "q"), "q: must be finite, got [1.0, nan]"),
        (lambda: documents.instance("x", {}, InputError), "x: must be an InputError, got {}"),
    ],
)
def test_everything_else_speaks_alike(check, message):
    with pytest.raises(InputError) as caught:
        check()
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("name", "known", "meant"),
    [
        ("saferrtconnect", ("RRTConnect", "SafeRRTConnect"), "SafeRRTConnect"),
        ("panda_shelv", ("panda_shelf", "ur5_pillar"), "panda_shelf"),
        ("elbow", ("shoulder_joint", "elbow_joint"), "elbow_joint"),
        ("fly", ("panda_shelf", "ur5_pillar"), None),
        (7, ("a", "b"), None),
    ],
)
def test_names_that_are_nearly_right(name, known, meant):
    hint = f"did you mean {meant!r}? " if meant else ""
    assert str(UnknownNameError("x", name, known)).startswith(f"unknown x {name!r}; {hint}known: {known[0]}")
    with pytest.raises(InputError, match=re.escape(f"unknown key; {hint}valid keys")):
        documents.check_keys({name: 1}, known)


def test_a_message_is_short_whatever_is_given():
    points = np.zeros((1000, 3))
    points[500, 2] = np.nan
    with pytest.raises(InputError, match=r"^p: must be finite, got nan at \[500, 2\]$"):
        documents.finite_array(points, (None, 3), "p")
    with pytest.raises(InputError) as caught:
        documents.number("x", "a" * 10_000)
    assert len(str(caught.value)) < 300


def test_an_array_is_new_and_of_floats():
    given = np.arange(3, dtype=np.float32)
    array = documents.finite_array(given, (3,), "q")
    array[0] = 7
    assert given[0] == 0
    assert array.dtype == np.float64
