"""plainmp: OMPL's RRTConnect and shortcuts in C++, checked at a step size (`resolution`).

It knows robots as spheres only. Its own ones of the Panda are up to 30 mm in contact where these problems end, at
grasps. So it is given balls within the same hulls that all systems check: what it finds may touch, but it is never
refused a motion that is free.
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import yaml
from plainmp.constraint import SphereCollisionCst
from plainmp.ompl_solver import OMPLSolver, OMPLSolverConfig, RefineType, set_random_seed, simplify_path
from plainmp.problem import Problem
from plainmp.psdf import BoxSDF, CylinderSDF, Pose, SphereSDF, UnionSDF
from plainmp.robot_spec import RobotSpec
from plainmp.trajectory import Trajectory
from protocol import Waypoints, serve
from skrobot.coordinates.math import rpy_matrix

GRID = 0.005  # [m]
LEFT_OUT = 0.02  # [m]; points of the grid within a hull are no farther outside its balls
SHAPES = {
    "box": BoxSDF,
    "cylinder": lambda size, pose: CylinderSDF(*size, pose),
    "sphere": lambda size, pose: SphereSDF(*size, pose),
}


class Plainmp:
    """A robot of balls, obstacles as signed distances."""

    def __init__(self, robot: dict[str, Any], options: dict[str, Any]) -> None:
        self._bounds = np.array(robot["lower"]), np.array(robot["upper"])
        self._resolution = np.full(len(robot["joints"]), options["resolution"])
        links = [link for link in ET.parse(robot["urdf"]).getroot().iter("link") if link.find("collision") is not None]
        balls = {
            str(link.get("name")): [row for collision in link.findall("collision") for row in _balls(collision)]
            for link in links
        }
        ignored = {
            frozenset((pair.get("link1"), pair.get("link2")))
            for pair in ET.parse(robot["srdf"]).getroot().iter("disable_collisions")
        }
        description = {
            "urdf_path": robot["urdf"],
            "control_joint_names": robot["joints"],
            "self_collision_pairs": [list(pair) for pair in combinations(balls, 2) if frozenset(pair) not in ignored],
            "only_self_collision_links": [robot["base"]],
            "collision_spheres": {link: {"spheres": rows} for link, rows in balls.items()},
        }
        with TemporaryDirectory() as folder:
            file = Path(folder) / "robot.yaml"
            file.write_text(yaml.safe_dump(description))
            self._spec = RobotSpec(file, use_fixed_spec_id=True)

    def build(self, problem: dict[str, Any]) -> None:
        shapes = [
            SHAPES[item["kind"]](item["size"], Pose(np.array(item["position"]), np.array(item["rotation"])))
            for item in problem["obstacles"]
        ]
        self._collision: SphereCollisionCst = self._spec.create_collision_const()
        self._collision.set_sdf(UnionSDF(shapes))
        self._problem = problem

    def plan(self, seed: int, seconds: float) -> Waypoints | None:
        set_random_seed(seed)
        start, goal = (np.array(self._problem[end]) for end in ("start", "goal"))
        for end in (start, goal):
            if not self._collision.is_valid(end):
                raise ValueError(f"in collision at {end.tolist()}")
        problem = Problem(start, *self._bounds, goal, self._collision, None, self._resolution)
        found = OMPLSolver(OMPLSolverConfig(timeout=seconds)).solve(problem)
        return _rows(found.traj) if found.success else None

    def smooth(self, path: Waypoints) -> Waypoints:
        way, how = Trajectory([np.array(q) for q in path]), [RefineType.SHORTCUT]
        return _rows(simplify_path(way, *self._bounds, self._collision, self._resolution, refine_seq=how))


def _balls(collision: ET.Element) -> list[list[float]]:
    """Return balls within a hull or a box, as centre and radius [m]: the largest first, until its inside is covered."""
    normals, corners = _faces(collision)
    lower, upper = corners.min(axis=0), corners.max(axis=0)
    axes = [np.arange(a + GRID / 2, b, GRID) for a, b in zip(lower, upper, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    depths = np.min((normals * corners).sum(axis=1) - points @ normals.T, axis=1)
    points, depths = points[depths > 0], depths[depths > 0]
    left, rows = np.ones(len(points), dtype=bool), []
    origin = collision.find("origin")
    xyz, rpy = (_numbers(origin, key) if origin is not None else np.zeros(3) for key in ("xyz", "rpy"))
    placed = points @ rpy_matrix(*rpy[::-1]).T + xyz
    while left.any():
        best = np.flatnonzero(left)[depths[left].argmax()]
        rows.append([*placed[best].tolist(), float(depths[best])])
        left &= np.linalg.norm(points - points[best], axis=1) > depths[best] + LEFT_OUT
    return rows


def _faces(collision: ET.Element) -> tuple[np.ndarray, np.ndarray]:
    """Return the outward normals of the faces, and a corner of each [m]; these are all corners' extremes, too."""
    box, mesh = collision.find("geometry/box"), collision.find("geometry/mesh")
    if box is not None:
        half = _numbers(box, "size") / 2
        return np.vstack([np.eye(3), -np.eye(3)]), np.vstack([[half] * 3, [-half] * 3])
    if mesh is None:
        raise ValueError("neither a box nor a mesh")
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = np.frombuffer(Path(mesh.get("filename", "")).read_bytes()[84:], record)["corners"].astype(float)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    some = lengths > 0
    return np.repeat(normals[some] / lengths[some, None], 3, axis=0), triangles[some].reshape(-1, 3)


def _numbers(element: ET.Element, key: str) -> np.ndarray:
    return np.array([float(x) for x in element.get(key, "0 0 0").split()])


def _rows(path: Trajectory) -> Waypoints:
    return np.asarray(path.numpy()).tolist()


serve(Plainmp)
