"""Save and load results, paths and scenes in one JSON format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from safe_ompl.common import Counts, InputError, documents as document, files, finite_array
from safe_ompl.io.motion_files import motion_content, motion_of_document, read_motion
from safe_ompl.io.motions import MotionRecord
from safe_ompl.io.problems import EmbeddedProblem, built_scene, embedded_scene
from safe_ompl.io.schema import kind_of, strict_json, with_header
from safe_ompl.motions import Motion, Trajectory
from safe_ompl.planning import Improvement, PlanResult
from safe_ompl.planning.simplification import ClearanceReport, DangerReport, PathReport
from safe_ompl.robot import PackageDir, Robot, read_package_dir
from safe_ompl.scene import Scene
from safe_ompl.tasks import ProgramResult


def result_to_mapping(result: PlanResult, meshes: bool | None = None) -> dict[str, Any]:
    """Convert a result to plain data, including its robot, scene and danger if it has them; `meshes` as in `save`."""
    about = None
    if result.robot is not None and result.scene is not None:
        about = EmbeddedProblem(result.robot, result.scene, result.danger).to_mapping(meshes)
    return {**result.as_dict(), "problem": about}


def result_from_mapping(
    data: Mapping[str, Any], robot: Robot | None = None, package_dirs: Sequence[PackageDir] = ()
) -> PlanResult:
    """Read the result that `result_to_mapping` wrote. Parameters and errors are those of `load`."""
    names = tuple(document.sequence("joint_names", document.require(data, "joint_names")))
    path = document.require(data, "path")
    planned = data.get("planned_path")
    about = data.get("problem")
    scene = danger = None
    if about is not None:
        robot, scene, danger = EmbeddedProblem.from_mapping(about, robot, package_dirs)
    return PlanResult(
        status=document.text("status", document.require(data, "status")),
        path=None if path is None else finite_array(path, (None, len(names)), "path"),
        report=None if data.get("clearance") is None else _report(data),
        planner=document.text("planner", document.require(data, "planner")),
        seed=int(document.require(data, "seed")),
        joint_names=names,
        planning_time=document.number("planning_time", document.require(data, "planning_time")),
        simplification_time=document.number("simplification_time", data.get("simplification_time", 0.0)),
        counts=Counts(**document.mapping("counts", data.get("counts") or {})),
        setup_time=document.number("setup_time", data.get("setup_time", 0.0)),
        validation_time=document.number("report_time", data.get("report_time", 0.0)),  # all reporting
        improvements=tuple(Improvement(item["time"], item["cost"]) for item in data.get("improvements", ())),
        ways=tuple(document.number("ways", cost) for cost in document.sequence("ways", data.get("ways", ()))),
        repaired=document.text("repaired", data["repaired"]) if "repaired" in data else "",
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
        # JSON has no infinity. A scene without obstacles has an infinite clearance, which the file stores as null.
        clearance[key] = np.inf if clearance[key] is None else clearance[key]
    certified = bool(document.require(data, "certified"))
    return PathReport(float(data["length"]), danger, ClearanceReport(**clearance), certified)


Saveable: TypeAlias = PlanResult | ProgramResult | Scene | Motion | Trajectory
Loaded: TypeAlias = PlanResult | Scene | Motion | MotionRecord


def save(thing: Saveable, file: str | Path, *, meshes: bool | None = None) -> None:
    """Write a result, a motion, a trajectory or a scene to a file that `load` reads back.

    The file extension selects the format. JSON is read back without loss; of a program or a trajectory, `load` reads
    the motion. The JSON of a result contains its robot and scene, the JSON of a scene its meshes and point clouds. All
    other formats hold way points, with times and derivatives if the motion has them: a table (.csv, .tsv, .txt), arrays
    (.npz), or a message trajectory_msgs/JointTrajectory (.yaml).

    Parameters
    ----------
    thing : PlanResult, ProgramResult, Scene, Motion or Trajectory
        The object to write.
    file : path-like
        The file.
    meshes : bool, optional
        Whether a result includes the meshes of its robot. By default small meshes are included, unless the robot is an
        example robot.

    Raises
    ------
    InputError
        If `thing` has another type, the extension is unknown, the format cannot represent `thing`, or a file of the
        scene no longer exists.
    """
    if not isinstance(thing, Saveable):
        kinds = "a PlanResult, a ProgramResult, a Scene, a Motion or a Trajectory"
        raise InputError(f"can be {kinds}, not {type(thing).__name__}", "to save")
    content: str | bytes
    if Path(file).suffix.lower() == ".json":
        content = strict_json(_saved(thing, meshes)) + "\n"
    elif isinstance(thing, Scene):
        raise InputError(f"{str(file)!r} must end in .json", "scene")
    else:
        content, _ = motion_content(thing.motion if isinstance(thing, ProgramResult) else Motion.of(thing), file)
    files.write(file, content)


def _saved(thing: Saveable, meshes: bool | None) -> dict[str, Any]:
    if isinstance(thing, PlanResult):
        return with_header("result", result_to_mapping(thing, meshes))
    if isinstance(thing, ProgramResult):
        return with_header("motion", {**thing.as_dict(), **thing.motion.to_mapping()})
    if isinstance(thing, Scene):
        return with_header("scene", {"scene": embedded_scene(thing)})
    if isinstance(thing, Motion):
        return with_header("motion", thing.to_mapping())
    return with_header("trajectory", thing.as_dict())


def load(file: str | Path, *, robot: Robot | None = None, package_dirs: Sequence[str | PackageDir] = ()) -> Loaded:
    """Read a file that `save`, `safe-ompl plan --json` or `--trajectory`, or `Trajectory.to_json` wrote.

    Files other than JSON, and trajectories without a scene, are read as motions; see `read_motion`.

    Parameters
    ----------
    file : path-like
        The file.
    robot : Robot, optional
        The robot of a result or trajectory. It is needed if the file does not contain the robot.
    package_dirs : sequence of path-like or NamedPackage
        Folders with the packages or meshes that the URDF of the robot names, or named packages. They are needed if the
        file does not contain the meshes.

    Raises
    ------
    InputError, CertificateError
        If the file has another format or version, or its content cannot be built. The message names the file.
    """
    if Path(file).suffix.lower() != ".json":
        return read_motion(file)
    folders = [read_package_dir("package_dirs", entry) for entry in package_dirs]
    with files.reading_json(file) as content:
        if isinstance(content, Mapping) and "format" not in content:
            return motion_of_document(content)
        kind = kind_of(content)
        if kind == "result":
            return result_from_mapping(content, robot, folders)
        if kind == "trajectory" and "problem" in content:
            return MotionRecord.from_mapping(content, robot, folders)
        if kind in ("path", "motion", "trajectory"):
            return motion_of_document(content)
        return built_scene(document.mapping("scene", document.require(content, "scene")))
