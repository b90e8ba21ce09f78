"""Variants of a robot leave the robot as it was."""

import numpy as np
import pytest

from safe_ompl.errors import InputError, UnknownNameError


def test_other_limits_leave_the_rest_alone(panda):
    narrow = panda.with_limits({"panda_joint2": (-0.5, 0.25)})
    assert (narrow.lower[1], narrow.upper[1]) == (-0.5, 0.25)
    np.testing.assert_array_equal(np.delete(narrow.upper, 1), np.delete(panda.upper, 1))
    assert panda.upper[1] > 1
    again = narrow.with_limits({"panda_joint1": (0.0, 1.0)})
    assert (again.upper[0], again.upper[1]) == (1.0, 0.25)


def test_accelerations_are_added_by_joint(panda):
    quick = panda.with_accelerations({"panda_joint1": 2.0}).with_accelerations({"panda_joint2": 3.0})
    assert quick.accelerations == {"panda_joint1": 2.0, "panda_joint2": 3.0}
    assert panda.accelerations == {}
    with pytest.raises(UnknownNameError, match="elbow"):
        panda.with_accelerations({"elbow": 1.0})
    with pytest.raises(InputError, match="'panda_joint1'"):
        panda.with_accelerations({"panda_joint1": 0.0})
