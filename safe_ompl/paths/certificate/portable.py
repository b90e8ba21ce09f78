"""Robot and scene as a certificate carries them, so that it can be verified anywhere.

The scene travels whole: mesh and point files byte by byte. Of a robot travels what builds it: the texts of URDF and
SRDF, or where example-robot-data has them, the choice of tip, joints and limits, its base, the objects that it holds
and the robots beside it. The meshes of a URDF do not travel; but the hash of the robot covers them, so that no other
one passes for it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from safe_ompl import document
from safe_ompl.errors import CertificateError, InputError
from safe_ompl.paths.certificate.carried_files import encoded, unpack
from safe_ompl.paths.certificate.recipe import NotPlainError, RecipeReader, recipe
from safe_ompl.robot.construction.blueprint import Blueprint
from safe_ompl.robot.fingerprint import robot_hash
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

_SCENE_KEYS = ("hash", "content", "files")
_ROBOT_KEYS = ("name", "hash", "links_without_collision", "recipe")


# ------------------------------------------------------------------------------------------------------ scene


def carried_scene(scene: Scene) -> dict[str, Any]:
    """Return the scene as plain data: its document, its files in base 64, its hash.

    Raises
    ------
    InputError
        If a file of the scene is gone, or has changed since it was read.
    """
    content = scene.to_mapping(None)
    files: dict[str, str] = {}
    for obstacle in content["obstacles"]:
        for key, value in obstacle.items():
            if isinstance(value, dict) and "file" in value:
                path = Path(value["file"])
                name = f"{len(files)}{path.suffix}"
                files[name] = encoded(path)
                obstacle[key] = {**value, "file": name}
    carried = {"hash": scene.content_hash(), "content": content, "files": files}
    try:
        if files:
            built_scene(carried)
    except CertificateError:
        raise InputError(
            "a mesh or point file of the scene has changed since it was read: read the scene anew"
        ) from None
    return carried


def built_scene(carried: Mapping[str, Any]) -> Scene:
    """Return the scene that a certificate carries.

    Raises
    ------
    InputError
        If it is not one.
    CertificateError
        If it is not the scene of the certificate's hash.
    """
    document.check_keys(carried, _SCENE_KEYS)
    content = document.mapping("content", document.require(carried, "content"))
    files = document.mapping("files", document.require(carried, "files"))
    for key, value in _file_names(content):
        if value not in files:
            raise InputError(f"the file {value!r} is not carried", key)
    with TemporaryDirectory(prefix="safe-ompl-") as folder:
        unpack(files, Path(folder))
        scene = Scene.from_mapping(content, Path(folder))
    if scene.content_hash() != document.require(carried, "hash"):
        raise CertificateError("the scene that it carries is not the one that it was written for")
    return scene


def _file_names(content: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for k, item in enumerate(document.sequence("obstacles", content.get("obstacles", ()))):
        for key, value in document.mapping(f"obstacles[{k}]", item).items():
            if isinstance(value, dict) and "file" in value:
                yield f"obstacles[{k}].{key}.file", value["file"]


# ------------------------------------------------------------------------------------------------------ robot


def carried_robot(robot: Robot) -> dict[str, Any]:
    """Return the robot as plain data: its hash, what its links lack, and what builds it.

    The recipe is None where it is not plain data: then whoever verifies gives the robot.
    """
    return {
        "name": robot.name,
        "hash": robot_hash(robot),
        "links_without_collision": links_without_collision(robot),
        "recipe": _recipe(robot),
    }


def links_without_collision(robot: Robot) -> list[str]:
    """Return the moving links that nothing is proven of, as they have visual but no collision shapes; in order."""
    return sorted(robot.links_without_collision)


def built_robot(
    carried: Mapping[str, Any], *, urdf: Path | None = None, package_dirs: Sequence[Path] = ()
) -> Robot:
    """Return the robot that a certificate carries the recipe of.

    Parameters
    ----------
    carried : mapping
        What `carried_robot` returned.
    urdf : Path, optional
        The URDF to read instead of the text that is carried; meshes are searched beside it.
    package_dirs : sequence of Path, optional
        Folders that hold the packages that the URDF names.

    Raises
    ------
    InputError
        If there is no recipe, it cannot be used, or a mesh is not found. Whether it is the robot of the
        certificate's hash is for the verification to say.
    """
    document.check_keys(carried, _ROBOT_KEYS)
    name, content = carried.get("name"), document.require(carried, "recipe")
    if content is None:
        raise InputError(
            f"it carries no recipe of its robot {name!r}: give the scenario, or the robot in Python"
        )
    given = urdf is not None or bool(package_dirs)
    with TemporaryDirectory(prefix="safe-ompl-") as folder:
        try:
            blueprint = RecipeReader(Path(folder), urdf, package_dirs).blueprint(content)
            return _built(blueprint, name, folder, given)
        except (AttributeError, LookupError, OverflowError, RecursionError, TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            line = str(error).partition("\n")[0]
            raise InputError(f"not a recipe of a robot: {line}", "recipe") from None


def _built(blueprint: Blueprint, name: Any, folder: str, given: bool) -> Robot:
    """Build a robot; if that fails say what may be missing, unless it was given."""
    try:
        return Robot(blueprint)
    except InputError as error:
        if given:
            raise
        raise InputError(
            f"the robot {name!r} cannot be built from what is carried; meshes are not: give its URDF, or the "
            f"folder above its packages ({re.sub(re.escape(folder) + r'/([0-9]+/)?', '', str(error))})"
        ) from None


def _recipe(robot: Robot) -> dict[str, Any] | None:
    try:
        return recipe(robot.blueprint)
    except NotPlainError:
        return None
