"""Whoever plans keeps what a setup demands of whole paths, and paths without the demand do not keep it."""

from itertools import product

import numpy as np
import pytest
from ball import densely

from safe_ompl import CollisionChecker, Cylinder, Obstacle, Pose, SafeSetup, Scene
from safe_ompl.planning.planners import needs_place
from safe_ompl.robot import inverse_kinematics

DOWN = np.diag([1.0, -1.0, -1.0])
SIDES = ([0.4, 0.4, 0.4], [0.4, -0.4, 0.4])  # of the pillar
LEAST, MOST = np.array([-1.0, -1.0, 0.3]), np.array([1.0, 1.0, 0.55])
TUBE = 0.05  # [rad]


@pytest.fixture
def setup(ur5):
    """Return a setup of a UR5 that carries a cup from one side of a pillar to the other."""
    scene = Scene([Obstacle("pillar", Cylinder(0.08, 1.4), Pose([0.5, 0, 0.7]), weight=1.0)], spacing=0.1)
    checker = CollisionChecker(ur5, scene)
    start = inverse_kinematics(ur5, SIDES[0], DOWN, valid=lambda q: not checker.in_collision(q))
    goal = inverse_kinematics(ur5, SIDES[1], DOWN, valid=lambda q: not checker.in_collision(q), near=start)
    setup = SafeSetup(ur5, scene)
    setup.setConfigurations(start, goal)
    return setup


def clearance(setup, Q):
    return min(setup.checker.clearance(q).distance for q in Q[::10]) + 1e-4


def room_in_tube(setup, Q):
    """Return −1 where a corner of the tube about some configurations touches something, otherwise 1."""
    corners = Q[::10] + TUBE * np.random.default_rng(0).choice([-1.0, 1.0], (8, len(Q[::10]), Q.shape[1]))
    return 1 - 2 * any(setup.checker.in_collision(q) for q in corners.reshape(-1, Q.shape[1]))


def upright(setup, Q):
    """Return the cosine of the angle by which what points up at the start leans at most."""
    cup = setup.robot.tip_pose(setup.query.start).rotation.T @ [0.0, 0.0, 1.0]
    return min((setup.robot.tip_pose(q).rotation @ cup)[2] for q in Q)


def room_in_box(setup, Q):
    tips = np.array([setup.robot.tip_pose(q).translation for q in Q])
    return min((tips - LEAST).min(), (MOST - tips).min())


KEPT = {  # how it is demanded, and what is left of it on a path; less than nothing where it is not kept
    "danger": (lambda setup: setup.setMaxDanger(18.0), lambda setup, Q: 18.0 - setup.field.values(Q).max()),
    "clearance": (lambda setup: setup.setMinClearance(0.1), lambda setup, Q: clearance(setup, Q) - 0.1),
    "clear of what may move": (
        lambda setup: setup.setMovingObstacles({"pillar": 0.2}, 0.4),
        lambda setup, Q: clearance(setup, Q) - 0.08,
    ),
    "tube": (lambda setup: setup.setTube(TUBE), room_in_tube),
    "upright tool": (lambda setup: setup.setToolConstraint(angle=np.pi / 6), lambda *path: upright(*path) - 0.75**0.5),
    "box of the tip": (lambda setup: setup.setTipBounds(LEAST, MOST), room_in_box),
    "the user's checker": (
        lambda setup: setup.setStateValidityChecker(lambda state: bool(state[1] > -0.6)),
        lambda setup, Q: Q[:, 1].min() + 0.6 + 0.01,
    ),
}


PLANNERS = ["SafeRRTConnect", "SafeJTRRT", "SafePRM", "RRTConnect"]
# Bubbles are small near a limit of the tool: the bubble planner takes long there.
BY_BUBBLES = [kind for kind in KEPT if kind not in ("upright tool", "box of the tip")]


@pytest.mark.parametrize(("kind", "planner"), [*product(KEPT, PLANNERS), *product(BY_BUBBLES, ["BubblePlanner"])])
def test_whoever_plans_keeps_what_is_demanded(setup, kind, planner):
    demand, left = KEPT[kind]
    demand(setup)
    if needs_place(planner):
        setup.setWorkspaceGoal(SIDES[1], DOWN)
    for seed, simplify in enumerate((False, planner == "SafeRRTConnect")):
        result = setup.plan(planner, time=20.0, seed=seed, simplify=simplify)
        assert result.certified
        assert left(setup, densely(setup.robot, result.path)) >= 0.0


@pytest.mark.parametrize("kind", KEPT)
def test_paths_without_the_demand_do_not_keep_it(setup, kind):
    paths = (setup.plan("ClassicRRTConnect", seed=seed).path for seed in range(6))
    assert any(KEPT[kind][1](setup, densely(setup.robot, path)) < 0.0 for path in paths)
