"""Scenes: the obstacles around the robot, and the points on them that are dangerous to approach."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from safe_ompl.common import FloatArray, InputError, IntArray, UnknownNameError, documents as document, files, shown
from safe_ompl.geometry import Box, Capsule, Cylinder, Obstacle, Pose, Shape, Sphere, check_number, placed
from safe_ompl.scene.scene_text import read_scene_text

# `Scene.touched` adds the core of an obstacle as an obstacle of its own, whose name has this ending.
CORE = " mm deep"
_SPACING = 0.1  # [m]
_MBM_KINDS = ("box", "cylinder", "sphere", "capsule")


def _obstacles(key: str, given: Any) -> tuple[Obstacle, ...]:
    """Read a list of obstacles, each an `Obstacle` or a mapping from a document."""
    if given is not None and (isinstance(given, (Obstacle, str, Mapping)) or not isinstance(given, Iterable)):
        raise InputError(f"must be a list of Obstacle, got {shown(given)}; no obstacles: Scene()", key)
    return tuple(_obstacle(f"{key}[{k}]", item) for k, item in enumerate(given or ()))


def _obstacle(key: str, given: Any) -> Obstacle:
    if isinstance(given, Obstacle):
        return given
    if not isinstance(given, Mapping):
        raise InputError(f"must be an Obstacle, or a mapping that describes one, got {shown(given)}", key)
    name = f" {given['name']!r}" if "name" in given else ""
    with document.within(f"{key}{name}"):
        return Obstacle.from_mapping(document.mapping("obstacle", given), document.folder_of_document())


@dataclass(frozen=True)
class Scene(document.Section):
    """A scene: obstacles in the world frame, which is the frame of the robot's base.

    Parameters
    ----------
    obstacles : sequence of Obstacle, optional
        The obstacles, with different names.
    spacing : float, optional
        Largest distance [m] of surface points from danger points.

    Raises
    ------
    InputError
        If two obstacles have the same name, or the spacing is not positive.

    Examples
    --------
    >>> scene = Scene([Obstacle("table", Box([0.8, 0.5, 0.03]), Pose([0.5, 0.0, 0.4]))])
    >>> scene.names
    ('table',)
    >>> scene.moved({"table": Pose([0.6, 0.0, 0.4])})["table"].pose.position
    (0.6, 0.0, 0.4)
    """

    obstacles: tuple[Obstacle, ...] = document.key(_obstacles, default=())
    spacing: float = document.key(document.number, default=_SPACING, above=0.0)

    # Type checkers see the types of the arguments. The fields hold what the arguments are converted to.
    if TYPE_CHECKING:

        def __init__(self, obstacles: Iterable[Obstacle | Mapping[str, Any]] = ..., spacing: float = ...) -> None: ...

    def check(self) -> None:
        """Raise InputError if two obstacles have the same name."""
        seen: dict[str, int] = {}
        for k, obstacle in enumerate(self.obstacles):
            if obstacle.name in seen:
                first = seen[obstacle.name]
                same = "the same obstacle, given twice" if obstacle == self.obstacles[first] else "another one"
                raise InputError(
                    f"{obstacle.name!r} is already obstacles[{first}], {same}; names must differ",
                    f"obstacles[{k}].name",
                )
            seen[obstacle.name] = k

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], folder: Path | None = None) -> Scene:
        """Read a scene from the keys ``obstacles``, ``spacing``, ``moveit`` and ``meshes``.

        ``moveit`` names a `.scene` file of MoveIt, whose objects precede the other obstacles. Its meshes and cones are
        written to the folder ``meshes``, see `read_scene_text`.
        """
        document.check_keys(data, (*(item.name for item in document.keys_of(cls)), "moveit", "meshes"))
        given = {name: value for name, value in data.items() if name not in ("moveit", "meshes")}
        if "moveit" in data:
            below = folder or document.folder_of_document()
            file = document.file("moveit", below / document.text("moveit", data["moveit"]), (".scene",))
            meshes = below / document.text("meshes", data["meshes"]) if "meshes" in data else None
            with document.within("moveit", ": "):
                own = read_scene_text(file, meshes)
            given["obstacles"] = [*own, *document.sequence("obstacles", data.get("obstacles") or ())]
        elif "meshes" in data:
            raise InputError("needs the key moveit with a file, which is missing", "meshes")
        return super().from_mapping(given, folder)

    @classmethod
    def from_file(cls, path: str | Path) -> Scene:
        """Read a scene from a YAML file, or from a `.scene` file of MoveIt without meshes.

        Mesh and point files are relative to the YAML file. Raises InputError with file, line, key and value if the file
        cannot be read or is not a valid scene.
        """
        file = Path(path)
        if file.suffix.lower() == ".scene":
            return cls(read_scene_text(file))
        with files.reading(file) as data:
            return cls.from_mapping(data, file.parent)

    @classmethod
    def from_yaml(cls, text: str, folder: str | Path = ".") -> Scene:
        """Read a scene from YAML text; mesh and point files are relative to `folder`."""
        return cls.from_mapping(files.parse_document(text), Path(folder))

    def to_yaml(self, folder: str | Path | None = None) -> str:
        """Return the scene as YAML that `from_yaml` reads back exactly.

        Mesh and point files are named relative to `folder`, or by absolute paths if `folder` is None.
        """
        return files.dump_document(self.to_mapping(None if folder is None else Path(folder)))

    def save(self, path: str | Path) -> None:
        """Write the scene to a YAML file. Mesh and point files are named relative to this file."""
        files.write(path, self.to_yaml(Path(path).parent))

    @classmethod
    def from_mbm(cls, problem: Mapping[str, Any], spacing: float = _SPACING) -> Scene:
        """Return the scene of a MotionBenchMaker problem. All obstacles get the danger weight 1.

        The problem has lists of obstacles under ``box`` (name, half_extents), ``cylinder`` (name, radius, length) and
        ``sphere`` (name, radius), each with position [m] and orientation_quat_xyzw; safe_ompl adds ``capsule`` (as
        ``cylinder``). An obstacle without a name is named after its kind. A repeated name gets a number.
        """
        obstacles: dict[str, Obstacle] = {}
        for kind, value in problem.items():
            if kind not in _MBM_KINDS and isinstance(value, list) and any(isinstance(item, dict) for item in value):
                raise InputError(f"obstacles of this kind are not supported; known: {', '.join(_MBM_KINDS)}", kind)
        for kind in _MBM_KINDS:
            for k, item in enumerate(document.sequence(kind, problem.get(kind, ()))):
                data = document.mapping(f"{kind}[{k}]", item)
                name = str(data.get("name", kind))
                numbered = itertools.chain([name], (f"{name}#{k}" for k in itertools.count(2)))
                name = next(each for each in numbered if each not in obstacles)
                with document.within(f"{kind}[{k}]"):
                    obstacles[name] = Obstacle(name, *_mbm_shape(kind, data), weight=1.0)
        return cls(tuple(obstacles.values()), spacing)

    def content_hash(self) -> str:
        """Return the SHA-256 of the scene, with mesh and point data and without file names."""
        content = {"spacing": self.spacing, "obstacles": [obstacle.canonical() for obstacle in self.obstacles]}
        return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the obstacles, in order."""
        return tuple(obstacle.name for obstacle in self.obstacles)

    def __getitem__(self, name: str) -> Obstacle:
        for obstacle in self.obstacles:
            if obstacle.name == name:
                return obstacle
        raise UnknownNameError("obstacle", name, self.names)

    def __iter__(self) -> Iterator[Obstacle]:
        return iter(self.obstacles)

    def with_obstacles(self, *obstacles: Obstacle) -> Scene:
        """Return the scene with the given obstacles added."""
        return Scene(self.obstacles + obstacles, self.spacing)

    def without(self, *names: str) -> Scene:
        """Return the scene without the named obstacles. Raises UnknownNameError for an unknown name."""
        gone = {self[name].name for name in names}
        return Scene(tuple(obstacle for obstacle in self.obstacles if obstacle.name not in gone), self.spacing)

    def touched(self, pairs: Iterable[tuple[str, str]], depth: float) -> Scene:
        """Return the scene with contacts allowed: links may reach into obstacles up to `depth` [m].

        Each pair is the name of a link, or of an object that the robot holds, and the name of an obstacle. The part of
        the obstacle deeper than `depth` is added as an obstacle that no link may touch, with a name such as
        "table, 1 mm deep". Raises InputError if the obstacle is no box, sphere, cylinder or capsule, or is nowhere
        deeper than `depth`; UnknownNameError for an unknown obstacle.
        """
        links: dict[str, list[str]] = {}
        for link, name in pairs:
            links.setdefault(self[name].name, []).append(link)
        found = []
        for obstacle in self.obstacles:
            if obstacle.name in links:
                with document.within(repr(obstacle.name)):
                    core = obstacle.shape.core(document.number("depth", depth, above=0.0))
                obstacle = replace(obstacle, touched_by=(*obstacle.touched_by, *links[obstacle.name]))
                found.append(Obstacle(f"{obstacle.name}, {1e3 * depth:.12g}{CORE}", core, obstacle.pose, weight=0.0))
            found.append(obstacle)
        return Scene(tuple(found), self.spacing)

    def untouched(self) -> tuple[Scene, dict[str, tuple[tuple[str, ...], float]]]:
        """Undo `touched`: return the scene before it, and by obstacle the links that may touch it and the depth [m].

        Obstacles that links may touch to any depth stay unchanged.
        """
        contacts, cores, found = dict[str, tuple[tuple[str, ...], float]](), set[str](), []
        for obstacle in self.obstacles:
            begin = f"{obstacle.name}, "
            own = [name for name in self.names if name.startswith(begin) and name.endswith(CORE)]
            if obstacle.touched_by and own:
                depth = max(float(name[len(begin) : -len(CORE)]) / 1e3 for name in own)
                contacts[obstacle.name] = obstacle.touched_by, depth
                obstacle = replace(obstacle, touched_by=())
                cores |= {*own}
            found.append(obstacle)
        return Scene(tuple(o for o in found if o.name not in cores), self.spacing), contacts

    def moved(self, places: Mapping[str, Any]) -> Scene:
        """Return the scene with some obstacles moved. The other obstacles are shared with this scene.

        Parameters
        ----------
        places : mapping of str to Pose, pin.SE3, array_like or mapping
            New places of obstacles, by name: a pose; or, in the world frame [m], the key points of a person (a mapping
            of names to 3 numbers), or the points of a cloud (an array (N, 3)). See `Obstacle.moved`.

        Raises
        ------
        InputError
            If an obstacle does not exist, or a place cannot be used; the message starts with the name.
        """
        for name in document.mapping("places", places):
            # Raises UnknownNameError if there is no such obstacle.
            self[name]
        obstacles = []
        for obstacle in self.obstacles:
            if obstacle.name in places:
                with document.within(repr(obstacle.name)):
                    obstacle = obstacle.moved(places[obstacle.name])
            obstacles.append(obstacle)
        return Scene(tuple(obstacles), self.spacing)

    def danger_points(self, spacing: float | None = None) -> tuple[FloatArray, FloatArray, IntArray]:
        """Sample the surfaces of all obstacles with danger weight above 0.

        Returns the danger points (M, 3) in the world frame [m], their danger weights (M,), and the indices (M,) of
        their obstacles in `obstacles`. Each point of a surface or point cloud is within `spacing` [m] (default: the
        spacing of the scene) of a danger point of its obstacle; neighbours may be nearer to each other than that.
        Raises InputError if the spacing is not positive or needs more than a million points, before any point is made.
        """
        step = document.number("spacing", self.spacing if spacing is None else spacing, above=0.0)
        dangerous = [k for k, obstacle in enumerate(self.obstacles) if obstacle.weight > 0]
        chosen = [self.obstacles[k] for k in dangerous]
        most = sum(obstacle.shape.most_danger_points(step) for obstacle in chosen)
        check_number(most, step, f"{len(chosen)} obstacles" if len(chosen) != 1 else repr(chosen[0].name))
        points = [placed(obstacle.pose.se3, obstacle.shape.kept_danger_points(step)) for obstacle in chosen]
        owners = np.repeat(np.array(dangerous, dtype=np.intp), [len(own) for own in points])
        weights = np.array([obstacle.weight for obstacle in self.obstacles], dtype=float)
        return np.concatenate([np.zeros((0, 3)), *points]), weights[owners], owners

    def __repr__(self) -> str:
        listed = ", ".join(f"{o.name!r}: {o.shape.kind}" for o in self.obstacles)
        return f"Scene({{{listed}}}, spacing={self.spacing:g})"


def _mbm_shape(kind: str, data: Mapping[str, Any]) -> tuple[Shape, Pose]:
    pose = Pose(document.require(data, "position"), document.require(data, "orientation_quat_xyzw"))
    if kind == "box":
        half = document.numbers("half_extents", document.require(data, "half_extents"), 3, above=0.0)
        return Box(tuple(2 * extent for extent in half)), pose
    if kind in ("cylinder", "capsule"):
        shape = Cylinder if kind == "cylinder" else Capsule
        return shape(document.require(data, "radius"), document.require(data, "length")), pose
    return Sphere(document.require(data, "radius")), pose
