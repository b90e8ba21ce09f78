"""A path beside a worker, and views that are stopped after a test."""

import pytest

from safe_ompl import Box, Obstacle, Person, Pose, SafeSetup, Scene

START, GOAL = [0.4, -1.2, 1.2, -1.0, -1.57, 0.0], [-0.8, -1.0, 1.0, -1.0, -1.57, 0.0]


@pytest.fixture(scope="package")
def beside_a_worker(ur5):
    """Return a scene with a table and a worker, and a path there."""
    table = Obstacle("table", Box((1.0, 1.0, 0.04)), Pose((0.0, 0.0, -0.05)))
    setup = SafeSetup(ur5, Scene((table, Obstacle("worker", Person(height=1.7), Pose((1.2, 0.0, -0.8))))))
    setup.setConfigurations(START, GOAL)
    found = setup.plan("SafeRRTConnect", time=10.0, seed=0)
    assert found
    return found


@pytest.fixture
def browser_view():
    """Return a function from content to a view without a browser."""
    pytest.importorskip("viser")
    from safe_ompl.drawing.viewer import BrowserView

    views = []
    yield lambda content: views.append(BrowserView(content, port=8765)) or views[-1]
    for view in views:
        view.stop()
