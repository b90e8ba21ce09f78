"""Write robots and scenes into documents, with hashes, and build them from these documents again.

The recipe of a robot has the keys of a robot in a scenario file. The recipe names files of example-robot-data, and
contains all other URDF and SRDF texts and the meshes of attached objects. Results also contain the meshes of a URDF,
compressed. Certificates do not contain these meshes: a reader looks for the meshes in folders that the user names,
never in a folder that the recipe names. The hash of the robot covers the meshes, so another mesh is detected.
"""

from __future__ import annotations

import io
import logging
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from safe_ompl.common import CertificateError, InputError, Section, documents as document, files, key
from safe_ompl.io import schema
from safe_ompl.robot import PackageDir, Robot, RobotSpec, UrdfFile, read_package_dir, robot_hash, robots_folder
from safe_ompl.scene import Scene

_log = logging.getLogger(__name__)

SMALL = 8_000_000
"""By default meshes are included in a document if they have at most this many characters after compression."""
# The package name that a URDF in a document uses for its meshes.
_PACKAGE = "carried"
_FILES = ("urdf", "srdf")
# Acceleration limits are left out, because certificates of timed motions state their own limits.
_OPTIONS = ("tip", "locked", "free", "name", "limits", "joint_limits", "collision", "group", "base", "mobile_base")
# The largest number of characters of a URDF or an SRDF in a document.
_MOST_CHARACTERS = 20_000_000
_DEEPEST = 100  # nested tags
_DECLARATION = re.compile(r"<!(DOCTYPE|ENTITY)", re.IGNORECASE)


# ---------------------------------------------------------------------------------------------------- writing


def embedded_robot(robot: Robot) -> dict[str, Any]:
    """Return a robot as plain data: name, hash, links without collision shapes, and recipe.

    The recipe is None if the robot is not built from plain data. A verification then needs the robot itself.
    """
    try:
        found = recipe(robot.spec)
    except schema.NotPlainError:
        found = None
    return {
        "name": robot.name,
        "hash": robot_hash(robot),
        "links_without_collision": sorted(robot.links_without_collision),
        "recipe": found,
    }


def recipe(spec: RobotSpec) -> dict[str, Any]:
    """Return the recipe of a robot, or raise NotPlainError if the robot or a part is built from Pinocchio models."""
    spec = spec.resolved()
    if spec.models is not None:
        raise schema.NotPlainError("models of Pinocchio's are not plain data")
    content = spec.to_mapping()
    if spec.joint_limits is not None:
        content["joint_limits"] = spec.joint_limits.content
    found: dict[str, Any] = schema.as_plain({name: content[name] for name in _OPTIONS if name in content})
    if spec.robots:
        found["robots"] = {prefix: recipe(robot) for prefix, robot in spec.robots.items()}
        found |= {"name": spec.name or "cell", "tip": spec.tip or next(iter(spec.robots))}
    else:
        found |= {file: _embedded_text(getattr(spec, file)) for file in _FILES}
        if "text" in found["urdf"]:
            found["urdf"]["text"] = spec.urdf_file().text()
        srdf = spec.srdf_file()
        if srdf is not None and spec.srdf is not None and spec.srdf.suffix == ".xacro":
            found["srdf"]["text"] = srdf.text()
    if spec.attached:
        found["attached"] = content["attached"]
        found["files"] = schema.embedded_objects(found["attached"])
        found["attached"] = schema.as_plain(found["attached"])
    return found


def _embedded_text(path: Path | None) -> Any:
    if path is None:
        return None
    examples = schema.examples_folder()
    if examples is not None and path.is_relative_to(examples):
        return {"example_robot_data": path.relative_to(examples).as_posix()}
    try:
        return {"name": path.name, "text": path.read_text(encoding="utf-8")}
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be embedded in a document ({error})", str(path)) from None


def packed_robot(robot: Robot, meshes: bool | None = None) -> dict[str, Any]:
    """Return a robot as `embedded_robot` does, with the meshes of its URDFs. Equal meshes are stored once, by hash.

    With `meshes` True all meshes are stored, with False none. By default collision meshes are stored if they have at
    most `SMALL` characters, then visual meshes if both together do. A warning is logged if collision meshes are left
    out because of their size.
    """
    embedded = embedded_robot(robot)
    if meshes is False or embedded["recipe"] is None:
        return embedded
    sources = [pair for pair in _sources(robot.spec.resolved(), embedded["recipe"]) if "text" in pair[1]]
    names: dict[Path, str] = {}
    content: dict[str, str] = {}
    meant: list[dict[str, Path]] = [{} for _ in sources]
    for tag in ("collision", "visual"):
        try:
            found = [urdf.mesh_files(tag) for urdf, _ in sources]
        except InputError as error:
            if tag == "collision":
                raise
            _log.warning("%s: saved without visual meshes, its collision bodies are drawn (%s)", robot.name, error)
            break
        added = {path for named in found for path in named.values()} - names.keys()
        more = {path: schema.packed(path) for path in sorted(added)}
        if not meshes and sum(map(len, [*content.values(), *more.values()])) > SMALL:
            level = logging.WARNING if tag == "collision" else logging.INFO
            _log.log(level, "%s: its %s meshes are too large to be saved with it: --package-dir", robot.name, tag)
            break
        for path, data in more.items():
            names[path] = f"{sha256(data.encode()).hexdigest()[:32]}{path.suffix.lower()}"
            content[names[path]] = data
        meant = [{**before, **named} for before, named in zip(meant, found, strict=True)]
    for (urdf, text), named in zip(sources, meant, strict=True):
        text["text"] = urdf.text({name: f"package://{_PACKAGE}/{names[path]}" for name, path in named.items()})
    return {**embedded, "meshes": content} if content else embedded


def _sources(spec: RobotSpec, recipe: Mapping[str, Any]) -> Iterator[tuple[UrdfFile, dict[str, str]]]:
    """Yield every URDF of a robot, with the mapping in the recipe that holds its text."""
    for prefix, part in recipe.get("robots", {}).items():
        yield from _sources(spec.robots[prefix].resolved(), part)
    if not spec.robots:
        yield spec.urdf_file(), recipe["urdf"]


# ---------------------------------------------------------------------------------------------------- reading


def _xml(key: str, value: Any) -> str:
    """Read the text of a URDF or SRDF. Refuse entity declarations, deep nesting and long texts (XML bombs)."""
    content = document.text(key, value)
    if len(content) > _MOST_CHARACTERS:
        raise InputError(f"has {len(content)} characters, {_MOST_CHARACTERS} is the limit", key)
    if _DECLARATION.search(content):
        raise InputError("must not declare entities, or a document type", key)
    depth = 0
    try:
        for event, _ in ElementTree.iterparse(io.BytesIO(content.encode()), events=("start", "end")):
            depth += 1 if event == "start" else -1
            if depth > _DEEPEST:
                raise InputError(f"has tags in tags, more than {_DEEPEST} deep", key)
    except (ElementTree.ParseError, UnicodeEncodeError):
        # Building the robot reports what is wrong.
        pass
    return content


@dataclass(frozen=True, kw_only=True)
class _File(Section):
    """A URDF or SRDF in a document: its text, or its path in example-robot-data."""

    example_robot_data: str | None = key(document.line, default=None)
    name: str | None = key(document.line, default=None)
    text: str | None = key(_xml, default=None)

    def check(self) -> None:
        if (self.example_robot_data is None) == (self.text is None):
            raise InputError("must be text, or a file of example-robot-data", "text")


@dataclass(frozen=True, kw_only=True)
class RobotDocument(Section):
    """A robot in a document; see `embedded_robot` and `packed_robot`."""

    name: str = key(document.line)
    hash: str = key(document.sha)
    links_without_collision: tuple[str, ...] = key(document.list_of, read=document.line)
    recipe: Mapping[str, Any] | None = key(document.mapping, default=None)
    meshes: Mapping[str, str] = key(schema.embedded_files, factory=dict)


def built_robot(embedded: Any, *, package_dirs: Sequence[PackageDir] = ()) -> Robot:
    """Build a robot from the recipe in a document. The hash is not compared here, but by the verification.

    Meshes are only looked for in `package_dirs`, in the document, and in example-robot-data. Raises InputError if the
    robot cannot be built.
    """
    embedded = document.section("embedded", embedded, RobotDocument)
    if embedded.recipe is None:
        raise InputError(
            f"the file does not contain its robot {embedded.name!r}: give the scenario, or the robot in Python"
        )
    with TemporaryDirectory(prefix="safe-ompl-") as folder:
        try:
            folders = [read_package_dir("package_dirs", entry) for entry in package_dirs]
            if embedded.meshes:
                place = Path(folder) / _PACKAGE
                place.mkdir()
                schema.unpack(embedded.meshes, place)
                folders.append(Path(folder))
            numbers = (Path(folder) / str(k) for k in count(1))
            spec = _spec("recipe", embedded.recipe, numbers, folders)
            robot = _built(spec, embedded.name, folder, given=bool(package_dirs))
            if embedded.meshes:
                robot.visual_model  # noqa: B018  # temporary folder
            return robot
        except (*files.MALFORMED, OSError) as error:
            if isinstance(error, InputError):
                raise
            why = str(error).partition("\n")[0]
            raise InputError(f"not a description of a robot: {why}", "recipe") from None


def _built(spec: RobotSpec, name: str, folder: str, *, given: bool) -> Robot:
    """Build a robot. If building fails and no package folder was `given`, the error says that meshes may be missing."""
    try:
        robot = Robot(replace(spec, attached=()))
        for item in spec.attached:
            robot = robot.holding(item)
        return robot
    except InputError as error:
        if given:
            raise
        raise InputError(
            f"the robot {name!r} cannot be built from what the document contains; meshes are not in it: give the "
            f"folder above its packages ({re.sub(re.escape(folder) + r'/([0-9]+/)?', '', str(error))})"
        ) from None


def _spec(key: str, recipe: Any, folders: Iterator[Path], package_dirs: Sequence[PackageDir]) -> RobotSpec:
    """Read the specification of a robot from a recipe, and write the files in the recipe to new folders."""
    given = document.mapping(key, recipe, (*_OPTIONS, *_FILES, "attached", "files", "robots"))
    folder = next(folders)
    folder.mkdir()
    with document.within(key):
        schema.unpack(schema.embedded_files("files", files := given.pop("files", {})), folder)
        schema.check_embedded("attached", given.get("attached", ()), files)
        if robots := document.mapping("robots", given.get("robots", {})):
            given["robots"] = {k: _spec(f"robots.{k}", part, folders, package_dirs) for k, part in robots.items()}
            return RobotSpec.from_mapping(given, folder)
        own = {file: document.section(file, given.get(file), _File) for file in _FILES if given.get(file) is not None}
        if "urdf" not in own:
            raise InputError("missing: give either urdf or robots", "urdf")
        given |= {file: _written(content, folder / f"carried.{file}") for file, content in own.items()}
        if own["urdf"].text is not None:
            schema.place_meshes(given["urdf"], package_dirs)
        examples = schema.examples_folder()
        given["package_dirs"] = [*package_dirs, *([] if examples is None else [examples.parents[1]])]
        return RobotSpec.from_mapping({**given, "xacro_args": None}, folder)


def _written(file: _File, path: Path) -> Path:
    """Return the path of a URDF or SRDF: its file in example-robot-data, or `path` after writing the text there."""
    if file.text is not None:
        path.write_text(file.text, encoding="utf-8")
        return path
    known = (robots_folder() / str(file.example_robot_data)).resolve()
    if not (known.is_relative_to(robots_folder()) and known.suffix in (".urdf", ".srdf") and known.is_file()):
        raise InputError(f"{file.example_robot_data!r} is not in example-robot-data", "example_robot_data")
    return known


# ---------------------------------------------------------------------------------------------- scenes, problems


@dataclass(frozen=True, kw_only=True)
class SceneDocument(Section):
    """A scene in a document: the `hash` of its content, the content of a scene document, and its files by name."""

    hash: str = key(document.sha)
    content: Mapping[str, Any] = key(document.plain)
    files: Mapping[str, str] = key(schema.embedded_files, factory=dict)

    def check(self) -> None:
        content = document.mapping("content", self.content)
        with document.within("content"):
            schema.check_embedded("obstacles", content.get("obstacles", ()), self.files)


def embedded_scene(scene: Scene) -> dict[str, Any]:
    """Return a scene as plain data. Raise InputError if one of its files is gone or has changed since it was read."""
    content = scene.to_mapping()
    files = schema.embedded_objects(content.get("obstacles", []))
    embedded = {"hash": scene.content_hash(), "content": content, "files": files}
    try:
        if files:
            built_scene(embedded)
    except CertificateError:
        raise InputError(
            "a mesh or point file of the scene has changed since it was read: read the scene anew"
        ) from None
    return embedded


def built_scene(embedded: Any) -> Scene:
    """Build a scene from a document. Raise InputError if the document is invalid, CertificateError if hashes differ."""
    embedded = document.section("embedded", embedded, SceneDocument)
    with TemporaryDirectory(prefix="safe-ompl-") as folder:
        schema.unpack(embedded.files, Path(folder))
        try:
            scene = Scene.from_mapping(embedded.content, Path(folder))
        except InputError as error:
            raise InputError(str(error).replace(f"{folder}/", "")) from None
        except MemoryError:
            raise InputError("a file needs more memory than the machine has", "files") from None
    if scene.content_hash() != embedded.hash:
        raise CertificateError("the scene that it carries is not the one that it was written for")
    return scene


class EmbeddedProblem(NamedTuple):
    """Robot, scene, and the options of the danger field."""

    robot: Robot
    scene: Scene
    danger: Mapping[str, Any] | None

    def to_mapping(self, meshes: bool | None = None) -> dict[str, Any]:
        """Return the problem as plain data, which `from_mapping` reads; `meshes` as in `packed_robot`."""
        return {
            "robot": packed_robot(self.robot, meshes),
            "scene": embedded_scene(self.scene),
            "danger": None if self.danger is None else dict(self.danger),
        }

    @classmethod
    def from_mapping(
        cls, data: object, robot: Robot | None = None, package_dirs: Sequence[PackageDir] = ()
    ) -> EmbeddedProblem:
        """Read a problem from a document. Without `robot` the robot is built from its recipe. Errors as of `load`."""
        with document.within("problem"):
            embedded = document.mapping("embedded", data)
            if robot is None:
                with document.within("robot", ": "):
                    robot = built_robot(document.require(embedded, "robot"), package_dirs=package_dirs)
            with document.within("scene"):
                scene = built_scene(document.require(embedded, "scene"))
        return cls(robot, scene, embedded.get("danger"))
