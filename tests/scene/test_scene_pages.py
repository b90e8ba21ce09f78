"""The pages on scenes and goals: their examples are read, and every key of the code stands in them."""

import re
from dataclasses import fields
from pathlib import Path

import pytest
import yaml

from safe_ompl import GoalRegion, Person, Pose, Scene
from safe_ompl.geometry.obstacle import _KEYS, SHAPES
from safe_ompl.scene import Goal, ToolConstraint
from safe_ompl.scene.constraints import PathLimits, TipBox

PAGES = {
    name: (Path(__file__).parents[2] / "docs" / f"{name}.md").read_text(encoding="utf-8") for name in ("scene", "goals")
}
KINDS = {"goal": Goal, "limits": PathLimits}


def blocks(page, language):
    return re.findall(f"```{language}\n(.*?)```", PAGES[page], re.DOTALL)


def listed(page):
    """Return what stands as code in the tables of a page."""
    rows = [line for line in PAGES[page].splitlines() if line.startswith("| ")]
    return {name for row in rows for name in re.findall(r"`(\w+)`", row)}


@pytest.mark.parametrize("block", blocks("goals", "yaml"))
def test_the_examples_of_goals_are_read(block):
    (key, given), *others = yaml.safe_load(block).items()
    assert not others
    read = KINDS[key].from_mapping(given)
    assert type(read).from_mapping(read.to_mapping()) == read != PathLimits()


def test_the_example_is_a_scene_with_every_shape_but_the_mesh():
    scene = Scene.from_yaml(blocks("scene", "yaml")[0])
    assert {obstacle.shape.kind for obstacle in scene} == set(SHAPES) - {"mesh"}
    assert scene.spacing == 0.05
    assert Scene.from_yaml(scene.to_yaml()) == scene


def test_the_python_example_runs():
    names: dict = {}
    exec(blocks("scene", "python")[0], names)
    assert names["scene"].names == ("table", "colleague")
    assert names["scene"]["colleague"].shape == Person(1.7)


@pytest.mark.parametrize(
    ("page", "kind"),
    [("scene", Pose), ("scene", Scene), *(("goals", k) for k in (Goal, GoalRegion, ToolConstraint, TipBox))],
)
def test_every_key_is_listed(page, kind):
    assert {field.name for field in fields(kind)} <= listed(page)
    assert set(_KEYS) <= listed("scene")
