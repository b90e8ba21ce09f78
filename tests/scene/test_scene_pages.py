"""The page on scenario files: its examples are read, and it lists every key of the code."""

import re
from dataclasses import fields
from pathlib import Path

import pytest
import yaml

from safe_ompl import GoalRegion, Person, Pose, Scenario, Scene
from safe_ompl.geometry.obstacle import _KEYS, SHAPES
from safe_ompl.scene import Goal, ToolConstraint
from safe_ompl.scene.constraints import MovingObstacles, PathLimits, TipBox

PAGE = (Path(__file__).parents[2] / "docs" / "scenarios.md").read_text(encoding="utf-8")
KINDS = {"goal": Goal, "limits": PathLimits}
ROWS = [line for line in PAGE.splitlines() if line.startswith("| ")]
LISTED = {name for row in ROWS for name in re.findall(r"`(\w+)`", row)}


def blocks(language):
    return re.findall(f"```{language}\n(.*?)```", PAGE, re.DOTALL)


SCENE, *GOALS = blocks("yaml")


@pytest.mark.parametrize("block", GOALS)
def test_the_examples_of_goals_are_read(block):
    (key, given), *others = yaml.safe_load(block).items()
    assert not others
    read = KINDS[key].from_mapping(given)
    assert type(read).from_mapping(read.to_mapping()) == read != PathLimits()


def test_the_example_is_a_scene_with_every_shape_but_the_mesh():
    scene = Scene.from_yaml(SCENE)
    assert {obstacle.shape.kind for obstacle in scene} == set(SHAPES) - {"mesh"}
    assert scene.spacing == 0.05
    assert Scene.from_yaml(scene.to_yaml()) == scene


def test_the_python_example_runs():
    names: dict = {}
    exec(blocks("python")[0], names)
    assert names["scene"].names == ("table", "colleague")
    assert names["scene"]["colleague"].shape == Person(1.7)


@pytest.mark.parametrize(
    "kind",
    [Scenario, Pose, Scene, Goal, GoalRegion, ToolConstraint, TipBox, MovingObstacles, PathLimits],
    ids=lambda kind: kind.__name__,
)
def test_every_key_is_listed(kind):
    assert {field.name for field in fields(kind) if field.init and field.name != "file"} <= LISTED


def test_every_key_of_an_obstacle_is_listed():
    assert set(_KEYS) <= LISTED
