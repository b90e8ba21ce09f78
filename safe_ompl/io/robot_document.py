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
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, get_args

from safe_ompl.common import InputError, formats, shown
from safe_ompl.common import documents as document
from safe_ompl.geometry import Pose
from safe_ompl.io import schema
from safe_ompl.io.carried_files import carried_files, encoded, examples_folder, place_meshes, unpack
from safe_ompl.robot import Attachment, CollisionSource, Robot, RobotSpec, robot_hash, robots_folder

_FILES = ("urdf", "srdf")
_OPTIONS = ("tip", "locked", "hulls", "name", "limits", "collision", "group", "locked_state")
_MOST_CHARACTERS = 20_000_000  # of a URDF or an SRDF
_DEEPEST = 100  # tags in tags, recipes in recipes
_DECLARATION = re.compile(r"<!(DOCTYPE|ENTITY)", re.IGNORECASE)


# ---------------------------------------------------------------------------------------------------- writing


def carried_robot(robot: Robot) -> dict[str, Any]:
    """Return the robot as plain data: its hash, what its links lack, and what builds it.

    The recipe is None where it is not plain data: then a verification needs the robot.
    """
    try:
        steps = recipe(robot.spec)
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


def recipe(spec: RobotSpec) -> dict[str, Any]:
    """Return what `RecipeReader.spec` reads, or raise NotPlainError if a part is made of Pinocchio's models."""
    spec = spec.resolved()
    if spec.models is not None:
        raise schema.NotPlainError("models of Pinocchio's are not plain data")
    steps: dict[str, Any]
    if spec.robots:
        robots = {prefix: recipe(robot) for prefix, robot in spec.robots.items()}
        steps = {"robots": robots, "name": spec.name or "cell", "tip": spec.tip or next(iter(robots))}
    else:
        steps = {file: _carried_text(getattr(spec, file)) for file in _FILES}
        if "text" in steps["urdf"]:
            steps["urdf"]["text"] = spec.urdf_file().text()
        steps |= {name: schema.as_plain(getattr(spec, name)) for name in _OPTIONS}
        steps["locked"] = steps["locked"] or {}
    if spec.mobile_base is not None:
        steps = {"mobile_base": schema.as_plain(spec.mobile_base), "of": steps}
    if spec.base is not None:
        steps = {"base": spec.base.to_mapping(), "of": steps}
    for item in spec.attached:
        steps = {**_carried_object(item), "of": steps}
    return steps  # without accelerations: certificates of timed motions claim limits themselves


def _carried_object(attachment: Attachment) -> dict[str, Any]:
    item = attachment.to_mapping(None)
    shape, files = item[attachment.shape.kind], {}
    if "file" in shape:
        path = Path(shape["file"])
        shape["file"] = f"object{path.suffix}"
        files[shape["file"]] = encoded(path)
    return {"attached": schema.as_plain(item), "files": files}


def _carried_text(path: Path | None) -> Any:
    if path is None:
        return None
    examples = examples_folder()
    if examples is not None and path.is_relative_to(examples):
        return {"example_robot_data": path.relative_to(examples).as_posix()}
    try:
        return {"name": path.name, "text": path.read_text(encoding="utf-8")}
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be carried in a certificate ({error})", str(path)) from None


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
            spec = RecipeReader(Path(folder), urdf, package_dirs).spec(carried.recipe)
            return _built(spec, carried.name, folder, given)
        except (*formats.MALFORMED, OSError) as error:
            if isinstance(error, InputError):
                raise
            why = str(error).partition("\n")[0]
            raise InputError(f"not a recipe of a robot: {why}", "recipe") from None


def _built(spec: RobotSpec, name: str, folder: str, given: bool) -> Robot:
    """Build a robot; if that fails say what may be missing, unless it was given."""
    try:
        return Robot(spec)
    except InputError as error:
        if given:
            raise
        raise InputError(
            f"the robot {name!r} cannot be built from what is carried; meshes are not: give its URDF, or the "
            f"folder above its packages ({re.sub(re.escape(folder) + r'/([0-9]+/)?', '', str(error))})"
        ) from None


@dataclass
class RecipeReader:
    """Turns recipes into specifications of robots.

    The files that they carry go to an empty folder. A `urdf` is read instead of the one that is carried; there may only
    be one then.
    """

    folder: Path
    urdf: Path | None = None
    package_dirs: Sequence[Path] = ()
    _folders: int = field(default=0, init=False)
    _urdfs: int = field(default=0, init=False)

    def spec(self, level: Any, place: str = "recipe") -> RobotSpec:
        """Return what a recipe says of a robot; raise InputError, naming the place in it, if it cannot be used."""
        with document.within(place):
            if isinstance(level, _FromFiles):
                return self._from_files(level)
            if isinstance(level, _Cell):
                robots = {prefix: self.spec(robot, f"robots.{prefix}") for prefix, robot in level.robots.items()}
                return RobotSpec(robots=robots, name=level.name, tip=level.tip)
            of = self.spec(level.of, "of")
            if isinstance(level, _OnBase):
                return of.with_base(Pose.from_mapping(document.mapping("base", level.base)))
            if isinstance(level, _OnMobileBase):
                return replace(of, mobile_base=level.mobile_base)
            return replace(of, attached=(*of.attached, self._attachment(level)))

    def _from_files(self, data: _FromFiles) -> RobotSpec:
        self._urdfs += 1
        if self.urdf is not None and self._urdfs > 1:
            raise InputError("there are several robots: give the folders of their packages instead", "urdf")
        examples = examples_folder()
        folders = (*self.package_dirs, *([] if examples is None else [examples.parents[1]]))
        urdf = self.urdf or self._file("urdf", data.urdf)
        srdf = None if data.srdf is None else self._file("srdf", data.srdf)
        options = {name: getattr(data, name) for name in _OPTIONS}
        options["collision"] = data.collision or "required"
        return RobotSpec(None, urdf, srdf, folders, xacro_args=None, **options)

    def _attachment(self, data: _Attached) -> Attachment:
        folder, files = self._own_folder(), data.files or {}
        unpack(files, folder)
        item = document.mapping("attached", data.attached)
        with document.within("attached"):
            for part, value in item.items():
                if isinstance(value, dict) and "file" in value and value["file"] not in files:
                    raise InputError(f"the file {shown(value['file'])} is not carried", f"{part}.file")
            return Attachment.from_mapping(item, folder)

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
