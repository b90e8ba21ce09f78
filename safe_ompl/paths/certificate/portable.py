"""Robot and scene as a certificate carries them, so that it can be verified anywhere.

The scene travels whole: mesh and point files byte by byte. Of a robot travels what builds it: the texts of URDF and
SRDF, or where example-robot-data has them, and the choice of tip, joints and limits. Its meshes do not travel;
but its hash covers them, so that no other robot passes for it.
"""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from safe_ompl import document
from safe_ompl.errors import CertificateError, InputError
from safe_ompl.robot.construction.sources import UrdfBlueprint
from safe_ompl.robot.description.examples import robots_folder
from safe_ompl.robot.fingerprint import robot_hash
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

_FILES = ("urdf", "srdf")
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
                files[name] = _read(path)
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
        for name, data in files.items():
            if PurePosixPath(name).name != name or "\\" in name:
                raise InputError(f"{name!r} is not the name of a file", "files")
            (Path(folder) / name).write_bytes(_decoded(name, data))
        scene = Scene.from_mapping(content, Path(folder))
    if scene.content_hash() != document.require(carried, "hash"):
        raise CertificateError("the scene that it carries is not the one that it was written for")
    return scene


def _file_names(content: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for k, item in enumerate(document.sequence("obstacles", content.get("obstacles", ()))):
        for key, value in document.mapping(f"obstacles[{k}]", item).items():
            if isinstance(value, dict) and "file" in value:
                yield f"obstacles[{k}].{key}.file", value["file"]


def _read(path: Path) -> str:
    try:
        return b64encode(path.read_bytes()).decode("ascii")
    except OSError as error:
        raise InputError(f"cannot be carried in a certificate ({error.strerror})", str(path)) from None


def _decoded(name: str, data: Any) -> bytes:
    try:
        return b64decode(document.text(name, data), validate=True)
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"not in base 64: {error}", name) from None


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
    return sorted(getattr(robot, "links_without_collision", ()))


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
    name, recipe = carried.get("name"), document.require(carried, "recipe")
    if recipe is None:
        raise InputError(
            f"it carries no recipe of its robot {name!r}: give the scenario, or the robot in Python"
        )
    options, given = document.mapping("recipe", recipe), urdf is not None or bool(package_dirs)
    with TemporaryDirectory(prefix="safe-ompl-") as folder:
        files = {key: _file(key, options.pop(key, None), Path(folder)) for key in _FILES}
        examples = _examples()
        folders = [*package_dirs, *([] if examples is None else [examples.parents[1]])]
        try:
            return Robot.from_urdf(urdf or files["urdf"] or "", files["srdf"], folders, **options)
        except InputError as error:
            if given:
                raise
            raise InputError(
                f"the robot {name!r} cannot be built from what is carried; meshes are not: give its URDF, or the "
                f"folder above its packages ({str(error).replace(f'{folder}/', '')})"
            ) from None
        except (AttributeError, LookupError, OverflowError, TypeError, ValueError) as error:
            line = str(error).partition("\n")[0]
            raise InputError(f"not a recipe of a robot: {line}", "recipe") from None


def _recipe(robot: Robot) -> dict[str, Any] | None:
    if not isinstance(robot.blueprint, UrdfBlueprint):
        return None
    recipe = dict(vars(robot.blueprint))
    del recipe["package_dirs"]
    options = {key: value for key, value in recipe.items() if key not in _FILES}
    if not _is_plain(options):
        return None
    return {**{key: _carried_file(recipe[key]) for key in _FILES}, **options}


def _carried_file(name: str | None) -> dict[str, str] | None:
    if name is None:
        return None
    path = Path(name)
    examples = _examples()
    if examples is not None and path.is_relative_to(examples):
        return {"example_robot_data": path.relative_to(examples).as_posix()}
    try:
        return {"name": path.name, "text": path.read_text(encoding="utf-8")}
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be carried in a certificate ({error})", name) from None


def _file(key: str, carried: Any, folder: Path) -> Path | None:
    """Return a URDF or SRDF where it can be read: in example-robot-data, or written into a folder."""
    if carried is None and key == "srdf":
        return None
    with document.within("recipe"):
        file = document.mapping(key, carried)
        with document.within(key):
            if "example_robot_data" in file:
                return _example(document.text("example_robot_data", file["example_robot_data"]))
            document.check_keys(file, ("name", "text"))
            path = folder / f"carried.{key}"
            path.write_text(document.text("text", document.require(file, "text")), encoding="utf-8")
            return path


def _example(name: str) -> Path:
    path = (robots_folder() / name).resolve()
    if not path.is_relative_to(robots_folder()):
        raise InputError(f"{name!r} is not in example-robot-data", "example_robot_data")
    return path


def _examples() -> Path | None:
    """Return the folder of the robots of example-robot-data, or None where that is not installed."""
    try:
        return robots_folder()
    except InputError:
        return None


def _is_plain(value: Any) -> bool:
    """Return whether a value is the same after a journey through JSON, but for tuples that become lists."""
    if isinstance(value, Mapping):
        return all(isinstance(key, str) and _is_plain(item) for key, item in value.items())
    if isinstance(value, (list, tuple)):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, (str, bool, int, float))
