"""Variants of a robot leave the robot as it was."""

import numpy as np


def test_other_limits_leave_the_rest_alone(panda):
    narrow = panda.with_limits({"panda_joint2": (-0.5, 0.25)})
    assert (narrow.lower[1], narrow.upper[1]) == (-0.5, 0.25)
    np.testing.assert_array_equal(np.delete(narrow.upper, 1), np.delete(panda.upper, 1))
    assert panda.upper[1] > 1
    again = narrow.with_limits({"panda_joint1": (0.0, 1.0)})
    assert (again.upper[0], again.upper[1]) == (1.0, 0.25)
