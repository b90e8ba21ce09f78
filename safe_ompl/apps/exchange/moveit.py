"""Read planning scenes of MoveIt, including OctoMap maps.

Content that cannot be represented raises an InputError that names file, key and value. Meshes become convex hulls.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.common import InputError, UnknownNameError, documents as document, files
from safe_ompl.geometry import Box, Cylinder, Mesh, Obstacle, Pose, Shape, Sphere, written_mesh
from safe_ompl.io import plain_message
from safe_ompl.robot import Attachment
from safe_ompl.scene import Scene, read_scene_text, written_cone

_OBJECT = (
    *("header", "pose", "id", "type", "primitives", "primitive_poses", "meshes", "mesh_poses", "planes"),
    *("plane_poses", "subframe_names", "subframe_poses", "operation"),
)
_SCENE = (
    *("name", "robot_state", "robot_model_name", "fixed_frame_transforms", "allowed_collision_matrix"),
    *("link_padding", "link_scale", "object_colors", "world", "is_diff"),
)
_POSES = {"primitives": "primitive_poses", "meshes": "mesh_poses"}
_PLANNING_SCENE = "moveit_msgs/msg/PlanningScene"
# The number of levels of an OctoMap tree below its root.
_DEPTH = 16

Placed = list[tuple[Shape, pin.SE3]]


@contextmanager
def document_of(file: str | Path) -> Iterator[dict[str, Any]]:
    """Yield the mapping in a JSON or YAML file. All errors that a broken file causes become errors naming the file."""
    path = Path(file)
    reading: AbstractContextManager[Any] = files.reading_json(path) if path.suffix == ".json" else files.reading(path)
    with reading as data:
        try:
            yield document.mapping("document", data)
        except InputError:
            raise
        except files.MALFORMED as error:
            raise InputError(f"is malformed ({type(error).__name__}: {error})") from error


@contextmanager
def _planning_scene(file: str | Path, topic: str | None) -> Iterator[dict[str, Any]]:
    """Yield the message in a document, or the last message in a recording. Errors name the file."""
    if not (Path(file).is_dir() or Path(file).suffix in (".mcap", ".db3", ".bag")):
        with document_of(file) as data:
            yield data
        return
    from safe_ompl.live.ros import Bag

    bag = Bag(file)
    messages = bag.read(bag.topic(topic, (_PLANNING_SCENE,), "topic"))
    with document.within(str(file), ": "):
        if not messages:
            raise InputError(f"has no message of {_PLANNING_SCENE}")
        yield plain_message(messages[-1][1])


def scene_from_moveit(
    file: str | Path, *, meshes: str | Path | None = None, topic: str | None = None
) -> tuple[Scene, tuple[Attachment, ...]]:
    """Read a `moveit_msgs/PlanningScene`.

    The scene is in the planning frame. Pairs of a link and an object that the allowed collision matrix allows to touch
    become `touched_by`. Pairs of two links are ignored, because the robot's SRDF defines them.

    Parameters
    ----------
    file : path-like
        The message as YAML or JSON; a recording of ROS 2 (.mcap, a folder, .db3), of which the last message is read;
        or the objects as RViz exports them (.scene).
    meshes : path-like, optional
        The folder to which meshes and cones are written (.obj). Concave meshes become their hulls.
    topic : str, optional
        The topic to read from a recording with several topics.

    Returns
    -------
    scene : Scene
        Objects of several shapes are several obstacles, called id/0, id/1, …
    attached : tuple of Attachment
        The objects that the robot holds, for ``attached=`` of `Robot.from_urdf`.

    Raises
    ------
    InputError
        If the message is a difference, or cannot be represented: prisms, planes, padding or scale of links, frames
        without a pose in the message, full (not binary) octomaps. The message names file, key and value.
    """
    if Path(file).suffix.lower() == ".scene":
        return Scene(read_scene_text(file, meshes)), ()
    with _planning_scene(file, topic) as data:
        return _Moveit(data, None if meshes is None else Path(meshes)).read()


class _Moveit:
    """A planning scene, with the poses of its `frames` in the planning frame and its allowed collision matrix."""

    def __init__(self, data: Mapping[str, Any], folder: Path | None) -> None:
        self.data, self.folder = data, folder
        document.check_keys(data, _SCENE)
        if data.get("is_diff"):
            raise InputError("must be false: a difference does not contain the whole scene", "is_diff")
        for key, what, neutral in (("link_padding", "padding", 0.0), ("link_scale", "scale", 1.0)):
            for k, item in enumerate(document.sequence(key, data.get(key, ()))):
                if item[what] != neutral:
                    why = "links are as they are here; require a min_clearance instead"
                    raise InputError(f"must be {neutral:g}, got {item[what]!r}: {why}", f"{key}[{k}].{what}")
        self.world = document.mapping("world", document.require(data, "world"), ("collision_objects", "octomap"))
        state = document.mapping("robot_state", data.get("robot_state", {}))
        self.objects = document.sequence("world.collision_objects", self.world.get("collision_objects", ()))
        self.held = document.sequence("attached_collision_objects", state.get("attached_collision_objects", ()))
        moved = document.sequence("fixed_frame_transforms", data.get("fixed_frame_transforms", ()))
        known = [_frame(item) for item in (*moved, state.get("joint_state", {}), *self.objects)]
        planning = next((frame for frame in known if frame), "")
        self.frames = {"": pin.SE3.Identity(), planning: pin.SE3.Identity()}
        for k, item in enumerate(moved):
            with document.within(f"fixed_frame_transforms[{k}]"):
                place = _pose(item["transform"], "translation", "rotation")
                self.frames[item["child_frame_id"].removeprefix("/")] = self.frame(item) * place

    def frame(self, item: Mapping[str, Any]) -> pin.SE3:
        if _frame(item) not in self.frames:
            raise UnknownNameError("frame", _frame(item), sorted(self.frames), "header.frame_id")
        return self.frames[_frame(item)]

    def read(self) -> tuple[Scene, tuple[Attachment, ...]]:
        solids, held = dict[str, Placed](), list[Attachment]()
        for k, item in enumerate(self.objects):
            with document.within(f"world.collision_objects[{k}] {item.get('id')!r}"):
                name = document.text("id", item.get("id"))
                if name in solids:
                    raise InputError("is there twice", "id")
                solids[name] = self.solids(item, self.frame(item))
        named: dict[str, tuple[str, ...]] = {}
        allowed = self.allowed([*solids, *(item["object"]["id"] for item in self.held)])
        for k, item in enumerate(self.held):
            body, link = item["object"], item["link_name"]
            with document.within(f"attached_collision_objects[{k}] {body['id']!r}"):
                if _frame(body) not in ("", link):
                    raise InputError(f"must be the link {link!r}, got {_frame(body)!r}", "object.header.frame_id")
                own = self.solids(body, pin.SE3.Identity())
                named[body["id"]] = names = tuple(_names(body["id"], own))
                touch = sorted({*item.get("touch_links", ()), *allowed[body["id"]]} - {*allowed})
                held += [Attachment(n, s, link, Pose.of(p), tuple(touch)) for n, (s, p) in zip(names, own, strict=True)]
        octomap = document.mapping("octomap", self.world.get("octomap", {}))
        obstacles = []
        for key, own in solids.items():
            links = sorted(allowed[key] - {*solids})
            touching = [name for link in links for name in named.get(link, (link,))]
            placed = zip(_names(key, own), own, strict=True)
            obstacles += [Obstacle(name, shape, place, touched_by=touching) for name, (shape, place) in placed]
        if octomap.get("octomap", {}).get("data"):
            with document.within("world.octomap"):
                obstacles += self.map(octomap)
        return Scene(obstacles), tuple(held)

    def map(self, data: Mapping[str, Any]) -> list[Obstacle]:
        tree = data["octomap"]
        if not tree.get("binary") or tree.get("id") != "OcTree":
            got = f"binary {tree.get('binary')!r}, id {tree.get('id')!r}"
            raise InputError(f"must be a binary OcTree, got {got}", "octomap")
        place = self.frame(data) * _pose(data.get("origin", {}))
        return _leaves(bytes(value % 256 for value in tree["data"]), tree["resolution"], place)

    def allowed(self, names: Collection[str]) -> dict[str, set[str]]:
        """Return, for each object, the links and objects that may touch it."""
        found: dict[str, set[str]] = {name: set() for name in names}
        matrix = document.mapping("allowed_collision_matrix", self.data.get("allowed_collision_matrix", {}))
        with document.within("allowed_collision_matrix"):
            defaults = matrix.get("default_entry_names", ()), matrix.get("default_entry_values", ())
            for name, value in zip(*defaults, strict=True):
                if value and name in found:
                    raise InputError(f"{name!r} may touch everything: name the links instead", "default_entry_values")
            entries = matrix.get("entry_names", ())
            for name, row in zip(entries, matrix.get("entry_values", ()), strict=True):
                for other, enabled in zip(entries, row["enabled"], strict=True):
                    if enabled and name in found and other != name:
                        found[name].add(other)
        return found

    def solids(self, item: Mapping[str, Any], frame: pin.SE3) -> Placed:
        document.check_keys(item, _OBJECT)
        if item.get("operation", 0) not in (0, b"\0", "\0"):
            raise InputError(f"must be ADD (0), got {item['operation']!r}", "operation")
        if item.get("planes"):
            raise InputError("planes are not supported: use a box", "planes")
        origin = frame * _pose(item.get("pose", {}))
        found: Placed = []
        for key in ("primitives", "meshes"):
            shapes = document.sequence(key, item.get(key, ()))
            places = document.list_of(_POSES[key], item.get(_POSES[key], ()), _placed, count=len(shapes))
            for k, (shape, place) in enumerate(zip(shapes, places, strict=True)):
                with document.within(f"{key}[{k}]"):
                    name = "".join(c if c.isalnum() or c in "-_" else "_" for c in f"{item['id']}_{k}")
                    made = self.primitive(name, shape) if key == "primitives" else self.mesh(name, shape)
                    found.append((made, origin * place))
        if not found:
            raise InputError("has no shape", "primitives")
        return found

    def mesh(self, name: str, data: Mapping[str, Any]) -> Mesh:
        vertices = [(point["x"], point["y"], point["z"]) for point in data["vertices"]]
        faces = [[int(corner) for corner in each["vertex_indices"]] for each in data["triangles"]]
        return written_mesh(self.folder, name, vertices, faces)

    def primitive(self, name: str, data: Mapping[str, Any]) -> Shape:
        kind, sizes = data.get("type"), document.sequence("dimensions", data.get("dimensions", ()))
        counts = {1: 3, 2: 1, 3: 2, 4: 2}
        if kind not in counts:
            raise InputError(f"must be a box (1), sphere (2), cylinder (3) or cone (4), got {kind!r}", "type")
        sizes = list(document.numbers("dimensions", sizes, counts[kind], above=0.0))
        if kind == 4:
            return written_cone(self.folder, name, sizes[1], sizes[0])
        return Box(sizes) if kind == 1 else Sphere(*sizes) if kind == 2 else Cylinder(sizes[1], sizes[0])


def _names(name: str, shapes: Sequence[Any]) -> list[str]:
    return [name] if len(shapes) == 1 else [f"{name}/{k}" for k in range(len(shapes))]


def _frame(item: Mapping[str, Any]) -> str:
    return str(item.get("header", {}).get("frame_id", "")).removeprefix("/")


def _placed(key: str, value: Any) -> pin.SE3:
    with document.within(key):
        return _pose(document.mapping("pose", value))


def _pose(data: Mapping[str, Any], position: str = "position", orientation: str = "orientation") -> pin.SE3:
    """Convert a ROS pose. A quaternion of zeros becomes the identity rotation, as in MoveIt."""
    place, turn = document.mapping(position, data.get(position, {})), data.get(orientation, {})
    quaternion = [document.mapping(orientation, turn).get(name, 0.0) for name in "xyzw"]
    no_turn = all(value == 0 for value in quaternion)
    return Pose([place.get(name, 0.0) for name in "xyz"], (0.0, 0.0, 0.0, 1.0) if no_turn else quaternion).se3


def _leaves(data: bytes, resolution: Any, place: pin.SE3) -> list[Obstacle]:
    """Return the occupied leaves of a binary octree as boxes; `place` is the pose of the tree's origin.

    A node has two bits for each child, with x varying fastest: 01 occupied, 10 free, 11 an inner node. The inner nodes
    follow in depth-first order.
    """
    size = document.number("resolution", resolution, above=0.0)
    boxes: list[tuple[int, ...]] = []
    position = 0

    def node(corner: tuple[int, int, int], edge: int) -> None:
        nonlocal position
        if position + 2 > len(data) or not edge:
            raise InputError(f"is broken or cut off at byte {position}", "data")
        (bits,) = struct.unpack_from("<H", data, position)
        position += 2
        for child in range(8):
            # The first of two bits is the lower one. The value 2 means occupied, 1 means free.
            state = bits >> 2 * child & 3
            low = tuple(corner[axis] + edge * (child >> axis & 1) for axis in range(3))
            if state == 2:
                boxes.append((*low, *(least + edge for least in low)))
            elif state == 3:
                node(low, edge // 2)  # type: ignore[arg-type]

    if data:
        node((-(2 ** (_DEPTH - 1)),) * 3, 2 ** (_DEPTH - 1))
    if position != len(data):
        raise InputError(f"has {len(data)} bytes, {position} expected", "data")
    for axis in range(3):
        boxes = _joined(boxes, axis)
    found = []
    for k, box in enumerate(boxes):
        low, high = size * np.array(box[:3]), size * np.array(box[3:])
        found.append(Obstacle(f"octomap/{k}", Box(high - low), place * pin.SE3(np.eye(3), (low + high) / 2)))
    return found


def _joined(boxes: list[tuple[int, ...]], axis: int) -> list[tuple[int, ...]]:
    """Join boxes (low and high corners) that are adjacent along an axis and have equal extents across it."""
    others = [k for k in range(6) if k % 3 != axis]
    found: list[tuple[int, ...]] = []
    for box in sorted(boxes, key=lambda box: (*(box[k] for k in others), box[axis])):
        last = found[-1] if found else None
        if last and last[axis + 3] == box[axis] and all(last[k] == box[k] for k in others):
            found[-1] = (*last[: axis + 3], box[axis + 3], *last[axis + 4 :])
        else:
            found.append(box)
    return found
