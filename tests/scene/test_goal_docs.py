"""The page on goals: its examples are read, and every key of the code stands in it."""

import re
from dataclasses import fields
from pathlib import Path

import pytest
import yaml

from safe_ompl import GoalRegion
from safe_ompl.scene import ToolConstraint
from safe_ompl.scene.constraints import PathLimits, TipBox
from safe_ompl.scene.scenario import Goal

PAGE = (Path(__file__).parents[2] / "docs" / "goals.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("block", BLOCKS)
def test_the_examples_are_read(block):
    (key, given), *others = yaml.safe_load(block).items()
    assert not others
    read = {"goal": Goal, "limits": PathLimits}[key].from_mapping(given)
    again = type(read).from_mapping(read.to_mapping())
    assert again == read
    assert read != PathLimits()


@pytest.mark.parametrize("kind", [Goal, GoalRegion, ToolConstraint, TipBox])
def test_every_key_is_listed(kind):
    rows = [line for line in PAGE.splitlines() if line.startswith("| ")]
    listed = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    assert {field.name for field in fields(kind)} <= listed


def test_the_usual_tolerances_are_those_of_the_code():
    assert f"{Goal(position=(0.0, 0.0, 0.0)).tolerance:g} for a place" in PAGE
    assert f"{Goal(region=GoalRegion()).tolerance:g} for a region" in PAGE
