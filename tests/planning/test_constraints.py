"""Whoever plans keeps what is demanded of whole paths; limits of the tool also in scenarios and commands."""

import dataclasses
import json
from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from ball import densely

from safe_ompl import CollisionChecker, CollisionError, Cylinder, InputError, Obstacle, Pose, TipBounds, ToolOrientation
from safe_ompl.apps import main
from safe_ompl.planning import SafeSetup, setup_scenario
from safe_ompl.planning.planners import needs_place
from safe_ompl.robot import GoalRegion, RobotSpec, inverse_kinematics
from safe_ompl.scene import Goal, Scenario, Scene, ToolConstraint
from safe_ompl.scene.constraints import PathLimits, TipBox

DOWN = np.diag([1.0, -1.0, -1.0])
LIMIT = np.radians(30.0)
LEAST, MOST = np.array([-1.0, -1.0, 0.3]), np.array([1.0, 1.0, 0.55])
TUBE = 0.05  # [rad]
SIDES = ([0.4, 0.4, 0.4], [0.4, -0.4, 0.4])  # of the pillar


@pytest.fixture(scope="module")
def scene():
    return Scene([Obstacle("pillar", Cylinder(0.08, 1.4), Pose([0.5, 0, 0.7]), weight=1.0)], spacing=0.1)


@pytest.fixture(scope="module")
def ends(ur5, scene):
    """Return a start and a goal with a cup upright in the hand."""
    checker = CollisionChecker(ur5, scene)
    options = {"valid": lambda q: not checker.in_collision(q)}
    start = inverse_kinematics(ur5, SIDES[0], DOWN, **options)
    return start, inverse_kinematics(ur5, SIDES[1], DOWN, near=start, **options)


@pytest.fixture
def setup(ur5, scene, ends):
    setup = SafeSetup(ur5, scene)
    setup.setConfigurations(*ends)
    return setup


def tool_limit(setup, kind):
    return setup.getConstraints().tool_limit(kind)


def tilts(setup, Q):
    """Return how far [rad] what points up at the start leans from that at some configurations."""
    cup = setup.robot.tip_pose(setup.query.start).rotation.T @ [0.0, 0.0, 1.0]
    return np.array([np.arccos(min(1.0, (setup.robot.tip_pose(q).rotation @ cup)[2])) for q in Q])


def test_states_and_regions_know_of_it(ur5, scene, ends):
    setup = SafeSetup(ur5, scene)
    setup.setStartConfiguration(ends[0])
    setup.setToolConstraint(angle=LIMIT)
    turned = {"roll": (np.pi - 1.0, np.pi + 1.0), "pitch": (-1.0, 1.0)}  # many of these spill
    setup.setGoalRegion(GoalRegion(Pose(SIDES[1]), x=(-0.05, 0.05), y=(-0.05, 0.05), **turned))
    result = setup.plan(seed=1, time=8.0)
    assert result
    assert tool_limit(setup, ToolOrientation).allows(result.path[-1])
    assert setup.getGoal().solutions.shape[0] >= 1
    assert all(tool_limit(setup, ToolOrientation).allows(q) for q in setup.getGoal().solutions)


def test_a_goal_that_spills_and_an_axis_without_a_start(setup, ends, ur5, scene):
    setup.setTipBounds(LEAST, MOST)
    np.testing.assert_array_equal(tool_limit(setup, TipBounds).upper, MOST)
    setup.setTipBounds(None)
    assert tool_limit(setup, TipBounds) is None
    setup.setToolConstraint(angle=LIMIT)
    tilted = inverse_kinematics(setup.robot, SIDES[1], pin.rpy.rpyToMatrix(0.6, 0, 0) @ DOWN)
    with pytest.raises(CollisionError, match=r"goal: the tool is 34\.38° from its direction, 30° are allowed"):
        setup.setConfigurations(ends[0], tilted)
    setup.setToolConstraint()
    assert tool_limit(setup, ToolOrientation) is None
    setup.setConfigurations(ends[0], tilted)
    without_start = SafeSetup(ur5, scene)
    without_start.setToolConstraint()
    with pytest.raises(InputError, match="set a start before, or give the axis"):
        without_start.setToolConstraint(angle=LIMIT)


# -------------------------------------------------------------------------------- all limits, and all planners


def clearance(setup, Q):
    return min(setup.checker.clearance(q).distance for q in Q[::10]) + 1e-4


def room_in_tube(setup, Q):
    """Return −1 where a corner of the tube about some configurations touches something, otherwise 1."""
    corners = Q[::10] + TUBE * np.random.default_rng(0).choice([-1.0, 1.0], (8, len(Q[::10]), Q.shape[1]))
    return 1 - 2 * any(setup.checker.in_collision(q) for q in corners.reshape(-1, Q.shape[1]))


def room_in_box(setup, Q):
    tips = np.array([setup.robot.tip_pose(q).translation for q in Q])
    return min((tips - LEAST).min(), (MOST - tips).min())


KEPT = {  # how it is demanded, what is left of it on a path, less than nothing where it is not kept; what is said then
    "danger": (
        lambda setup: setup.setMaxDanger(18.0),
        lambda setup, Q: 18.0 - setup.field.values(Q).max(),
        "'danger' and 'its limit'",
    ),
    "clearance": (lambda setup: setup.setMinClearance(0.1), lambda setup, Q: clearance(setup, Q) - 0.1, "'pillar'"),
    "clear of what may move": (
        lambda setup: setup.setMovingObstacles({"pillar": 0.2}, 0.4),
        lambda setup, Q: clearance(setup, Q) - 0.08,
        "'pillar'",
    ),
    "tube": (lambda setup: setup.setTube(TUBE), room_in_tube, "'pillar'"),
    "upright tool": (
        lambda setup: setup.setToolConstraint(angle=LIMIT),
        lambda *path: LIMIT - tilts(*path).max(),
        "'tool orientation' and 'its limit'",
    ),
    "box of the tip": (lambda setup: setup.setTipBounds(LEAST, MOST), room_in_box, "'tip position' and 'its limit'"),
    "the user's checker": (
        lambda setup: setup.setStateValidityChecker(lambda state: bool(state[1] > -0.6)),
        lambda setup, Q: Q[:, 1].min() + 0.6 + 0.01,
        "'its own answer'",
    ),
}


PLANNERS = ["SafeRRTConnect", "SafeJTRRT", "SafePRM", "RRTConnect"]
# Bubbles are small near a limit of the tool: the bubble planner takes long there.
BY_BUBBLES = [kind for kind in KEPT if kind not in ("upright tool", "box of the tip")]


@pytest.mark.parametrize(("kind", "planner"), [*product(KEPT, PLANNERS), *product(BY_BUBBLES, ["BubblePlanner"])])
def test_whoever_plans_keeps_what_is_demanded_and_forgets_what_was_built_before(setup, kind, planner):
    demand, left, _ = KEPT[kind]
    if needs_place(planner):
        setup.setWorkspaceGoal(SIDES[1], DOWN)
    setup.prepare(planner, 0)
    assert setup.solve(20.0)
    demand(setup)
    with pytest.raises(InputError, match="there is no solution"):
        setup.simplifySolution(0.1)
    assert setup.solve(20.0)
    paths = [setup.solution()]
    for options in ({"simplify": True}, {"optimise": 0.2}) if planner == "SafeRRTConnect" else ({},):
        result = setup.plan(planner, time=20.0, seed=1, **options)
        assert result.certified
        paths.append(result.path)
    assert all(left(setup, densely(setup.robot, path)) >= 0.0 for path in paths)


@pytest.mark.parametrize("kind", KEPT)
def test_paths_without_the_demand_do_not_keep_it_and_are_refused(setup, kind):
    demand, left, words = KEPT[kind]
    paths = (setup.plan("ClassicRRTConnect", seed=seed).path for seed in range(6))
    path = next(path for path in paths if left(setup, densely(setup.robot, path)) < 0.0)
    assert setup.is_free(path)
    demand(setup)
    refused = setup.is_free(path)
    assert not refused
    assert words in refused.why


# ----------------------------------------------------------------------------------- scenarios and command line


@pytest.fixture
def scenario(scene, ends):
    start, goal = (tuple(q.tolist()) for q in ends)
    return Scenario("cup", RobotSpec("ur5"), scene, start, Goal((goal,)))


def test_scenarios_have_limits_and_regions(scenario, tmp_path):
    tool = ToolConstraint(LIMIT, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0))
    exempt = (("wrist_3_link", "pillar"), ("wrist_2_link", "pillar"))
    limits = PathLimits(30.0, 0.02, ("pillar",), exempt, tool=tool, tip=TipBox(z=(0.2, 0.9)))
    region = GoalRegion(Pose(SIDES[1]), x=(-0.05, 0.05), yaw=(0.0, 1.0))
    for goal in (Goal(region=region), Goal(scenario.goal.configurations, region=region, tolerance=0.004)):
        dataclasses.replace(scenario, goal=goal, limits=limits).save(tmp_path / "cup.yaml")
        again = Scenario.load(tmp_path / "cup.yaml")
        assert (again.goal, again.limits) == (goal, limits)
        setup = setup_scenario(again)
        assert tool_limit(setup, ToolOrientation).limit == LIMIT
        assert tool_limit(setup, TipBounds).lower.tolist() == [-np.inf, -np.inf, 0.2]
        kept = setup.getConstraints().separation.min_clearance
        assert (kept.distance, kept.obstacles, kept.exempt) == (0.02, ("pillar",), set(exempt))
    result = setup.plan(seed=1, time=8.0)
    assert result.report.danger.max <= 30.0
    claims = ("no collision", "min clearance", "max danger", "tool orientation", "tip position")
    assert result.report.validation.claims == claims


def test_limits_on_the_command_line(scenario, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    scenario.save("cup.yaml")
    limits = ["--keep-upright", "30", "--max-danger", "30", "--min-clearance", "0.02"]
    files = ["--json", "result.json", "--certificate", "proof.json"]
    assert main(["plan", "cup.yaml", "--seed", "1", *limits, *files]) == 0
    result, proof = (json.loads(Path(name).read_text()) for name in ("result.json", "proof.json"))
    setup = setup_scenario(scenario)
    assert tilts(setup, densely(setup.robot, np.array(result["path"]))).max() <= LIMIT
    assert "tool orientation" in result["validation"]["claims"]
    assert proof["stretches"][0]["danger"]["bound"] <= 30.0
    assert proof["stretches"][0]["clearance"] == {"distance": 0.02, "obstacles": ["pillar"]}
    capfd.readouterr()
    assert main(["verify", "proof.json"]) == 0
    assert "at least 20 mm from pillar" in capfd.readouterr().out
    assert main(["plan", "cup.yaml", "--max-danger", "3"]) == 2
    assert "is above the limit 3" in capfd.readouterr().err
