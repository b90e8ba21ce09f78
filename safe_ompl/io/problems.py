"""The robot, scene and danger that results and motions in time are about, as they travel in files."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from safe_ompl.common import InputError
from safe_ompl.common import documents as document
from safe_ompl.io.meshes import packed_files, packed_size, unpacked_file
from safe_ompl.io.robot_document import built_robot, carried_robot
from safe_ompl.io.scene_document import built_scene, carried_scene
from safe_ompl.robot import Robot
from safe_ompl.robot.loading import Blueprint, UrdfBlueprint, UrdfFile
from safe_ompl.scene import Scene

_log = logging.getLogger(__name__)

SMALL = 8_000_000
"""Bytes of compressed meshes that travel without being asked for."""
_PACKAGE = "carried"  # of the meshes in the URDF that travels


class Problem(NamedTuple):
    """Robot, scene, and the options of the danger field."""

    robot: Robot
    scene: Scene
    danger: Mapping[str, Any] | None

    def to_mapping(self, meshes: bool | None = None) -> dict[str, Any]:
        """Return it as plain data, which `from_mapping` reads; `meshes` as in `packed_robot`."""
        return {
            "robot": packed_robot(self.robot, meshes),
            "scene": carried_scene(self.scene),
            "danger": None if self.danger is None else dict(self.danger),
        }

    @classmethod
    def from_mapping(
        cls, data: object, robot: Robot | None = None, package_dirs: Sequence[Path] = ()
    ) -> Problem:
        """Read it from a document; `robot` is used where it is given, and else built.

        Raises
        ------
        InputError, CertificateError
            If a key is missing or has no meaning, or robot and scene cannot be built.
        """
        with document.within("problem"):
            carried = document.mapping("carried", data)
            if robot is None:
                robot = unpacked_robot(document.require(carried, "robot"), package_dirs)
            with document.within("scene"):
                scene = built_scene(document.require(carried, "scene"))
        return cls(robot, scene, carried.get("danger"))


# -------------------------------------------------------------------------------------- robots with meshes


def packed_robot(robot: Robot, meshes: bool | None = None) -> dict[str, Any]:
    """Return a robot as `carried_robot` does, with the meshes of its URDFs, which `unpacked_robot` builds anywhere.

    Every mesh travels once, compressed; the URDFs name it by the hash of its content. Robots of example-robot-data need
    none.

    Parameters
    ----------
    robot : Robot
        The robot.
    meshes : bool, optional
        Carry all meshes, or none. By default those that collide, and those that are drawn, are carried if they take no
        more than `SMALL` bytes; a warning says if those that collide do not.

    Raises
    ------
    InputError
        If a file cannot be read.
    """
    carried = carried_robot(robot)
    if meshes is False or carried["recipe"] is None:
        return carried
    packed: dict[Path, tuple[str, str]] = {}
    sources = [pair for pair in _sources(robot.blueprint, carried["recipe"]) if "text" in pair[1]]
    for tag in ("collision", "visual"):
        files = {path for urdf, _ in sources for path in urdf.mesh_files(tag).values()}
        added = packed_files(files - packed.keys(), None if meshes else SMALL - packed_size(packed))
        if added is None:
            level = logging.WARNING if tag == "collision" else logging.INFO
            _log.log(
                level, "%s: its %s meshes are too large to be saved with it: --package-dir", robot.name, tag
            )
            break
        packed |= added
    for urdf, text in sources:
        names = {n: p for tag in ("collision", "visual") for n, p in urdf.mesh_files(tag).items()}
        text["text"] = urdf.renamed(
            {n: f"package://{_PACKAGE}/{packed[p][0]}" for n, p in names.items() if p in packed}
        )
    return {**carried, "meshes": dict(packed.values())} if packed else carried


def unpacked_robot(data: object, package_dirs: Sequence[Path] = ()) -> Robot:
    """Return the robot that `packed_robot` or `carried_robot` described.

    Parameters
    ----------
    data : mapping
        What it returned.
    package_dirs : sequence of Path, optional
        Folders that hold the packages, or the meshes, that its URDF names and that do not travel.

    Raises
    ------
    InputError
        If it cannot be built; the message begins with the key "robot".
    """
    with document.within("robot", ": "), TemporaryDirectory(prefix="safe-ompl-") as folder:
        carried = document.mapping("carried", data)
        meshes = document.mapping("meshes", carried.pop("meshes", {}))
        (Path(folder) / _PACKAGE).mkdir()
        for name, packed in meshes.items():
            if Path(name).name != name or name == ".." or "\\" in name:
                raise InputError(f"{name!r} is not the name of a file", "meshes")
            (Path(folder) / _PACKAGE / name).write_bytes(unpacked_file(name, packed))
        robot = built_robot(carried, package_dirs=[*package_dirs, *([Path(folder)] if meshes else [])])
        if meshes:
            robot.visual_model  # noqa: B018  # read now: the folder goes
    return robot


def _sources(blueprint: Blueprint, recipe: Mapping[str, Any]) -> Iterator[tuple[UrdfFile, dict[str, str]]]:
    """Yield every URDF of a robot with the place of its text in the recipe."""
    if isinstance(blueprint, UrdfBlueprint):
        yield UrdfFile(blueprint.urdf, blueprint.package_dirs), recipe["urdf"]
    elif "robots" in recipe:
        for prefix, part in recipe["robots"].items():
            yield from _sources(blueprint.robots[prefix], part)  # type: ignore[attr-defined]
    else:  # accelerations are no part of a recipe
        below = blueprint.of  # type: ignore[attr-defined]
        yield from _sources(below, recipe.get("of", recipe))
