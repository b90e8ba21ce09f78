"""Limits of the tool on whole paths: planners, simplification, reports, scenarios and the command line keep to them."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from ball import densely

from safe_ompl import (
    CollisionChecker,
    CollisionError,
    Cylinder,
    InputError,
    Obstacle,
    Pose,
    SafeSetup,
    TipBounds,
    ToolOrientation,
)
from safe_ompl.apps import main
from safe_ompl.planning import setup_scenario
from safe_ompl.robot import GoalRegion, RobotSpec, inverse_kinematics
from safe_ompl.scene import Goal, Scenario, Scene, ToolConstraint
from safe_ompl.scene.constraints import PathLimits, TipBox

DOWN = np.diag([1.0, -1.0, -1.0])
LIMIT = np.radians(30.0)
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


def tilts(robot, path, start):
    """Return how far [rad] what points up at the start leans from that, along the path."""
    cup = robot.tip_pose(start).rotation.T @ [0.0, 0.0, 1.0]
    return np.array([np.arccos(min(1.0, (robot.tip_pose(q).rotation @ cup)[2])) for q in densely(robot, path)])


def test_simplification_keeps_the_cup_upright_and_other_paths_are_refused(setup, ends):
    spilling = setup.plan(seed=1, time=8.0).path
    assert tilts(setup.robot, spilling, ends[0]).max() > LIMIT
    assert setup.is_free(spilling)
    setup.setToolConstraint(angle=LIMIT)
    refused = setup.is_free(spilling)
    assert not refused
    assert "'tool orientation' and 'its limit'" in refused.why
    result = setup.plan(seed=1, time=8.0, simplify=True)
    assert not np.array_equal(result.path, result.planned_path)
    assert tilts(setup.robot, result.path, ends[0]).max() <= LIMIT
    setup.setToolConstraint()
    assert tool_limit(setup, ToolOrientation) is None
    assert setup.is_free(spilling)


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


def test_a_start_that_spills(setup, ends):
    setup.setToolConstraint(angle=LIMIT)
    before = tool_limit(setup, ToolOrientation)
    with pytest.raises(CollisionError, match=r"start: the tool is 180° from its direction, 30° are allowed"):
        setup.setToolConstraint([0.0, 0.0, 1.0], [0.0, 0.0, 1.0], LIMIT)
    assert tool_limit(setup, ToolOrientation) is before, "what was refused is not set"
    assert setup.plan(seed=1, time=8.0)
    tilted = inverse_kinematics(setup.robot, SIDES[1], pin.rpy.rpyToMatrix(0.6, 0, 0) @ DOWN)
    with pytest.raises(CollisionError, match=r"goal: the tool is 34\.38° from its direction"):
        setup.setConfigurations(ends[0], tilted)


def test_the_axis_of_the_start_needs_a_start(ur5, scene):
    with pytest.raises(InputError, match="set a start before, or give the axis"):
        SafeSetup(ur5, scene).setToolConstraint(angle=LIMIT)
    with pytest.raises(InputError, match="give the angle"):
        SafeSetup(ur5, scene).setToolConstraint([0.0, 0.0, 1.0])


def test_a_start_outside_of_the_box(setup):
    low, high = [-1.0, -1.0, 0.3], [1.0, 1.0, 0.55]
    setup.setTipBounds(low, high)
    assert tool_limit(setup, TipBounds).upper.tolist() == high
    with pytest.raises(CollisionError, match=r"start: the tip is 99\.\d+ mm outside of its bounds"):
        setup.setTipBounds(low, [1.0, 1.0, 0.3001])
    with pytest.raises(InputError, match="give both corners"):
        setup.setTipBounds(low)
    setup.setTipBounds(None)
    assert tool_limit(setup, TipBounds) is None


# ----------------------------------------------------------------------------------- scenarios and command line


@pytest.fixture
def scenario(scene, ends):
    start, goal = (tuple(q.tolist()) for q in ends)
    return Scenario("cup", RobotSpec("ur5"), scene, start, Goal((goal,)))


def test_scenarios_keep_tools_upright_and_have_regions(scenario, tmp_path):
    limits = PathLimits(tool=ToolConstraint(LIMIT, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)), tip=TipBox(z=(0.2, 0.9)))
    region = GoalRegion(Pose(SIDES[1]), x=(-0.05, 0.05), yaw=(0.0, 1.0))
    for goal in (Goal(region=region), Goal(scenario.goal.configurations, region=region, tolerance=0.004)):
        dataclasses.replace(scenario, goal=goal, limits=limits).save(tmp_path / "cup.yaml")
        again = Scenario.load(tmp_path / "cup.yaml")
        assert (again.goal, again.limits) == (goal, limits)
        setup = setup_scenario(again)
        assert tool_limit(setup, ToolOrientation).limit == LIMIT
        assert tool_limit(setup, TipBounds).lower.tolist() == [-np.inf, -np.inf, 0.2]
    claims = setup.plan(seed=1, time=8.0).report.validation.claims
    assert claims == ("collision", "tool orientation", "tip position")


def test_upright_on_the_command_line(scenario, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    scenario.save("cup.yaml")
    assert main(["plan", "cup.yaml", "--seed", "1", "--keep-upright", "30", "--json", "result.json"]) == 0
    result = json.loads(Path("result.json").read_text())
    start = np.array(scenario.start)
    assert tilts(setup_scenario(scenario).robot, np.array(result["path"]), start).max() <= LIMIT
    assert "tool orientation" in result["validation"]["claims"]
    capfd.readouterr()
    assert main(["plan", "cup.yaml", "--keep-upright", "270"]) == 2
    assert "must be an angle in (0, 180] degrees, not '270'" in capfd.readouterr().err
