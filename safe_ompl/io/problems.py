"""What results and motions in time are about, as it travels: the scene, the robot with its meshes, the danger."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from safe_ompl.common import CertificateError, InputError
from safe_ompl.common import documents as document
from safe_ompl.io.carried_files import carried_files, encoded, packed_files, packed_size, unpack, unpacked_file
from safe_ompl.io.robot_document import built_robot, carried_robot
from safe_ompl.io.schema import key, plain, record, sha
from safe_ompl.robot import Robot, RobotSpec, UrdfFile
from safe_ompl.scene import Scene


@dataclass(frozen=True, kw_only=True)
class SceneDocument:
    """A scene as it travels: `hash` of what it holds, its document, its files in base 64 by name."""

    hash: str = key(sha)
    content: Mapping[str, Any] = key(lambda name, value: plain(name, document.mapping(name, value)))
    files: Mapping[str, str] = key(carried_files)


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
        for part, value in obstacle.items():
            if isinstance(value, dict) and "file" in value:
                path = Path(value["file"])
                name = f"{len(files)}{path.suffix}"
                files[name] = encoded(path)
                obstacle[part] = {**value, "file": name}
    carried = {"hash": scene.content_hash(), "content": content, "files": files}
    try:
        if files:
            built_scene(carried)
    except CertificateError:
        raise InputError(
            "a mesh or point file of the scene has changed since it was read: read the scene anew"
        ) from None
    return carried


def built_scene(carried: Mapping[str, Any] | SceneDocument) -> Scene:
    """Return the scene that a document carries.

    Raises
    ------
    InputError
        If it is not one.
    CertificateError
        If it is not the scene of its hash.
    """
    if not isinstance(carried, SceneDocument):
        carried = record(SceneDocument)("carried", carried)
    for part, value in _file_names(carried.content):
        if value not in carried.files:
            raise InputError(f"the file {value!r} is not carried", part)
    with TemporaryDirectory(prefix="safe-ompl-") as folder:
        unpack(carried.files, Path(folder))
        try:
            scene = Scene.from_mapping(carried.content, Path(folder))
        except InputError as error:
            raise InputError(str(error).replace(f"{folder}/", "")) from None
        except MemoryError:
            raise InputError("a file asks for more memory than there is", "files") from None
    if scene.content_hash() != carried.hash:
        raise CertificateError("the scene that it carries is not the one that it was written for")
    return scene


def _file_names(content: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for k, item in enumerate(document.sequence("obstacles", content.get("obstacles", ()))):
        for part, value in document.mapping(f"obstacles[{k}]", item).items():
            if isinstance(value, dict) and "file" in value:
                yield f"obstacles[{k}].{part}.file", value["file"]


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
    def from_mapping(cls, data: object, robot: Robot | None = None, package_dirs: Sequence[Path] = ()) -> Problem:
        """Read it from a document; `robot` is used where it is given, and else built. Errors as of `load`."""
        with document.within("problem"):
            carried = document.mapping("carried", data)
            if robot is None:
                robot = unpacked_robot(document.require(carried, "robot"), package_dirs)
            with document.within("scene"):
                scene = built_scene(document.require(carried, "scene"))
        return cls(robot, scene, carried.get("danger"))


def packed_robot(robot: Robot, meshes: bool | None = None) -> dict[str, Any]:
    """Return a robot as `carried_robot` does, with the meshes of its URDFs, which `unpacked_robot` builds anywhere.

    Every mesh travels once, compressed; the URDFs name it by the hash of its content. Robots of example-robot-data need
    none.

    Parameters
    ----------
    meshes : bool, optional
        Carry all meshes, or none. By default those that collide, and those that are drawn, are carried if they take no
        more than `SMALL` bytes; a warning says if those that collide do not.
    """
    carried = carried_robot(robot)
    if meshes is False or carried["recipe"] is None:
        return carried
    packed: dict[Path, tuple[str, str]] = {}
    sources = [pair for pair in _sources(robot.spec, carried["recipe"]) if "text" in pair[1]]
    for tag in ("collision", "visual"):
        files = {path for urdf, _ in sources for path in urdf.mesh_files(tag).values()}
        added = packed_files(files - packed.keys(), None if meshes else SMALL - packed_size(packed))
        if added is None:
            level = logging.WARNING if tag == "collision" else logging.INFO
            _log.log(level, "%s: its %s meshes are too large to be saved with it: --package-dir", robot.name, tag)
            break
        packed |= added
    for urdf, text in sources:
        names = {n: p for tag in ("collision", "visual") for n, p in urdf.mesh_files(tag).items()}
        text["text"] = urdf.text({n: f"package://{_PACKAGE}/{packed[p][0]}" for n, p in names.items() if p in packed})
    return {**carried, "meshes": dict(packed.values())} if packed else carried


def unpacked_robot(data: object, package_dirs: Sequence[Path] = ()) -> Robot:
    """Return the robot that `packed_robot` or `carried_robot` described; errors begin with the key "robot"."""
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


def _sources(spec: RobotSpec, recipe: Mapping[str, Any]) -> Iterator[tuple[UrdfFile, dict[str, str]]]:
    """Yield every URDF of a robot with the place of its text in the recipe."""
    while "of" in recipe:
        recipe = recipe["of"]
    if spec.robots:
        for prefix, part in recipe["robots"].items():
            yield from _sources(spec.robots[prefix], part)
    else:
        yield spec.resolved().urdf_file(), recipe["urdf"]
