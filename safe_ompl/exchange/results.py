"""Planning results as documents, with the robot and the scene that they are about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl import document
from safe_ompl.arrays import finite_array
from safe_ompl.counts import Counts
from safe_ompl.exchange.problems import Problem
from safe_ompl.paths.measures import ClearanceReport, DangerReport
from safe_ompl.paths.report import PathReport
from safe_ompl.robot.robot import Robot
from safe_ompl.setup.optimise import Improvement
from safe_ompl.setup.result import PlanResult


def result_to_mapping(result: PlanResult, meshes: bool | None = None) -> dict[str, Any]:
    """Return a result as plain data, with its robot, scene and danger where it has them; `meshes` as in `save`."""
    about = None
    if result.robot is not None and result.scene is not None:
        about = Problem(result.robot, result.scene, result.danger).to_mapping(meshes)
    return {**result.as_dict(), "problem": about}


def result_from_mapping(
    data: Mapping[str, Any], robot: Robot | None = None, package_dirs: Sequence[Path] = ()
) -> PlanResult:
    """Return the result that `result_to_mapping` wrote.

    Parameters
    ----------
    data : mapping
        What it wrote.
    robot : Robot, optional
        The robot, where it does not travel (one of `Robot.from_models`).
    package_dirs : sequence of Path, optional
        Folders that hold the packages, or the meshes, that its URDF names and that do not travel.

    Raises
    ------
    InputError, CertificateError
        If a key is missing or has no meaning, or robot and scene cannot be built.
    """
    names = tuple(document.sequence("joint_names", document.require(data, "joint_names")))
    path = document.require(data, "path")
    planned = data.get("planned_path")
    about = data.get("problem")
    scene = danger = None
    if about is not None:
        robot, scene, danger = Problem.from_mapping(about, robot, package_dirs)
    return PlanResult(
        status=document.text("status", document.require(data, "status")),
        path=None if path is None else finite_array(path, (None, len(names)), "path"),
        report=None if path is None else _report(data),
        planner=document.text("planner", document.require(data, "planner")),
        seed=int(document.require(data, "seed")),
        joint_names=names,
        planning_time=document.number("planning_time", document.require(data, "planning_time")),
        simplification_time=document.number("simplification_time", data.get("simplification_time", 0.0)),
        counts=Counts(**document.mapping("counts", data.get("counts") or {})),
        setup_time=document.number("setup_time", data.get("setup_time", 0.0)),
        validation_time=document.number(
            "report_time", data.get("report_time", 0.0)
        ),  # all that reporting took
        improvements=tuple(Improvement(**item) for item in data.get("improvements", ())),
        interrupted=bool(data.get("interrupted", False)),
        moving_obstacles=data.get("moving_obstacles"),
        planned_path=None if planned is None else finite_array(planned, (None, len(names)), "planned_path"),
        robot=robot,
        scene=scene,
        danger=danger,
    )


def _report(data: Mapping[str, Any]) -> PathReport:
    danger, clearance = data["danger"], dict(document.require(data, "clearance"))
    if danger is not None:
        danger = DangerReport(**{**danger, "profile": np.array(danger["profile"], dtype=float)})
    for key in ("min", "mean"):
        clearance[key] = np.inf if clearance[key] is None else clearance[key]  # where there is no obstacle
    certified = bool(document.require(data, "certified"))
    return PathReport(float(data["length"]), danger, ClearanceReport(**clearance), certified)
