"""A robot's blueprint as plain data, with the texts of the files that it names.

A recipe has the keys of a robot in a scenario file, one level for each thing that was done to the robot, the last
outermost: `urdf` (with tip, limits and so on), `base`, `mobile_base` or `attached` with the recipe that they are `of`,
or the recipes of several `robots`. Files of example-robot-data are named, other texts and the meshes of attached
objects travel whole; the meshes of a URDF do not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import singledispatch
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from safe_ompl import document
from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.paths.certificate.carried_files import encoded, unpack
from safe_ompl.robot.construction.attachment import Attachment
from safe_ompl.robot.construction.blueprint import (
    Attached,
    Blueprint,
    Combined,
    OnBase,
    OnMobileBase,
    WithAccelerations,
    check_prefixes,
    mobile_ranges,
)
from safe_ompl.robot.construction.sources import UrdfBlueprint
from safe_ompl.robot.description.examples import robots_folder
from safe_ompl.scene.pose import Pose

_FILES = ("urdf", "srdf")
_OF_THE_MACHINE = (*_FILES, "package_dirs")


class NotPlainError(InputError):
    """A robot is not built from files, so that no plain data says how."""


# ---------------------------------------------------------------------------------------------------- writing


@singledispatch
def recipe(blueprint: Blueprint) -> dict[str, Any]:
    """Return what `RecipeReader.blueprint` reads.

    Raises
    ------
    NotPlainError
        If the robot, or a part of it, is made of Pinocchio's models.
    InputError
        If a file cannot be read.
    """
    raise NotPlainError(f"a {type(blueprint).__name__} is not plain data")


@recipe.register
def _(blueprint: UrdfBlueprint) -> dict[str, Any]:
    names = [item.name for item in fields(blueprint) if item.name not in _OF_THE_MACHINE]
    options = {name: _plain(getattr(blueprint, name)) for name in names}
    return {key: _carried_text(getattr(blueprint, key)) for key in _FILES} | options


@recipe.register
def _(blueprint: OnBase) -> dict[str, Any]:
    return {"base": blueprint.pose.to_mapping(), "of": recipe(blueprint.of)}


@recipe.register
def _(blueprint: OnMobileBase) -> dict[str, Any]:
    return {"mobile_base": _plain(blueprint.ranges), "of": recipe(blueprint.of)}


@recipe.register
def _(blueprint: Attached) -> dict[str, Any]:
    item = blueprint.attachment.to_mapping(None)
    shape, files = item[blueprint.attachment.shape.kind], {}
    if "file" in shape:
        path = Path(shape["file"])
        shape["file"] = f"object{path.suffix}"
        files[shape["file"]] = encoded(path)
    return {"attached": _plain(item), "files": files, "of": recipe(blueprint.of)}


@recipe.register
def _(blueprint: WithAccelerations) -> dict[str, Any]:
    return recipe(blueprint.of)  # a certificate of a timed motion claims its limits itself


@recipe.register
def _(blueprint: Combined) -> dict[str, Any]:
    robots = {prefix: recipe(robot) for prefix, robot in blueprint.robots.items()}
    return {"robots": robots, "name": blueprint.name, "tip": blueprint.tip}


def _plain(value: Any) -> Any:
    """Return a value as JSON has it: lists for tuples, Python's numbers for NumPy's."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if value is None or isinstance(value, (str, bool)):
        return value
    if isinstance(value, Real):
        return int(value) if isinstance(value, Integral) else float(value)
    raise NotPlainError(f"{value!r} is not plain data")


def _carried_text(name: str | None) -> dict[str, str] | None:
    if name is None:
        return None
    path, examples = Path(name), examples_folder()
    if examples is not None and path.is_relative_to(examples):
        return {"example_robot_data": path.relative_to(examples).as_posix()}
    try:
        return {"name": path.name, "text": path.read_text(encoding="utf-8")}
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be carried in a certificate ({error})", name) from None


# ---------------------------------------------------------------------------------------------------- reading


@dataclass
class RecipeReader:
    """Turns recipes into blueprints.

    Parameters
    ----------
    folder : Path
        Empty folder for the files that a recipe carries.
    urdf : Path, optional
        A URDF to read instead of the one that is carried; there may only be one then.
    package_dirs : sequence of Path, optional
        Folders that hold the packages that URDFs name.
    """

    folder: Path
    urdf: Path | None = None
    package_dirs: Sequence[Path] = ()
    _folders: int = field(default=0, init=False)
    _urdfs: int = field(default=0, init=False)

    def blueprint(self, content: Any, place: str = "recipe") -> Blueprint:
        """Return the blueprint of a recipe.

        Raises
        ------
        InputError
            If it is not a recipe; the message names the place in it.
        """
        data = document.mapping(place, content)
        readers = {
            "urdf": self._from_files,
            "base": self._on_base,
            "mobile_base": self._on_mobile_base,
            "attached": self._attached,
            "robots": self._cell,
        }
        kind = next((key for key in readers if key in data), None)
        if kind is None:
            raise InputError(f"must have one of the keys {', '.join(readers)}, got {list(data)}", place)
        with document.within(place):
            return readers[kind](data)

    def _from_files(self, data: dict[str, Any]) -> Blueprint:
        files = {key: self._file(key, data.pop(key, None)) for key in _FILES}
        self._urdfs += 1
        if self.urdf is not None and self._urdfs > 1:
            raise InputError("there are several robots: give the folders of their packages instead", "urdf")
        examples = examples_folder()
        folders = [*self.package_dirs, *([] if examples is None else [examples.parents[1]])]
        return UrdfBlueprint(
            str(self.urdf or files["urdf"]),
            None if files["srdf"] is None else str(files["srdf"]),
            tuple(map(str, folders)),
            **data,
        )

    def _on_base(self, data: dict[str, Any]) -> Blueprint:
        document.check_keys(data, ("base", "of"))
        return OnBase(self._of(data), Pose.from_mapping(document.mapping("base", data["base"])))

    def _on_mobile_base(self, data: dict[str, Any]) -> Blueprint:
        document.check_keys(data, ("mobile_base", "of"))
        return OnMobileBase(self._of(data), mobile_ranges(data["mobile_base"]))

    def _attached(self, data: dict[str, Any]) -> Blueprint:
        document.check_keys(data, ("attached", "files", "of"))
        of, folder = self._of(data), self._own_folder()
        files = document.mapping("files", data.get("files", {}))
        unpack(files, folder)
        item = document.mapping("attached", data["attached"])
        with document.within("attached"):
            for key, value in item.items():
                if isinstance(value, dict) and "file" in value and value["file"] not in files:
                    raise InputError(f"the file {value['file']!r} is not carried", f"{key}.file")
            return Attached(of, Attachment.from_mapping(item, folder))

    def _cell(self, data: dict[str, Any]) -> Blueprint:
        document.check_keys(data, ("robots", "name", "tip"))
        robots = document.mapping("robots", data["robots"])
        check_prefixes(robots)
        tip = document.text("tip", document.require(data, "tip"))
        if tip not in robots:
            raise UnknownNameError("robot with the tip", tip, robots)
        blueprints = {prefix: self.blueprint(robot, f"robots.{prefix}") for prefix, robot in robots.items()}
        return Combined(document.text("name", document.require(data, "name")), blueprints, tip)

    def _of(self, data: dict[str, Any]) -> Blueprint:
        return self.blueprint(document.require(data, "of"), "of")

    def _own_folder(self) -> Path:
        self._folders += 1
        folder = self.folder / str(self._folders)
        folder.mkdir()
        return folder

    def _file(self, key: str, carried: Any) -> Path | None:
        """Return a URDF or SRDF where it can be read: in example-robot-data, or written into a folder."""
        if carried is None and key == "srdf":
            return None
        file = document.mapping(key, carried)
        with document.within(key):
            if "example_robot_data" in file:
                return _example(document.text("example_robot_data", file["example_robot_data"]))
            document.check_keys(file, ("name", "text"))
            path = self._own_folder() / f"carried.{key}"
            path.write_text(document.text("text", document.require(file, "text")), encoding="utf-8")
            return path


def _example(name: str) -> Path:
    path = (robots_folder() / name).resolve()
    if not (path.is_relative_to(robots_folder()) and path.is_file()):
        raise InputError(f"{name!r} is not in example-robot-data", "example_robot_data")
    return path


def examples_folder() -> Path | None:
    """Return the folder of the robots of example-robot-data, or None where that is not installed."""
    try:
        return robots_folder()
    except InputError:
        return None
