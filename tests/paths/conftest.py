"""What the tests of paths share."""

import pytest
from crank import CRANK

from safe_ompl import Robot


@pytest.fixture(scope="module")
def crank(tmp_path_factory):
    """One joint about z that turns a ball of 0.05 m at a distance of 0.5 m."""
    urdf = tmp_path_factory.mktemp("crank") / "crank.urdf"
    urdf.write_text(CRANK)
    return Robot.from_urdf(urdf)
