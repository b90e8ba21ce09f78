"""The page on scenes: its examples are read, and every key of the code stands in it."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest

from safe_ompl import Person, Pose, Scene
from safe_ompl.geometry import LIMBS, STANDING
from safe_ompl.geometry.obstacle import _KEYS, SHAPES

PAGE = (Path(__file__).parents[2] / "docs" / "scene.md").read_text(encoding="utf-8")


def block(language):
    return re.search(f"```{language}\n(.*?)```", PAGE, re.DOTALL)[1]


def rows():
    """Return the cells of all tables."""
    lines = [line for line in PAGE.splitlines() if line.startswith("| ") and "---" not in line]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_the_example_is_a_scene_with_every_shape_but_the_mesh():
    scene = Scene.from_yaml(block("yaml"))
    assert {obstacle.shape.kind for obstacle in scene} == set(SHAPES) - {"mesh"}
    assert scene.spacing == 0.05
    assert Scene.from_yaml(scene.to_yaml()) == scene


def test_the_python_example_runs():
    names: dict = {}
    exec(block("python"), names)
    assert names["scene"].names == ("table", "colleague")
    assert names["scene"]["colleague"].shape == Person(1.7)


def test_every_key_of_an_obstacle_stands_there():
    listed = {key for row in rows() for key in re.findall(r"`(\w+)`", row[0])}
    assert {*_KEYS, "spacing", "obstacles"} <= listed
    assert {field.name for field in fields(Pose)} <= listed


@pytest.mark.parametrize("kind", list(SHAPES))
def test_every_key_of_a_shape_stands_there_and_no_other(kind):
    table = PAGE.split("## Shapes")[1]
    current, found = "", set()
    for line in table.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if not line.startswith("|") or len(cells) < 5:
            continue
        current = cells[0].strip("`") or current
        if current == kind:
            found.add(cells[1].strip("`"))
    own = {field.name for field in fields(SHAPES[kind])} | ({"world_keypoints"} if kind == "person" else set())
    assert found == own


def test_every_part_of_a_person_stands_there():
    people = PAGE.split("### People")[1]
    for name in (*STANDING, *LIMBS):
        assert f"`{name.removeprefix('left_').removeprefix('right_')}`" in people
