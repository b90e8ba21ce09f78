"""Scenes, configurations and limits that the benches share."""

from __future__ import annotations

import tempfile
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from safe_ompl import Box, Capsule, CollisionChecker, Cylinder, Obstacle, PointCloud, Pose, Robot, Scene, Sphere
from safe_ompl.common import FloatArray
from safe_ompl.geometry import Shape
from safe_ompl.robot.spec import robots_folder

ACCELERATIONS: dict[str, tuple[float, ...] | float] = {  # [rad/s²], as Franka publishes them, and of a UR5
    "panda": (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
    "ur5": 8.0,
}


def free_configuration(checker: CollisionChecker, rng: np.random.Generator) -> FloatArray:
    """Return a random configuration (n,) that is free."""
    robot = checker.robot
    while True:
        q: FloatArray = rng.uniform(robot.lower, robot.upper)
        if not checker.in_collision(q):
            return q


def scattered(number: int, seed: int = 0, room: float = 0.3) -> Scene:
    """Return boxes, balls, cylinders and capsules at random places within an arm's reach, off the robot's base.

    Parameters
    ----------
    number : int
        How many.
    seed : int
        Another one gives another scene.
    room : float
        Distance from the base's axis that stays empty [m].
    """
    rng = np.random.default_rng(seed)
    obstacles = []
    while len(obstacles) < number:
        place = rng.uniform([-0.8, -0.8, 0.0], [0.8, 0.8, 1.0])
        if np.hypot(*place[:2]) > room:
            turn = Pose.from_rpy(tuple(place), tuple(rng.uniform(-np.pi, np.pi, 3)))
            obstacles.append(Obstacle(f"obstacle {len(obstacles)}", _shape(rng, len(obstacles)), turn))
    return Scene(tuple(obstacles))


def tiled(number: int) -> Scene:
    """Return a table and a low wall before the robot, cut into about so many tiles: the same solids whatever number."""
    k = max(1, round(np.sqrt(number / 2)))
    across, up = 1.0 / k, 0.4 / k
    obstacles = []
    for row in range(k):
        for column in range(k):
            y, name = -0.5 + (column + 0.5) * across, f"{row}, {column}"
            wall = Pose((0.45, y, 0.05 + (row + 0.5) * up))
            obstacles.append(Obstacle(f"wall {name}", Box((0.02, across, up)), wall))
            table = Pose((0.5 + (row + 0.5) * 0.5 / k, y, 0.0))
            obstacles.append(Obstacle(f"table {name}", Box((0.5 / k, across, 0.02)), table))
    return Scene(tuple(obstacles))


def _shape(rng: np.random.Generator, k: int) -> Shape:
    a, b, c = rng.uniform(0.05, 0.25, 3).tolist()
    return (Box((a, b, c)), Sphere(a / 2), Cylinder(a / 2, 2 * b), Capsule(a / 2, b))[k % 4]


def pillar_of_points() -> Scene:
    """Return points of a pillar in front of a robot, as a camera sees them."""
    rng = np.random.default_rng(0)
    angles, heights = rng.uniform(0.0, 2.0 * np.pi, 400), rng.uniform(0.0, 0.9, 400)
    points = np.column_stack([0.5 + 0.08 * np.cos(angles), 0.08 * np.sin(angles), heights])
    return Scene([Obstacle("pillar", PointCloud(0.01, points=points))])


def bookshelf() -> Scene:
    """Return a shelf of four compartments in front of the robot, with things in it, on a floor with a table."""
    front, depth, width, thick = 0.55, 0.3, 0.9, 0.02
    middle = front + depth / 2
    boards = [
        Obstacle(f"board {k}", Box((depth, width, thick)), Pose((middle, 0.0, z)))
        for k, z in enumerate((0.1, 0.5, 0.9))
    ]
    sides = [
        Obstacle(f"side {k}", Box((depth, thick, 1.0)), Pose((middle, y, 0.5)))
        for k, y in enumerate((-width / 2, 0.0, width / 2))
    ]
    things = [
        Obstacle("can", Cylinder(0.035, 0.12), Pose((middle, -0.2, 0.17))),
        Obstacle("book", Box((0.15, 0.03, 0.22)), Pose((middle, 0.3, 0.62))),
        Obstacle("ball", Sphere(0.06), Pose((middle, -0.3, 0.57))),
        Obstacle("table", Box((0.6, 1.2, 0.04)), Pose((-0.6, 0.0, 0.2))),
        Obstacle("floor", Box((3.0, 3.0, 0.02)), Pose((0.0, 0.0, -0.06))),
    ]
    return Scene((*boards, *sides, *things))


def two_arms() -> Robot:
    """Return a Baxter that moves both arms."""
    folder = robots_folder() / "baxter_description"
    tree = ET.parse(folder / "srdf" / "baxter_manipulation.srdf")
    group = ET.SubElement(tree.getroot(), "group", name="arms")
    for side in ("left", "right"):
        for joint in ("s0", "s1", "e0", "e1", "w0", "w1", "w2"):
            ET.SubElement(group, "joint", name=f"{side}_{joint}")
    with tempfile.TemporaryDirectory() as kept:
        tree.write(Path(kept) / "arms.srdf")
        urdf = folder / "urdf" / "baxter.urdf"
        return Robot.from_urdf(urdf, Path(kept) / "arms.srdf", (folder.parents[2],), group="arms")
