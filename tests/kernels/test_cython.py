"""The kernels in Cython give the same bits as those in Numba, whose places they are to take."""

from importlib import import_module

import numpy as np
import pytest

import safe_ompl
from safe_ompl import Scenario
from safe_ompl.drawing import rasteriser
from safe_ompl.planning import setup_scenario


@pytest.fixture(scope="module")
def built():
    """Return a function from a module's name to the module."""
    return lambda name: import_module(f"safe_ompl.{name}")


@pytest.fixture(scope="module", params=["panda_shelf", "ur5_handover", "paper_2"])
def setup(request):
    return setup_scenario(Scenario.load(request.param))


def same(first, second):
    """Assert that arrays or tuples of arrays are equal bit for bit, but that NaN is like NaN."""
    if not isinstance(first, tuple):
        first, second = (first,), (second,)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))


def skeleton_of(built, tables):
    kinematics, static = built("robot.kinematics"), built("danger.static")
    keys = kinematics.KeyPointTable(tables.keys, kinematics.JointTable(tables.joints))
    return static.SkeletonTable(keys, tables.links, tables.by_length)


@pytest.mark.parametrize(("parent", "message"), [(-1, "its parent is -1"), (2, "must be one of 0 to 0")])
def test_tables_refuse_what_leads_elsewhere(built, ur5, parent, message):
    kinematics = built("robot.kinematics")
    joints = ur5.kinematics.joints.copy()
    joints["parent"][0] = parent
    with pytest.raises(safe_ompl.InputError, match=message):
        kinematics.JointTable(joints)
    with pytest.raises(ValueError, match=r"[Bb]uffer|dtype|format"):
        kinematics.JointTable(np.zeros((3, 3)))


def test_pictures(built, rng):
    rendering = built("drawing.rendering")
    corners = rng.uniform(-20, 120, (60, 3))
    corners[::7] = np.nan
    faces = rng.integers(0, 60, (80, 3))
    nearness, owner = np.full((90, 100), -np.inf, np.float32), np.full((90, 100), -1, np.int32)
    rendering.draw_triangles(corners, faces, 0, nearness, owner)
    same(rasteriser.nearest_triangles(corners, faces, 100, 90), (nearness, owner))
