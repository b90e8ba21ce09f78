"""Compiled modules refuse tables that lead elsewhere."""

import numpy as np
import pytest

from safe_ompl import InputError
from safe_ompl.robot.kinematics import JointTable


@pytest.mark.parametrize(("parent", "message"), [(-1, "its parent is -1"), (2, "must be one of 0 to 0")])
def test_tables_refuse_what_leads_elsewhere(ur5, parent, message):
    joints = ur5.kinematics.joints.copy()
    joints["parent"][0] = parent
    with pytest.raises(InputError, match=message):
        JointTable(joints)
    with pytest.raises(ValueError, match=r"[Bb]uffer|dtype|format"):
        JointTable(np.zeros((3, 3)))
