"""Saving and loading results, paths and scenes, in the JSON form that they share."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from safe_ompl.common import Counts, InputError, UnknownNameError, files, finite_array
from safe_ompl.common import documents as document
from safe_ompl.io import schema
from safe_ompl.io.motions import JointPath, TimedMotion
from safe_ompl.io.problems import Problem, built_scene, carried_scene
from safe_ompl.motions import Motion
from safe_ompl.paths import ClearanceReport, DangerReport, PathReport
from safe_ompl.planning import Improvement, PlanResult
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

FORMAT, VERSION = "safe-ompl", 1
KINDS = ("result", "path", "scene", "trajectory", "motion")


def marked(kind: str, content: Mapping[str, Any]) -> dict[str, Any]:
    """Return content with the marks of the form before it."""
    return {"format": FORMAT, "version": VERSION, "kind": kind, **content}


def strict_json(data: Any) -> str:
    """Return data as one line of strict JSON: what is not finite becomes null."""
    return json.dumps(_without_nan(data), allow_nan=False)


def read_json(file: str | Path) -> Any:
    """Return what a JSON file holds, or raise InputError."""
    try:
        return json.loads(Path(file).read_text(encoding="utf-8"))
    except (OSError, RecursionError, ValueError) as error:
        raise InputError(f"cannot be read as JSON: {error}", str(file)) from None


def kind_of(content: Any) -> str:
    """Return what kind of thing content of the form holds; raise InputError if it has another form or version."""
    schema.check_form(content, FORMAT, VERSION)
    kind = document.text("kind", document.require(content, "kind"))
    if kind not in KINDS:
        raise UnknownNameError("kind of file", kind, KINDS)
    return kind


def _without_nan(data: Any) -> Any:
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, Mapping):
        return {key: _without_nan(value) for key, value in data.items()}
    if isinstance(data, (list, tuple)):
        return [_without_nan(item) for item in data]
    return data


def result_to_mapping(result: PlanResult, meshes: bool | None = None) -> dict[str, Any]:
    """Return a result as plain data, with its robot, scene and danger where it has them; `meshes` as in `save`."""
    about = None
    if result.robot is not None and result.scene is not None:
        about = Problem(result.robot, result.scene, result.danger).to_mapping(meshes)
    return {**result.as_dict(), "problem": about}


def result_from_mapping(
    data: Mapping[str, Any], robot: Robot | None = None, package_dirs: Sequence[Path] = ()
) -> PlanResult:
    """Return the result that `result_to_mapping` wrote; parameters and errors as of `load`."""
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


Saveable: TypeAlias = PlanResult | JointPath | Scene | Motion
Loaded: TypeAlias = Saveable | TimedMotion


def save(thing: Saveable, file: str | Path, *, meshes: bool | None = None) -> None:
    """Write a result, a path, a motion or a scene as JSON that `load` reads back.

    A result carries its robot and its scene; a scene its meshes and points. Numbers are read back exactly.

    Parameters
    ----------
    thing : PlanResult, JointPath, Scene or Motion
        What to write.
    file : path-like
        The file.
    meshes : bool, optional
        Whether a result carries the meshes of its robot; default: if they are small, and the robot is no example.

    Raises
    ------
    InputError
        If it is none of these, or a file of the scene is gone.
    """
    files.write(file, strict_json(saved(thing, meshes)) + "\n")


def saved(thing: Saveable, meshes: bool | None = None) -> dict[str, Any]:
    """Return what `save` writes."""
    if isinstance(thing, PlanResult):
        return marked("result", result_to_mapping(thing, meshes))
    if isinstance(thing, JointPath):
        return marked("path", thing.to_mapping())
    if isinstance(thing, Scene):
        return marked("scene", {"scene": carried_scene(thing)})
    if isinstance(thing, Motion):
        return marked("motion", thing.to_mapping())
    raise InputError(
        f"can be a PlanResult, a JointPath, a Scene or a Motion, not {type(thing).__name__}", "to save"
    )


def load(file: str | Path, *, robot: Robot | None = None, package_dirs: Sequence[str | Path] = ()) -> Loaded:
    """Read what `save` wrote, or `safe-ompl plan --json` or `--trajectory`.

    Parameters
    ----------
    file : path-like
        The file.
    robot : Robot, optional
        The robot of a result or trajectory, where it does not travel in it.
    package_dirs : sequence of path-like
        Folders that hold the packages, or the meshes, that the URDF of the robot names, where these do not travel.

    Raises
    ------
    InputError, CertificateError
        If it has another form or version, or cannot be built; names the file.
    """
    content, folders = read_json(file), [Path(folder) for folder in package_dirs]
    with document.within(str(file), ": "):
        kind = kind_of(content)
        if kind == "result":
            return result_from_mapping(content, robot, folders)
        if kind == "trajectory":
            return TimedMotion.from_mapping(content, robot, folders)
        if kind == "path":
            return JointPath.from_mapping(content)
        if kind == "motion":
            return Motion.from_mapping(content)
        return built_scene(document.mapping("scene", document.require(content, "scene")))
