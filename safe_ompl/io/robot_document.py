"""The robot as plain data that travels: its hash, what its links lack, and the recipe that builds it.

A recipe has the keys of a robot in a scenario file, one level for each thing that was done to the robot, the last
outermost: `urdf` (with tip, limits and so on), `base`, `mobile_base` or `attached` with the recipe that they are `of`,
or the recipes of several `robots`. Files of example-robot-data are named, other texts and the meshes of attached
objects travel whole; the meshes of a URDF do not. They are looked for in folders that the user names, never where the
recipe says; the hash of the robot covers them, so that no other one passes for it.
"""

# ruff: noqa: RUF009 (fields of records are made by `key`)

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import singledispatch
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, get_args

from safe_ompl.common import InputError, UnknownNameError, formats, shown
from safe_ompl.common import documents as document
from safe_ompl.geometry import Pose
from safe_ompl.io import schema
from safe_ompl.io.carried_files import carried_files, encoded, examples_folder, place_meshes, unpack
from safe_ompl.robot import Robot, robot_hash
from safe_ompl.robot.loading import (
    Attached,
    Attachment,
    Blueprint,
    CollisionSource,
    Combined,
    OnBase,
    OnMobileBase,
    UrdfBlueprint,
    WithAccelerations,
    check_prefixes,
    mobile_ranges,
    robots_folder,
)

_FILES = ("urdf", "srdf")
_OF_THE_MACHINE = (*_FILES, "package_dirs", "xacro_args")
_MOST_CHARACTERS = 20_000_000  # of a URDF or an SRDF
_DEEPEST = 100  # tags in tags, recipes in recipes
_DECLARATION = re.compile(r"<!(DOCTYPE|ENTITY)", re.IGNORECASE)


# ---------------------------------------------------------------------------------------------------- writing


def carried_robot(robot: Robot) -> dict[str, Any]:
    """Return the robot as plain data: its hash, what its links lack, and what builds it.

    The recipe is None where it is not plain data: then a verification needs the robot.
    """
    try:
        steps = recipe(robot.blueprint)
    except schema.NotPlainError:
        steps = None
    return {
        "name": robot.name,
        "hash": robot_hash(robot),
        "links_without_collision": links_without_collision(robot),
        "recipe": steps,
    }


def links_without_collision(robot: Robot) -> list[str]:
    """Return the moving links that nothing is proven of, as they have visual but no collision shapes; in order."""
    return sorted(robot.links_without_collision)


@singledispatch
def recipe(blueprint: Blueprint) -> dict[str, Any]:
    """Return what `RecipeReader.blueprint` reads, or raise NotPlainError if a part is made of Pinocchio's models."""
    raise schema.NotPlainError(f"a {type(blueprint).__name__} is not plain data")


@recipe.register
def _(blueprint: UrdfBlueprint) -> dict[str, Any]:
    names = [item.name for item in fields(blueprint) if item.name not in _OF_THE_MACHINE]
    options = {name: schema.as_plain(getattr(blueprint, name)) for name in names}
    files = {file: _carried_text(getattr(blueprint, file)) for file in _FILES}
    urdf = files["urdf"]
    if urdf is not None and "text" in urdf:
        urdf["text"] = blueprint.file().source(urdf["text"])
    return files | options


@recipe.register
def _(blueprint: OnBase) -> dict[str, Any]:
    return {"base": blueprint.pose.to_mapping(), "of": recipe(blueprint.of)}


@recipe.register
def _(blueprint: OnMobileBase) -> dict[str, Any]:
    return {"mobile_base": schema.as_plain(blueprint.ranges), "of": recipe(blueprint.of)}


@recipe.register
def _(blueprint: Attached) -> dict[str, Any]:
    item = blueprint.attachment.to_mapping(None)
    shape, files = item[blueprint.attachment.shape.kind], {}
    if "file" in shape:
        path = Path(shape["file"])
        shape["file"] = f"object{path.suffix}"
        files[shape["file"]] = encoded(path)
    return {"attached": schema.as_plain(item), "files": files, "of": recipe(blueprint.of)}


@recipe.register
def _(blueprint: WithAccelerations) -> dict[str, Any]:
    return recipe(blueprint.of)  # certificates of timed motions claim limits themselves


@recipe.register
def _(blueprint: Combined) -> dict[str, Any]:
    robots = {prefix: recipe(robot) for prefix, robot in blueprint.robots.items()}
    return {"robots": robots, "name": blueprint.name, "tip": blueprint.tip}


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


# ----------------------------------------------------------------------------------------------------- schema


def _xml(name: str, value: Any) -> str:
    """Read the text of a URDF or SRDF; what would grow when it is parsed is refused."""
    content = document.text(name, value)
    if len(content) > _MOST_CHARACTERS:
        raise InputError(f"has {len(content)} characters, {_MOST_CHARACTERS} are the most", name)
    if _DECLARATION.search(content):
        raise InputError("must not declare entities, or a document type", name)
    depth = 0
    try:
        for event, _ in ElementTree.iterparse(io.BytesIO(content.encode()), events=("start", "end")):
            depth += 1 if event == "start" else -1
            if depth > _DEEPEST:
                raise InputError(f"has tags in tags, more than {_DEEPEST} deep", name)
    except (ElementTree.ParseError, UnicodeEncodeError):
        pass  # building the robot reports what is wrong
    return content


@dataclass(frozen=True, kw_only=True)
class _File:
    """A URDF or SRDF: its text, or its name in example-robot-data."""

    example_robot_data: str | None = schema.key(schema.text, optional=True)
    name: str | None = schema.key(schema.text, optional=True)
    text: str | None = schema.key(_xml, optional=True)

    def __post_init__(self) -> None:
        if (self.example_robot_data is None) == (self.text is None):
            raise InputError("must be text, or a file of example-robot-data", "text")


@dataclass(frozen=True, kw_only=True)
class _FromFiles:
    urdf: _File = schema.key(schema.record(_File))
    srdf: _File | None = schema.key(schema.record(_File), optional=True)
    tip: str | None = schema.key(schema.text, optional=True)
    locked: Mapping[str, float] = schema.key(schema.by_name(schema.number()))
    hulls: bool = schema.key(schema.one_of(True, False))
    name: str | None = schema.key(schema.text, optional=True)
    limits: Mapping[str, tuple[float, float]] = schema.key(schema.by_name(schema.some(schema.number(), count=2)))
    collision: str | None = schema.key(schema.one_of(*get_args(CollisionSource)), optional=True)
    group: str | None = schema.key(schema.text, optional=True)
    locked_state: str | None = schema.key(schema.text, optional=True)


def _recipe(name: str, value: Any) -> Any:
    """Read one level of a recipe, and those within."""
    data = document.mapping(name, value)
    kind = next((kind for kind in _LEVELS if kind in data), None)
    if kind is None:
        raise InputError(f"must have one of the keys {', '.join(_LEVELS)}, got {shown(list(data))}", name)
    return schema.record(_LEVELS[kind])(name, data)


@dataclass(frozen=True, kw_only=True)
class _OnBase:
    base: Any = schema.key(schema.plain)
    of: Any = schema.key(_recipe)


@dataclass(frozen=True, kw_only=True)
class _OnMobileBase:
    mobile_base: Any = schema.key(schema.plain)
    of: Any = schema.key(_recipe)


@dataclass(frozen=True, kw_only=True)
class _Attached:
    attached: Any = schema.key(schema.plain)
    files: Mapping[str, str] | None = schema.key(carried_files, optional=True)
    of: Any = schema.key(_recipe)


@dataclass(frozen=True, kw_only=True)
class _Cell:
    robots: Mapping[str, Any] = schema.key(schema.by_name(_recipe))
    name: str = schema.key(schema.text)
    tip: str = schema.key(schema.text)


_LEVELS: dict[str, type[Any]] = {
    "urdf": _FromFiles,
    "base": _OnBase,
    "mobile_base": _OnMobileBase,
    "attached": _Attached,
    "robots": _Cell,
}


@dataclass(frozen=True, kw_only=True)
class RobotDocument:
    """A robot as it travels; see `carried_robot`."""

    name: str = schema.key(schema.text)
    hash: str = schema.key(schema.sha)
    links_without_collision: tuple[str, ...] = schema.key(schema.some(schema.text))
    recipe: Any = schema.key(schema.or_none(_recipe))


# ---------------------------------------------------------------------------------------------------- reading


def built_robot(
    carried: Mapping[str, Any] | RobotDocument, *, urdf: Path | None = None, package_dirs: Sequence[Path] = ()
) -> Robot:
    """Return the robot that a document carries the recipe of.

    Parameters
    ----------
    carried : mapping
        What `carried_robot` returned.
    urdf : Path, optional
        The URDF to read instead of the text that is carried; meshes are searched beside it.
    package_dirs : sequence of Path, optional
        Folders that hold the packages that the URDF names. What it names is looked for here and in
        example-robot-data, nowhere else.

    Raises
    ------
    InputError
        If there is no recipe, it cannot be used, or a mesh is not found. Whether it is the robot of the
        document's hash is for the verification to say.
    """
    if not isinstance(carried, RobotDocument):
        try:
            carried = schema.record(RobotDocument)("carried", carried)
        except RecursionError:
            raise InputError("is nested too deeply", "recipe") from None
    if carried.recipe is None:
        raise InputError(
            f"it carries no recipe of its robot {carried.name!r}: give the scenario, or the robot in Python"
        )
    given = urdf is not None or bool(package_dirs)
    with TemporaryDirectory(prefix="safe-ompl-") as folder:
        try:
            blueprint = RecipeReader(Path(folder), urdf, package_dirs).blueprint(carried.recipe)
            return _built(blueprint, carried.name, folder, given)
        except (*formats.MALFORMED, OSError) as error:
            if isinstance(error, InputError):
                raise
            why = str(error).partition("\n")[0]
            raise InputError(f"not a recipe of a robot: {why}", "recipe") from None


def _built(blueprint: Blueprint, name: str, folder: str, given: bool) -> Robot:
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


@dataclass
class RecipeReader:
    """Turns recipes into blueprints.

    The files that they carry go to an empty folder. A `urdf` is read instead of the one that is carried; there may only
    be one then.
    """

    folder: Path
    urdf: Path | None = None
    package_dirs: Sequence[Path] = ()
    _folders: int = field(default=0, init=False)
    _urdfs: int = field(default=0, init=False)

    def blueprint(self, level: Any, place: str = "recipe") -> Blueprint:
        """Return the blueprint of a recipe; raise InputError, naming the place in it, if it cannot be used."""
        builders: dict[type[Any], Any] = {
            _FromFiles: self._from_files,
            _OnBase: lambda data: OnBase(self._of(data), Pose.from_mapping(document.mapping("base", data.base))),
            _OnMobileBase: lambda data: OnMobileBase(self._of(data), mobile_ranges(data.mobile_base)),
            _Attached: self._attached,
            _Cell: self._cell,
        }
        with document.within(place):
            built: Blueprint = builders[type(level)](level)
            return built

    def _from_files(self, data: _FromFiles) -> Blueprint:
        self._urdfs += 1
        if self.urdf is not None and self._urdfs > 1:
            raise InputError("there are several robots: give the folders of their packages instead", "urdf")
        examples = examples_folder()
        folders = [*self.package_dirs, *([] if examples is None else [examples.parents[1]])]
        urdf = self.urdf or self._file("urdf", data.urdf)
        srdf = None if data.srdf is None else self._file("srdf", data.srdf)
        options = {item.name: getattr(data, item.name) for item in fields(data) if item.name not in _FILES}
        if options["collision"] is None:
            del options["collision"]
        names = str(urdf), None if srdf is None else str(srdf)
        return UrdfBlueprint(*names, package_dirs=tuple(map(str, folders)), **options)

    def _attached(self, data: _Attached) -> Blueprint:
        of, folder, files = self._of(data), self._own_folder(), data.files or {}
        unpack(files, folder)
        item = document.mapping("attached", data.attached)
        with document.within("attached"):
            for part, value in item.items():
                if isinstance(value, dict) and "file" in value and value["file"] not in files:
                    raise InputError(f"the file {shown(value['file'])} is not carried", f"{part}.file")
            return Attached(of, Attachment.from_mapping(item, folder))

    def _cell(self, data: _Cell) -> Blueprint:
        check_prefixes(data.robots)
        if data.tip not in data.robots:
            raise UnknownNameError("robot with the tip", data.tip, data.robots)
        robots = {prefix: self.blueprint(robot, f"robots.{prefix}") for prefix, robot in data.robots.items()}
        return Combined(data.name, robots, data.tip)

    def _of(self, data: Any) -> Blueprint:
        return self.blueprint(data.of, "of")

    def _own_folder(self) -> Path:
        self._folders += 1
        folder = self.folder / str(self._folders)
        folder.mkdir()
        return folder

    def _file(self, kind: str, file: _File) -> Path:
        """Return a URDF or SRDF where it can be read: in example-robot-data, or written into a folder."""
        with document.within(kind):
            if file.example_robot_data is not None:
                return _example(file.example_robot_data)
        assert file.text is not None
        path = self._own_folder() / f"carried.{kind}"
        path.write_text(file.text, encoding="utf-8")
        if kind == "urdf":
            place_meshes(path, self.package_dirs)
        return path


def _example(name: str) -> Path:
    path = (robots_folder() / name).resolve()
    if not (path.is_relative_to(robots_folder()) and path.suffix in (".urdf", ".srdf") and path.is_file()):
        raise InputError(f"{name!r} is not in example-robot-data", "example_robot_data")
    return path
