"""What results and motions in time are about, as it travels: the scene, the robot with its meshes, the danger."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from safe_ompl.common import CertificateError, InputError, Section, key
from safe_ompl.common import documents as document
from safe_ompl.io.carried_files import carried_files, carried_objects, check_carried, unpack
from safe_ompl.io.robot_document import built_robot, packed_robot
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene


@dataclass(frozen=True, kw_only=True)
class SceneDocument(Section):
    """A scene as it travels: `hash` of what it holds, its document, its files by name."""

    hash: str = key(document.sha)
    content: Mapping[str, Any] = key(document.plain)
    files: Mapping[str, str] = key(carried_files, factory=dict)

    def check(self) -> None:
        content = document.mapping("content", self.content)
        with document.within("content"):
            check_carried("obstacles", content.get("obstacles", ()), self.files)


def carried_scene(scene: Scene) -> dict[str, Any]:
    """Return the scene as plain data: its document, its files, its hash.

    Raises
    ------
    InputError
        If a file of the scene is gone, or has changed since it was read.
    """
    content = scene.to_mapping()
    carried = {"hash": scene.content_hash(), "content": content, "files": carried_objects(content.get("obstacles", []))}
    try:
        if carried["files"]:
            built_scene(carried)
    except CertificateError:
        raise InputError(
            "a mesh or point file of the scene has changed since it was read: read the scene anew"
        ) from None
    return carried


def built_scene(carried: Any) -> Scene:
    """Return the scene that a document, a mapping or a SceneDocument, carries.

    Raises
    ------
    InputError
        If it is not one.
    CertificateError
        If it is not the scene of its hash.
    """
    carried = document.section("carried", carried, SceneDocument)
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
                with document.within("robot", ": "):
                    robot = built_robot(document.require(carried, "robot"), package_dirs=package_dirs)
            with document.within("scene"):
                scene = built_scene(document.require(carried, "scene"))
        return cls(robot, scene, carried.get("danger"))
