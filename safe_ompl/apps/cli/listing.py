"""`safe-ompl scenarios` and `safe-ompl robots`: the scenarios and robots that come with the package."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.table import Table

from safe_ompl.apps.cli.console import output_console
from safe_ompl.apps.cli.tables import plain_table
from safe_ompl.common import InputError
from safe_ompl.robot import frame_index
from safe_ompl.robot.loading import EXAMPLES, ExampleRobot, UrdfFile, robots_folder
from safe_ompl.scene import Scenario, list_scenarios


def add_commands(commands: Any) -> None:
    """Add `scenarios` and `robots` to the commands."""
    for name, table, what in (
        ("scenarios", scenarios_table, "list the scenarios"),
        ("robots", robots_table, "list the example robots"),
    ):
        parser = commands.add_parser(name, help=what, description=f"{what.capitalize()}.")
        parser.set_defaults(prepare=_prepared(table))


def _prepared(table: Callable[[], Table]) -> Callable[[argparse.Namespace], Callable[[], int]]:
    def prepare(options: argparse.Namespace) -> Callable[[], int]:
        return job

    def job() -> int:
        output_console().print(table())
        return 0

    return prepare


def scenarios_table() -> Table:
    """Return the scenarios by name: robot, obstacles, and what happens in them."""
    table = plain_table("scenario", "robot", "obstacles", "description")
    for name, file in list_scenarios().items():
        table.add_row(name, *_scenario_cells(file))
    return table


def _scenario_cells(file: Path) -> tuple[str, str, str]:
    try:
        scenario = Scenario.load(file)
    except InputError as error:
        return "", "", f"cannot be used: {error}"
    robot = scenario.robot.example or (scenario.robot.urdf.stem if scenario.robot.urdf else "")
    return robot, str(len(scenario.scene.obstacles)), " ".join(scenario.description.split())


def robots_table() -> Table:
    """Return the example robots by name: how many joints move, the tip, what is locked, what has no collision shape."""
    table = plain_table("robot", "joints", "tip", "locked", "not checked")
    for name, example in sorted(EXAMPLES.items()):
        locked = ", ".join(f"{joint} = {value:g}" for joint, value in example.locked.items())
        urdf = UrdfFile(robots_folder() / example.urdf)
        moving = str(_moving_joints(urdf, example))
        table.add_row(name, moving, example.tip, locked, ", ".join(_bare_links(urdf)))
    table.caption = "not checked: links that have visual shapes but no collision shapes"
    return table


def _bare_links(urdf: UrdfFile) -> list[str]:
    """Return the moving links that have visual shapes only, in the URDF's order."""
    bare = urdf.links_with_visuals_only()
    return [frame.name for frame in urdf.build_model().frames if frame.name in bare and frame.parentJoint]


def _moving_joints(urdf: UrdfFile, example: ExampleRobot) -> int:
    """Return how many joints move the tip; the meshes, which take long, are not read."""
    model = urdf.build_model()
    chain = model.supports[model.frames[frame_index(model, example.tip)].parentJoint]
    return sum(model.names[joint] not in example.locked for joint in list(chain)[1:])
