"""The neutral judge of all paths: plain Pinocchio and coal on dense samples. It imports nothing of safe_ompl."""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

TOUCHING, CLEARANCE = 0.005, 0.01  # [rad] between samples
NEAR = 0.05  # [m]


@dataclass(frozen=True)
class Verdict:
    """What the samples of a path show.

    Attributes
    ----------
    touching : bool
        Whether a sample touches an obstacle or the robot itself.
    ends : bool
        Whether the path begins at the start, ends at the goal and keeps to the limits, within 1e-4 rad.
    min_clearance, mean_clearance : float
        Distance to the obstacles [m], the mean over arc length.
    near : float
        Length that is nearer than 50 mm [rad].
    mean_danger, peak_danger, integral_danger : float
        The danger field at the worst point of the obstacles, over arc length.
    length : float
        [rad]
    """

    touching: bool
    ends: bool
    min_clearance: float
    mean_clearance: float
    near: float
    mean_danger: float
    peak_danger: float
    integral_danger: float
    length: float


class Judge:
    """Judges the paths of one robot."""

    def __init__(self, robot: dict[str, Any]) -> None:
        self._robot = robot
        self._model = pin.buildModelFromUrdf(robot["urdf"])
        self._bodies = pin.buildGeomFromUrdf(self._model, robot["urdf"], pin.GeometryType.COLLISION)
        for body in self._bodies.geometryObjects:
            if isinstance(body.geometry, coal.BVHModelBase):
                body.geometry.buildConvexRepresentation(False)
                body.geometry = body.geometry.convex
        self._bodies.addAllCollisionPairs()
        pin.removeCollisionPairs(self._model, self._bodies, robot["srdf"])
        self._moving = [k for k, body in enumerate(self._bodies.geometryObjects) if body.parentJoint]
        self._order = [self._model.joints[self._model.getJointId(name)].idx_q for name in robot["joints"]]
        self._joints = [self._model.getJointId(point["joint"]) for point in robot["key_points"]]
        self._offsets = np.array([point["offset"] for point in robot["key_points"]])
        self._segments = np.array(robot["segments"])

    def verdict(self, problem: dict[str, Any], path: np.ndarray) -> Verdict:
        """Return what dense samples of a path (N, n) [rad] show."""
        touching = self._touches(problem, samples(path, TOUCHING))
        Q = samples(path, CLEARANCE)
        steps = np.linalg.norm(np.diff(Q, axis=0), axis=1)
        length = float(steps.sum())

        def mean(values: np.ndarray) -> float:
            return (
                float((steps * (values[1:] + values[:-1]) / 2).sum() / length) if length else float(values[0])
            )

        clearance, danger = self._clearances(problem, Q), self._dangers(problem, Q)
        robot = self._robot
        ends = np.allclose(path[0], problem["start"], atol=1e-4) and np.allclose(
            path[-1], problem["goal"], atol=1e-4
        )
        inside = (path >= np.array(robot["lower"]) - 1e-4).all() and (
            path <= np.array(robot["upper"]) + 1e-4
        ).all()
        return Verdict(
            touching,
            bool(ends and inside),
            float(clearance.min()),
            mean(clearance),
            length * mean((clearance < NEAR).astype(float)),
            mean(danger),
            float(danger.max()),
            length * mean(danger),
            length,
        )

    def ends_touch(self, problem: dict[str, Any]) -> bool:
        """Return whether the robot touches something or itself at the start or the goal: nobody can solve that."""
        return self._touches(problem, np.array([problem["start"], problem["goal"]]))

    def _scene(self, problem: dict[str, Any], own: bool) -> pin.GeometryModel:
        geometry = self._bodies.copy()
        if not own:
            geometry.removeAllCollisionPairs()
        for item in problem["obstacles"]:
            placement = pin.SE3(np.array(item["rotation"]), np.array(item["position"]))
            shape = {"box": coal.Box, "cylinder": coal.Cylinder, "sphere": coal.Sphere}[item["kind"]](
                *item["size"]
            )
            added = geometry.addGeometryObject(pin.GeometryObject(item["name"], 0, placement, shape))
            for body in self._moving:
                geometry.addCollisionPair(pin.CollisionPair(body, added))
        return geometry

    def _full(self, q: np.ndarray) -> np.ndarray:
        full = pin.neutral(self._model)
        full[self._order] = q
        return full

    def _touches(self, problem: dict[str, Any], Q: np.ndarray) -> bool:
        geometry = self._scene(problem, own=True)
        data, contacts = self._model.createData(), pin.GeometryData(geometry)
        return any(
            pin.computeCollisions(self._model, data, geometry, contacts, self._full(q), True) for q in Q
        )

    def _clearances(self, problem: dict[str, Any], Q: np.ndarray) -> np.ndarray:
        geometry = self._scene(problem, own=False)
        data, distances = self._model.createData(), pin.GeometryData(geometry)
        found = []
        for q in Q:
            nearest = pin.computeDistances(self._model, data, geometry, distances, self._full(q))
            found.append(distances.distanceResults[nearest].min_distance)
        return np.array(found)

    def _dangers(self, problem: dict[str, Any], Q: np.ndarray) -> np.ndarray:
        """Return the cumulative danger field (Lacevic & Rocco, eqs. 4, 5) at its worst point, for each of `Q`."""
        points, weights = np.array(problem["danger_points"]), np.array(problem["danger_weights"])
        data, worst = self._model.createData(), []
        for q in Q:
            pin.forwardKinematics(self._model, data, self._full(q))
            key = np.array([data.oMi[j].act(x) for j, x in zip(self._joints, self._offsets, strict=True)])
            a, b = key[self._segments[:, 0]], key[self._segments[:, 1]]
            ell = np.linalg.norm(b - a, axis=1)
            S = np.linalg.norm(points[:, None] - a, axis=2) + np.linalg.norm(points[:, None] - b, axis=2)
            worst.append((weights * (2 / ell * np.arctanh(ell / S)).sum(axis=1)).max())
        return np.array(worst)


def samples(path: np.ndarray, spacing: float) -> np.ndarray:
    """Return configurations along a path (N, n), no farther than a spacing [rad] apart."""
    rows = [path[:1]]
    for start, end in pairwise(path):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / spacing)))
        rows.append(start + np.linspace(0, 1, count + 1)[1:, None] * (end - start))
    return np.concatenate(rows)


def read(path: Path) -> Judge:
    """Return the judge for the robot that a file describes."""
    return Judge(json.loads(path.read_text()))
