"""An arm that cannot reach its goal."""

import numpy as np
import pytest

from safe_ompl import Box, Obstacle, Pose, SafeSetup, Scenario, Scene
from safe_ompl.scene import find_scenario


@pytest.fixture(scope="package")
def planar2():
    return Scenario.load(find_scenario("planar2")).build_robot()


@pytest.fixture(scope="package")
def arm_between_walls(planar2):
    """Return an arm between two walls from the base to beyond its reach: the goal lies behind one of them."""
    reach = 1.2 * float(np.linalg.norm(planar2.tip_pose(np.zeros(planar2.n)).translation))
    walls = [
        Obstacle(
            f"wall {k}",
            Box((reach, 0.02, 0.4)),
            Pose.from_rpy((0.6 * reach * np.cos(a), 0.6 * reach * np.sin(a), 0.0), (0.0, 0.0, a)),
            weight=1.0,
        )
        for k, a in enumerate((np.pi / 2, -np.pi / 2))
    ]
    setup = SafeSetup(planar2, Scene(tuple(walls)), danger={"spacing": 0.2})
    setup.setConfigurations([0.0, 0.0], [3.0, 0.0])
    return setup
