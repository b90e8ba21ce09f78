"""The examples of the README run as they stand."""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Any

import pytest
from ompl import geometric as og

from safe_ompl.common.errors import UnknownNameError
from safe_ompl.planning.ompl.states import joint_space

README = Path(__file__).parent.parent / "README.md"


@pytest.fixture(scope="module")
def blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture(scope="module")
def names(blocks: list[str]) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(blocks[0], names)
    return names


def test_ten_lines_of_python(names: dict[str, Any]) -> None:
    assert names["result"]
    assert names["result"].report.certified


def test_in_an_existing_script(blocks: list[str], names: dict[str, Any]) -> None:
    setup = og.SimpleSetup(joint_space(names["robot"]))
    exec(blocks[1], {**names, "ss": setup})
    space = setup.getStateSpace()
    start, goal = space.allocState(), space.allocState()
    start[0:7], goal[0:7] = names["result"].path[0].tolist(), names["result"].path[-1].tolist()
    setup.setStartAndGoalStates(start, goal)
    assert setup.solve(10.0)


def test_planners_of_the_readme_exist() -> None:
    from safe_ompl import planner_names

    table = README.read_text(encoding="utf-8").split("## Planners")[1].split("##")[0]
    assert set(re.findall(r"^\| `(\w+)`", table, re.MULTILINE)) <= set(planner_names())


def test_errors_reach_other_processes() -> None:
    error = UnknownNameError("joint", "elbow", ("hip", "knee"), "arm.urdf")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
