"""Saving and loading results, paths and scenes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

from safe_ompl import document
from safe_ompl.errors import InputError
from safe_ompl.exchange.form import kind_of, marked, read_json, strict_json
from safe_ompl.exchange.joint_path import JointPath
from safe_ompl.exchange.results import result_from_mapping, result_to_mapping
from safe_ompl.exchange.timed_motion import TimedMotion
from safe_ompl.paths.certificate.scene_document import built_scene, carried_scene
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene
from safe_ompl.setup.result import PlanResult

Saveable: TypeAlias = PlanResult | JointPath | Scene
Loaded: TypeAlias = Saveable | TimedMotion


def save(thing: Saveable, file: str | Path, *, meshes: bool | None = None) -> None:
    """Write a result, a path or a scene as JSON that `load` reads back.

    A result carries its robot and its scene; a scene its meshes and points. Numbers are read back exactly.

    Parameters
    ----------
    thing : PlanResult, JointPath or Scene
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
    Path(file).write_text(strict_json(saved(thing, meshes)) + "\n", encoding="utf-8")


def saved(thing: Saveable, meshes: bool | None = None) -> dict[str, Any]:
    """Return what `save` writes."""
    if isinstance(thing, PlanResult):
        return marked("result", result_to_mapping(thing, meshes))
    if isinstance(thing, JointPath):
        return marked("path", thing.to_mapping())
    if isinstance(thing, Scene):
        return marked("scene", {"scene": carried_scene(thing)})
    raise InputError(f"can be a PlanResult, a JointPath or a Scene, not {type(thing).__name__}", "to save")


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
        return built_scene(document.mapping("scene", document.require(content, "scene")))
