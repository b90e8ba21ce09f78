"""What depth cameras see and do not see, as cells from which something may come, without knowing what it is.

A grid of cells about the robot says where something that moves may be. With `unseen="occupied"` this is a set O with

    O(t) = (O(t₀), grown by speed · (t − t₀)) − what a camera sees to be free at t,

so that nothing that is no faster than the speed is ever outside of it: an image takes away only cells that lie wholly
in front of all that it shows, and what it does not show stays, or comes in from the side. Everything is in O at first,
and what is beyond the grid always. With `unseen="free"` O are the points of the newest image of each camera, grown by
its age. What moves can leave O only through a cell that touches free ones: balls about these are the reach sets.

Cells within `margin` of still obstacles or of the robot, where it was measured, belong to these and not to O, unless an
image shows points in them that are farther from the obstacles and from the robot. So all that an image shows is taken
for something else than the robot but for a shell of `margin` and the noise; where no camera looks, what is within a
cell (√3 edges and the margin) of the robot or an obstacle may be missed. Nothing grows through cells of obstacles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray, finite_array, number
from safe_ompl.geometry import ConvexBodies, Obstacle, Pose, Sphere
from safe_ompl.geometry.kernels import POSE
from safe_ompl.people.cameras import DepthCamera, DepthFrame
from safe_ompl.people.kernels.depth import (
    NODE,
    Cells,
    Known,
    SeenImage,
    View,
    clear_seen,
    cloud_blocks,
    cover,
    image_blocks,
    mark,
    place,
    pyramid,
    spread,
    unexplained,
)
from safe_ompl.people.reach import ReachSets, ReachViolation
from safe_ompl.robot import Robot, plain
from safe_ompl.scene import People, Scene

SEEN, UNSEEN = "something seen", "unseen space"
_SIDE = _WORD = 16  # cells on the sides of grids are multiples of a word of bits
_MOST_CELLS = 128  # on a side
_SHARE = 0.25  # of its distance from the robot that the radius of a ball may be
_MOST_BALLS = 768
_MILLIMETRES = 1e-3  # [m]
_SAME = 1e-9
_DEEP = 0.03  # [m] inside of a body a camera sees nothing
_FEW = 5  # blocks that show something where nothing could be: fewer are noise
_HIT = 2  # mark of cells, beside 1


@dataclass(frozen=True)
class OccupancyOptions:
    """How an `OccupancyGrid` works; raises InputError if a number is out of its range."""

    speed: float = 1.6  # Of all that moves, at most [m/s]
    unseen: str = "occupied"  # What no camera sees within the grid; or "free"
    # How near to the robot or to what stands still points are taken for it, besides noise [m]: errors of joints, of
    # control and of models
    margin: float = 0.02
    min_points: int = 3  # Of a block that must show something [px]; fewer are noise
    # You have looked: what no camera sees within this distance of the robot is free when the first image comes [m]
    clear: float = 0.2
    edge: float = 0.05  # Of a cell [m]
    reach: float = 1.6  # Half the side of the grid [m]; beyond, all is unseen

    def __post_init__(self) -> None:
        for key in ("speed", "margin", "clear"):
            number(key, getattr(self, key), at_least=0.0)
        if self.unseen not in ("occupied", "free"):
            raise InputError(f"must be 'occupied' or 'free', got {self.unseen!r}", "unseen")
        number("min_points", self.min_points, at_least=1)
        number("edge", self.edge, above=0.0)
        number("reach", self.reach, above=0.0)
        if 2 * self.reach / self.edge > _MOST_CELLS:
            least = 2 * self.reach / _MOST_CELLS
            raise InputError(f"must be at least {least:.3g} for a reach of {self.reach:g} m, got {self.edge:g}", "edge")


class _Camera:
    """A camera, and what it saw last."""

    def __init__(self, camera: DepthCamera) -> None:
        self.camera, self.time = camera, -np.inf
        # Cells of which its last image showed something, and those of them that count even if nothing could be there
        self.hits: BoolArray = np.zeros(0, dtype=bool)
        self.sure: BoolArray = np.zeros(0, dtype=bool)
        self.explained: FloatArray = np.zeros(0)
        self.wrong = ""  # Why its last image cannot be true, if it cannot
        self._pose: Pose | None = None
        self._windows: IntArray = np.zeros(0, dtype=np.intp)
        self._radius = 0.0  # that these are of

    def windows(self, radius: float, side: int) -> IntArray:
        """Return what `clear_seen` remembers of this pose and radius."""
        if radius != self._radius or not len(self._windows):
            self._windows, self._radius = np.zeros(side**3 + (side // NODE) ** 3, dtype=np.intp), radius
        return self._windows

    def forget(self, pose: Pose) -> None:
        """Forget what was explained unless the camera stands still."""
        if self._pose != pose:
            rows, columns = self.camera.height // self.camera.block, self.camera.width // self.camera.block
            self.explained = np.full((rows, columns, 4), np.inf)
            self._pose, self._windows = pose, self._windows[:0]


class OccupancyGrid:
    """Where something that moves may be, as depth cameras see it; `Surroundings(…, depth=grid)` takes it.

    Parameters
    ----------
    robot : Robot
        The robot, with what it holds: cameras see it, and what they see of it is left out.
    still : Scene
        What stands still.
    cameras : mapping of str to DepthCamera
        The cameras.
    options : OccupancyOptions, optional
        Speeds, what is assumed of what is not seen, sizes.

    Raises
    ------
    InputError
        If there is no camera.
    """

    def __init__(
        self, robot: Robot, still: Scene, cameras: Mapping[str, DepthCamera], options: OccupancyOptions | None = None
    ) -> None:
        self.options = options = OccupancyOptions() if options is None else options
        if not cameras:
            raise InputError("give one at least", "cameras")
        self.robot, self.still = robot, still
        self.cameras = dict(cameras)
        self._seen = {name: _Camera(camera) for name, camera in cameras.items()}
        for name, camera in cameras.items():
            if options.min_points > camera.block**2:
                raise InputError(f"is more than the {camera.block**2} pixels of a block of {name!r}", "min_points")
        self.time = -np.inf  # of the newest image [s]
        side = _SIDE * ceil(2 * options.reach / options.edge / _SIDE - _SAME)
        frames = robot.kinematics.frames(robot.coupling.values(np.zeros((1, robot.n))))
        middle = frames[1][0, 0]
        self.cells = Cells(middle - 0.5 * side * options.edge, options.edge, side)
        parts = [
            pin.GeometryObject(name, 0, pose, geometry)
            for obstacle in still
            for name, geometry, pose in obstacle.geometries()
        ]
        looked = [
            pin.GeometryObject("point", 0, pin.SE3.Identity(), coal.Sphere(0.0)),
            pin.GeometryObject("cell", 0, pin.SE3.Identity(), coal.Box(*[options.edge] * 3)),
        ]
        own = robot.bounds.convex_bodies
        static = ConvexBodies.of(parts)
        bodies = own.joined(static).joined(ConvexBodies.of(looked))
        count, joints = len(own.bodies), own.bodies["joint"]
        fixed = np.append(np.flatnonzero(joints == 0), count + np.flatnonzero(static.exact))
        self._marked: BoolArray = np.zeros((side,) * 3, dtype=bool)
        robot_bodies: IntArray = np.flatnonzero(joints > 0).astype(np.intp)
        self._known = Known(
            bodies.shapes, np.zeros(len(bodies.bodies), POSE), robot_bodies, fixed.astype(np.intp), self._marked
        )
        self._place(np.zeros(robot.n), moving=False)
        shapes = robot.shared.collision_model.geometryObjects
        self._deep = [g for g in robot_bodies.tolist() if _depth(shapes[g].geometry, own.bodies[g]["centre"]) > _DEEP]
        self._walls = self._near(self._known.still, 0.0)
        self._beyond = _border(side) & ~self._walls
        # Where something that moves may be (N, N, N); at first everywhere
        self.occupied = np.full((side,) * 3, options.unseen == "occupied") & ~self._walls
        self._hit: BoolArray = np.zeros((side,) * 3, dtype=bool)  # of it what was seen

    def __repr__(self) -> str:
        return f"OccupancyGrid({len(self.cameras)} cameras, {self.cells.side}³ cells of {self.cells.edge:g} m)"

    @property
    def known(self) -> bool:
        """Whether every camera has seen something."""
        return all(np.isfinite(one.time) for one in self._seen.values())

    # -------------------------------------------------------------------------------------------------- known bodies

    def _place(self, q: FloatArray, *, moving: bool) -> None:
        """Place the bodies that joints carry at q (n,), or those that none does."""
        rotations, origins = self.robot.kinematics.frames(self.robot.coupling.values(q[None]))[:2]
        place(self._known.shapes, self._known.poses, plain(rotations[0]), plain(origins[0]), moving)

    def _near(self, bodies: IntArray, margin: float) -> BoolArray:
        """Return the cells within a margin of some bodies [m]."""
        found: BoolArray = np.zeros((self.cells.side,) * 3, dtype=bool)
        mark(self._known.shapes, self._known.poses, bodies, self.cells, margin, found)
        return found

    # ------------------------------------------------------------------------------------------------------- images

    def observe(self, name: str, frame: DepthFrame, now: float) -> ReachViolation | None:
        """Take an image that is not newer than `now` [s], and return what came faster than was promised.

        Images of a camera are in order; one of another camera may come late. Raises InputError if an image or its time
        cannot be used; nothing changes then.
        """
        one, options = self._seen[name], self.options
        camera, time = one.camera, number("time", frame.time)
        if time > now + _SAME:
            raise InputError(f"is {time - now:.3f} s in the future", "time")
        if time <= one.time:
            raise InputError(f"must not go backwards: {time:g} s after {one.time:g} s", "time")
        q = finite_array(frame.q, (self.robot.n,), "q")
        pose = camera.pose if frame.pose is None else frame.pose
        place = pose.se3
        (fx, fy), (cx, cy) = camera.focal, camera.middle
        rotation, origin = np.array(place.rotation, order="C"), np.array(place.translation)
        view = View((float(fx), float(fy)), (float(cx), float(cy)), camera.block, rotation, origin)
        depths, where = self._blocks(camera, view, frame.depths)
        if not depths.any():
            raise InputError(f"shows nothing between {camera.near:g} and {camera.far:g} m", "depths")
        first = not np.isfinite(self.time)
        one.forget(pose)
        self._place(q, moving=True)
        self._marked = marked = self._near(self._known.robot, options.margin)
        noise = camera.noise[0] + camera.noise[1] * depths**2
        margins = options.margin + camera.error + noise
        size = camera.height, camera.width
        known = self._known._replace(cells=_grown(marked | self._walls, 1))
        hits, owns = unexplained(view, depths, where, size, known, margins, one.explained, self.cells)
        known_to = depths - noise + np.where(owns, np.sqrt(3.0) * options.edge, 0.0)
        image = SeenImage(view, *pyramid(np.maximum(known_to, 0.0)))
        if first and options.unseen == "occupied":
            self.occupied &= ~self._near(self._known.robot, options.clear) | self._beyond
        fast = self._advance(one, time, image, hits, marked)
        violation = ReachViolation(SEEN, "", self.cells.edge) if fast else None
        one.wrong = self._looks_through(name, view, depths - noise) or str(violation or "")
        return violation

    def _blocks(self, camera: DepthCamera, view: View, given: ArrayLike) -> tuple[FloatArray, IntArray]:
        """Return depths and pixels of the blocks of an image or a cloud."""
        array = np.asarray(given)
        size, few = (camera.height, camera.width), self.options.min_points
        near, far = float(camera.near), float(camera.far)
        if array.dtype.kind not in "fiu":
            raise InputError(f"must be numbers, got {array.dtype}", "depths")
        if array.ndim == 2 and array.shape[1] == 3 != camera.width:
            points = np.ascontiguousarray(array, dtype=np.float64)
            return cloud_blocks(plain(points), view, size, few, near, far)
        if array.shape != size:
            raise InputError(f"must have shape {size} or (N, 3), got {array.shape}", "depths")
        image = array.astype(np.float32)
        if array.dtype.kind == "u":
            image *= np.float32(_MILLIMETRES)
        return image_blocks(image, camera.block, few, near, far)

    def _advance(self, one: _Camera, time: float, image: SeenImage, counts: IntArray, marked: BoolArray) -> bool:
        """Take what an image says; return whether it shows something where nothing could be."""
        first = np.isinf(one.time)
        before, one.time, hits = self.time, time, counts > 0
        self.time = max(time, before)
        grown = self._steps(self.time - before) if np.isfinite(before) else 0
        taken, fast = marked | self._walls, False
        occupied = np.zeros_like(self.occupied)
        if self.options.unseen == "occupied":
            occupied = _grown(self.occupied, grown, ~self._walls) & ~self._walls
            late = 1 + self._steps(self.time - time)
            fast = self.known and not first and counts[hits & ~_grown(occupied | taken, late)].sum() >= _FEW
            radius = np.sqrt(0.75) * self.cells.edge + one.camera.error + self.options.speed * (self.time - time)
            clear_seen(image, self.cells, radius, one.windows(radius, self.cells.side), occupied)
            if time == self.time:  # the robot is elsewhere by now
                occupied &= ~marked
        sure = fast or first or self.options.unseen == "free"
        one.hits, one.sure = hits, hits if sure else hits & taken
        self._hit, certain = np.zeros_like(occupied), np.zeros_like(occupied)
        for other in self._seen.values():
            if np.isfinite(other.time):
                steps = self._steps(self.time - other.time)
                self._hit |= _grown(other.hits, steps)
                certain |= _grown(other.sure, steps)
        self.occupied = _opened(occupied) | (occupied & self._hit) | certain
        if self.options.unseen == "occupied":
            self.occupied |= self._beyond
        return fast

    def _steps(self, time: float) -> int:
        """Return by how many cells something may come nearer in a time [s]."""
        return min(ceil(self.options.speed * time / self.cells.edge - _SAME), self.cells.side)

    def _looks_through(self, name: str, view: View, depths: FloatArray) -> str:
        """Return which body of the robot the camera sees through: its pose, lens, or the joints are not as given."""
        for g in self._deep:
            x, y, z = view.rotation.T @ (self._known.poses["centre"][g] - view.origin)
            if z <= 0.1:
                continue
            u, v = (f * at / z + c + 0.5 for f, at, c in zip(view.focal, (x, y), view.middle, strict=True))
            i, j = int(v // view.block), int(u // view.block)
            if min(i, j) >= 0 and i < len(depths) and j < depths.shape[1] and depths[i, j] > z:
                link = self.robot.shared.collision_model.geometryObjects[g].name.rsplit("_", 1)[0]
                return f"{name!r} sees through {link}: its pose or lens, or the joints are not as given"
        return ""

    # --------------------------------------------------------------------------------------------------------- sets

    def sets(self, now: float) -> ReachSets:
        """Return where things may be from a time on [s]."""
        if not np.isfinite(self.time):
            return ReachSets.none()
        front = (self.occupied & _grown(~self.occupied & ~self._walls, 1)).astype(np.uint8)
        front |= np.uint8(_HIT) * (front & self._hit)
        found, marks = cover(front, self.cells, self._known, _SHARE, _MOST_BALLS)
        names = tuple((SEEN if each & _HIT else UNSEEN, "") for each in marks.tolist())
        speed = self.options.speed
        growth = np.tile([[[speed * max(now - self.time, 0.0), speed]]], (len(found), 1, 1))
        return ReachSets.of(names, plain(found[:, None, :3]), found[:, 3].copy(), growth)

    def check_scene(self, still: Scene) -> None:
        """Raise InputError unless this is what stands still for the grid."""
        if self.still != still:
            raise InputError(f"stand still for the grid: {self.still.names}, but here: {still.names}", "depth")

    def people(self, rules: People | None = None) -> tuple[Scene, People | None]:
        """Return what stands still among balls that hold all that may move, as the last images show it, and these.

        They are as fast as the grid says, and must not be touched; all else is as the rules have it. None: there are
        none. For `check`, `time_path` and whatever takes people. Raises InputError if there is no image of a camera, or
        one cannot be true.
        """
        why = self.trouble(max(self.time, 0.0), np.inf)
        if why is not None:
            raise InputError(why, "depth")
        sets = self.sets(self.time)
        balls = [
            Obstacle(f"{who} {k}", Sphere(radius), Pose(tuple(at)), weight=0.0)
            for k, ((who, _), at, radius) in enumerate(
                zip(sets.names, sets.points.tolist(), sets.radii.tolist(), strict=True)
            )
        ]
        if not balls:
            return self.still, None
        own = replace(rules or People(), who=tuple(ball.name for ball in balls), contact=False, reach=None)
        return self.still.with_obstacles(*balls), replace(own, speed=self.options.speed, speeds={})

    def trouble(self, now: float, lost_after: float) -> str | None:
        """Return why the robot must stop, if it must."""
        for name, one in self._seen.items():
            age = now - one.time
            if np.isinf(age) or (age > lost_after and self.options.unseen == "free"):
                return f"{name!r} shows nothing " + ("yet" if np.isinf(age) else f"for {age:.2f} s")
            if one.wrong:
                return one.wrong
        return None


def _depth(shape: coal.CollisionGeometry, point: FloatArray) -> float:
    """Return how deep a point is inside a convex shape [m]; 0 for others."""
    if not isinstance(shape, coal.ShapeBase):
        return 0.0
    there, result = coal.Transform3s(np.eye(3), point), coal.DistanceResult()
    ball = coal.Sphere(_SAME)
    return -float(coal.distance(shape, coal.Transform3s(), ball, there, coal.DistanceRequest(), result))


def _border(side: int) -> BoolArray:
    """Return the outermost cells of a grid."""
    found: BoolArray = np.ones((side,) * 3, dtype=bool)
    found[1:-1, 1:-1, 1:-1] = False
    return found


def _along(cells: BoolArray, axis: int) -> Any:
    """Return cells (N, N, N) with an axis first, eight in a word; or, along the last axis, in one row."""
    return cells.reshape(-1) if axis == 2 else np.swapaxes(cells.view(np.uint64), 0, axis)


def _grown(cells: BoolArray, steps: int, among: BoolArray | None = None) -> BoolArray:
    """Return cells and those that so many steps lead to, across edges and corners, too, if none leaves `among`."""
    if not steps:
        return cells
    words = _packed(cells)
    spread(words, _packed(np.ones_like(cells) if among is None else among), steps)
    bits = np.unpackbits(words.reshape(-1).view(np.uint8), bitorder="little")
    return np.asarray(bits.view(np.bool_).reshape(cells.shape))


def _packed(cells: BoolArray) -> NDArray[np.uint16]:
    """Return cells (N, N, N) as bits (N, N, N / 16), the first one of each word the lowest."""
    bits = np.packbits(cells.reshape(-1), bitorder="little")
    return bits.view("<u2").reshape(*cells.shape[:2], -1)


def _opened(cells: BoolArray) -> BoolArray:
    """Return the cells that are in a cube of 2 × 2 × 2 of them."""
    core = cells.copy()
    for axis in range(3):
        before = core.copy()
        _along(core, axis)[:-1] &= _along(before, axis)[1:]
        np.swapaxes(core, 0, axis)[-1] = False
    for axis in range(3):
        before = core.copy()
        _along(core, axis)[1:] |= _along(before, axis)[:-1]
    return core
