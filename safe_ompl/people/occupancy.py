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

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import (
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    Section,
    finite_array,
    key,
    number,
    whole_number,
)
from safe_ompl.geometry import ConvexBodies, Obstacle, Pose, Sphere
from safe_ompl.geometry.kernels import POSE
from safe_ompl.people.cameras import DepthCamera, DepthFrame
from safe_ompl.people.kernels.cells import Cells, Known, cover, mark, opened, place, spread, within_limbs
from safe_ompl.people.kernels.depth import (
    NODE,
    Errors,
    SeenImage,
    View,
    clear_seen,
    cloud_blocks,
    image_blocks,
    pyramid,
    unexplained,
)
from safe_ompl.people.reach import ReachSets, ReachViolation
from safe_ompl.robot import Robot, plain
from safe_ompl.scene import People, Scene

SEEN, UNSEEN = "something seen", "unseen space"
_SIDE, _WORD = 16, 64  # cells on the sides of grids are multiples of the first; bits of a word
_MOST_CELLS = 128  # on a side
_SHARE = 0.25  # of its distance from the robot that the radius of a ball may be
_MOST_BALLS = 768
_MILLIMETRES = 1e-3  # [m]
_SAMPLES = 4  # along a limb
_MOST = 0.7  # share of the limbs of a person in which something must be seen
_SAME = 1e-9
_DEEP = 0.03  # [m] inside of a body a camera sees nothing
_FEW = 5  # blocks that show something where nothing could be: fewer are noise


@dataclass(frozen=True)
class OccupancyOptions(Section):
    """How an `OccupancyGrid` works; raises InputError if a number is out of its range."""

    speed: float = key(number, default=1.6, at_least=0.0)  # Of all that moves, at most [m/s]
    unseen: str = "occupied"  # What no camera sees within the grid; or "free"
    # How near to the robot or to what stands still points are taken for it, besides noise [m]: errors of joints, of
    # control and of models
    margin: float = key(number, default=0.02, at_least=0.0)
    # Of a block that must show something [px]; fewer are noise
    min_points: int = key(whole_number, default=3, at_least=1)
    # You have looked: what no camera sees within this distance of the robot is free when the first image comes [m]
    clear: float = key(number, default=0.2, at_least=0.0)
    edge: float = key(number, default=0.05, above=0.0)  # Of a cell [m]
    # Half the side of the grid [m]; beyond, all is unseen
    reach: float = key(number, default=1.6, above=0.0)

    def check(self) -> None:
        if self.unseen not in ("occupied", "free"):
            raise InputError(f"must be 'occupied' or 'free', got {self.unseen!r}", "unseen")
        if 2 * self.reach / self.edge > _MOST_CELLS:
            least = 2 * self.reach / _MOST_CELLS
            raise InputError(f"must be at least {least:.3g} for a reach of {self.reach:g} m, got {self.edge:g}", "edge")


class _Camera:
    """A camera, and what it saw last."""

    def __init__(self, camera: DepthCamera) -> None:
        self.camera, self.time = camera, -np.inf
        # Cells of which its last image showed something, and those of them that count even if nothing could be there
        self.hits: IntArray = np.zeros(0, dtype=np.int64)
        self.sure: IntArray = np.zeros(0, dtype=np.int64)
        self.explained: FloatArray = np.zeros(0)
        self.wrong = ""  # Why its last image cannot be true, if it cannot
        self.pose: Pose | None = None  # of its last image
        self._windows: IntArray = np.zeros(0, dtype=np.intp)
        self._radius = 0.0  # that these are of

    def windows(self, radius: float, side: int) -> IntArray:
        """Return what `clear_seen` remembers of this pose and radius."""
        if radius != self._radius or not len(self._windows):
            self._windows, self._radius = np.zeros(side**3 + (side // NODE) ** 3, dtype=np.intp), radius
        return self._windows

    def forget(self, pose: Pose) -> None:
        """Forget what was explained unless the camera stands still."""
        if self.pose != pose:
            rows, columns = self.camera.height // self.camera.block, self.camera.width // self.camera.block
            self.explained = np.full((rows, columns, 4), np.inf)
            self.pose, self._windows = pose, self._windows[:0]


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
        middle = robot.joint_frames(np.zeros((1, robot.n)))[1][0, 0]
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
        robot_bodies: IntArray = np.flatnonzero(joints > 0).astype(np.intp)
        self._all = _packed(np.ones((side,) * 3, dtype=bool))
        poses = np.zeros(len(bodies.bodies), POSE)
        self._known = Known(bodies.shapes, poses, robot_bodies, fixed.astype(np.intp), self._all)
        self._q: FloatArray = np.zeros(0)  # where the robot is placed
        self._marked = np.zeros_like(self._all)  # cells that are near to it there
        self._place(np.zeros(robot.n), moving=False)
        shapes = robot.shared.collision_model.geometryObjects
        self._deep = [g for g in robot_bodies.tolist() if _depth(shapes[g].geometry, own.bodies[g]["centre"]) > _DEEP]
        self._walls = mark(self._known, self._known.still, self.cells, 0.0)
        self._space = self._all & ~self._walls
        border = np.pad(np.zeros((side - 2,) * 3, dtype=bool), 1, constant_values=True)
        self._beyond = _packed(border) & self._space
        # Where something that moves may be, and of it what was seen, as bits; at first everywhere
        self._may = self._space if options.unseen == "occupied" else np.zeros_like(self._all)
        self._hit: IntArray = np.zeros_like(self._all)

    def __repr__(self) -> str:
        return f"OccupancyGrid({len(self.cameras)} cameras, {self.cells.side}³ cells of {self.cells.edge:g} m)"

    @property
    def known(self) -> bool:
        """Whether every camera has seen something."""
        return all(np.isfinite(one.time) for one in self._seen.values())

    @property
    def occupied(self) -> BoolArray:
        """Cells (N, N, N) in which something that moves may be."""
        bits = np.unpackbits(self._may.view(np.uint8), axis=-1, count=self.cells.side, bitorder="little")
        return np.asarray(bits.view(np.bool_))

    # -------------------------------------------------------------------------------------------------- known bodies

    def _place(self, q: FloatArray, *, moving: bool) -> None:
        """Place the bodies that joints carry at q (n,), or those that none does."""
        rotations, origins = self.robot.joint_frames(q[None])[:2]
        place(self._known.shapes, self._known.poses, plain(rotations[0]), plain(origins[0]), moving)

    def _stand(self, q: FloatArray) -> None:
        """Place the robot at q (n,), and mark the cells near to it."""
        if not np.array_equal(q, self._q):
            self._q = q.copy()
            self._place(q, moving=True)
            self._marked = mark(self._known, self._known.robot, self.cells, self.options.margin)
            self._known = self._known._replace(cells=_grown(self._marked | self._walls, 1, self._all))

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
        one.forget(pose)
        self._stand(q)
        if options.unseen == "occupied" and not np.isfinite(self.time):
            self._may = self._may & (~mark(self._known, self._known.robot, self.cells, options.clear) | self._beyond)
        possible = self._advance(time)
        errors = Errors(options.margin + camera.error, (float(camera.noise[0]), float(camera.noise[1])))
        hits, strange, clear = unexplained(
            view, depths, where, (camera.height, camera.width), self._known, errors, one.explained, self.cells, possible
        )
        image = SeenImage(view, *pyramid(clear))
        fast = self.known and strange >= _FEW
        self._take(one, time, image, hits, fast)
        violation = ReachViolation(SEEN, "", self.cells.edge) if fast else None
        one.wrong = self._looks_through(name, view, depths) or str(violation or "")
        return violation

    def _blocks(self, camera: DepthCamera, view: View, given: ArrayLike) -> tuple[FloatArray, IntArray]:
        """Return depths and pixels of the blocks of an image or a cloud."""
        array = np.asarray(given)
        size, few = (camera.height, camera.width), self.options.min_points
        near, far = float(camera.near), float(camera.far)
        if array.dtype.kind not in "fiu":
            raise InputError(f"must be numbers, got {array.dtype}", "depths")
        if array.ndim == 2 and array.shape[1] == 3 != camera.width:
            return cloud_blocks(plain(array), view, size, few, near, far)
        if array.shape != size:
            raise InputError(f"must have shape {size} or (N, 3), got {array.shape}", "depths")
        image = np.require(array, np.float32, ["C", "W"])
        if array.dtype.kind == "u":
            image *= np.float32(_MILLIMETRES)
        return image_blocks(image, camera.block, few, near, far)

    def _advance(self, time: float) -> IntArray:
        """Let all that moves go on to a time [s]; return the cells in which an image of that time may show something.

        Where the times of images are in order, all that moves is a cell farther than that at most: a point may be
        anywhere in its cell.
        """
        before, self.time = self.time, max(time, self.time)
        if self.options.unseen == "free":
            self._may = np.zeros_like(self._all)
            return self._all
        steps = self._steps(self.time - before) if np.isfinite(before) else 0
        self._may = _grown(self._may, steps, self._space) & self._space
        return _grown(self._may | self._marked | self._walls, 1 + self._steps(self.time - time), self._all)

    def _take(self, one: _Camera, time: float, image: SeenImage, hits: IntArray, fast: bool) -> None:
        """Take what an image says, `fast`: it shows something where nothing could be."""
        first, one.time, occupied = np.isinf(one.time), time, self._may.copy()
        if self.options.unseen == "occupied":
            late = self.time - time
            radius = np.sqrt(0.75) * self.cells.edge + one.camera.error + self.options.speed * late
            clear_seen(image, self.cells, radius, one.windows(radius, self.cells.side), occupied)
            if not late:  # or the robot is elsewhere by now
                occupied &= ~self._marked
        sure = fast or first or self.options.unseen == "free"
        one.hits, one.sure = hits, hits if sure else hits & (self._marked | self._walls)
        self._hit, certain = np.zeros_like(occupied), np.zeros_like(occupied)
        for other in self._seen.values():
            if np.isfinite(other.time):
                steps = self._steps(self.time - other.time)
                self._hit |= _grown(other.hits, steps, self._all)
                certain |= _grown(other.sure, steps, self._all)
        self._may = opened(occupied) | (occupied & self._hit) | certain
        if self.options.unseen == "occupied":
            self._may |= self._beyond

    def _steps(self, time: float) -> int:
        """Return by how many cells something may come nearer in a time [s]."""
        return min(ceil(self.options.speed * time / self.cells.edge - _SAME), self.cells.side)

    def _looks_through(self, name: str, view: View, depths: FloatArray) -> str:
        """Return which body of the robot the camera sees through: its pose, lens, or the joints are not as given."""
        noise = self.cameras[name].noise
        for g in self._deep:
            x, y, z = view.rotation.T @ (self._known.poses["centre"][g] - view.origin)
            if z <= 0.1:
                continue
            u, v = (f * at / z + c + 0.5 for f, at, c in zip(view.focal, (x, y), view.middle, strict=True))
            i, j = int(v // view.block), int(u // view.block)
            if min(i, j) < 0 or i >= len(depths) or j >= depths.shape[1]:
                continue
            if depths[i, j] - (noise[0] + noise[1] * depths[i, j] ** 2) > z:
                link = self.robot.shared.body_links[g]
                return f"{name!r} sees through {link}: its pose or lens, or the joints are not as given"
        return ""

    # --------------------------------------------------------------------------------------------------------- sets

    def sets(self, now: float, limbs: ReachSets | None = None) -> ReachSets:
        """Return where things may be from a time on [s].

        Within limbs of people as they are tracked then, and all errors, they go no farther than these where anything
        was seen, if it was in most limbs of the person, and no camera looks through one.
        """
        if not np.isfinite(self.time):
            return ReachSets.none()
        front = self._may & _grown(self._space & ~self._may, 1, self._all)
        places, radii, lines = self._tracked(ReachSets.none() if limbs is None else limbs)
        others = front & ~within_limbs(places, radii, self.cells, front)[0]
        found, kinds = cover(front, self._hit, others, self.cells, self._known, _SHARE, _MOST_BALLS)
        names = tuple((SEEN if each & 1 else UNSEEN, "") for each in kinds.tolist())
        speed, age = self.options.speed, max(now - self.time, 0.0)
        growth = np.tile([speed * age, speed], (len(found), 1 + lines.shape[1] * bool(len(lines)), 1))
        people = np.flatnonzero(kinds & 2 == 0)
        if len(people):
            ways = places[:, 1] - places[:, 0]
            from_start = found[people, None, :3] - places[:, 0]
            shares = (from_start * ways).sum(axis=2) / np.maximum((ways * ways).sum(axis=1), _SAME)
            away = np.linalg.norm(from_start - np.clip(shares, 0.0, 1.0)[..., None] * ways, axis=2)
            near = away <= radii + found[people, 3, None] + _SAME
            growth[people, 1:] = np.where(near[..., None, None], lines, 0.0).max(axis=1) @ [[1.0, 0.0], [age, 1.0]]
        return ReachSets.of(names, plain(found[:, None, :3]), found[:, 3].copy(), growth)

    def _tracked(self, limbs: ReachSets) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return ends (M, 2, 3), radii with all errors and lines (M, L, 2) of limbs of people that may be there."""
        ends, slack, edge = limbs.points.reshape(-1, 2, 3), limbs.grown(0.0), self.cells.edge
        errors = np.zeros(len(ends))
        for one in self._seen.values():
            if one.pose is not None:
                far, (still, rising) = ends.mean(axis=1) - one.pose.position, one.camera.noise
                errors = np.maximum(errors, one.camera.error + still + rising * (far * far).sum(axis=1))
        points = ends[:, :1] + np.linspace(0.0, 1.0, _SAMPLES)[:, None] * (ends[:, 1:] - ends[:, :1])
        place = np.floor((points - self.cells.low) / edge).astype(np.intp)
        i, j, k = np.moveaxis(np.clip(place, 0, self.cells.side - 1), 2, 0)
        taken = _grown(self._may | self._marked | self._walls, 1, self._all)
        held = (taken[i, j, k // _WORD] >> k % _WORD & 1 > 0) | ((place < 0) | (place >= self.cells.side)).any(axis=2)
        radii = plain(limbs.radii + slack + errors + np.sqrt(0.75) * edge)
        shown, known = within_limbs(plain(ends), radii, self.cells, self._hit)[1], slack <= edge
        kept = shown & known
        for who in {name for name, _ in limbs.names}:
            own = np.array([name == who for name, _ in limbs.names]) & known
            kept[own] &= np.count_nonzero(shown[own]) > _MOST * np.count_nonzero(own) and bool(held[own].all())
        return plain(ends[kept]), plain(radii[kept]), limbs.growth[kept]

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


def _packed(cells: BoolArray) -> IntArray:
    """Return cells (N, N, N) as bits (N, N, W) of words; the first one is the lowest."""
    bits = np.packbits(cells, axis=-1, bitorder="little")
    room = np.zeros((*cells.shape[:2], ceil(len(cells) / _WORD) * _WORD // 8), dtype=np.uint8)
    room[..., : bits.shape[-1]] = bits
    return room.view(np.int64)


def _grown(cells: IntArray, steps: int, among: IntArray) -> IntArray:
    """Return cells and those that so many steps lead to, across edges and corners, too, if none leaves `among`."""
    found = cells
    if steps:
        found = cells.copy()
        spread(found, among, steps)
    return found
