"""An arm that cannot reach its goal."""

import numpy as np
import pytest

from safe_ompl.geometry.basic import Box
from safe_ompl.geometry.obstacle import Obstacle
from safe_ompl.geometry.pose import Pose
from safe_ompl.planning.safe_setup import SafeSetup
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scenario import Scenario, find_scenario
from safe_ompl.scene.scene import Scene


@pytest.fixture(scope="package")
def planar2() -> Robot:
    return Scenario.load(find_scenario("planar2")).build_robot()


@pytest.fixture(scope="package")
def arm_between_walls(planar2: Robot) -> SafeSetup:
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
