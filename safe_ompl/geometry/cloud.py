"""Point clouds as obstacles: balls around the points; in large clouds, the grid cells that the balls touch."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sized
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, IntArray, documents as document, float_array, key, warn_once
from safe_ompl.geometry import surfaces
from safe_ompl.geometry.cells import SINGLE_ROUNDING, Voxels
from safe_ompl.geometry.meshes import PLY_SURFACES, read_ply
from safe_ompl.geometry.pose import LONGEST, Pose, placed
from safe_ompl.geometry.shapes import Part, Shape, Sphere, array_digest
from safe_ompl.geometry.surfaces import Triangles

_log = logging.getLogger(__name__)

# A cloud with more points than this collides as one solid of cells instead of one ball per point.
_MOST_BALLS = 32
_LEAST_RADIUS = 1e-4  # [m]
# If half of the points are farther from the origin than this, the unit is probably wrong.
_UNLIKELY = 50.0  # [m]
# Minimal edge of a cell, as a share of the radius. Smaller cells would be many, and hardly tighter.
_FINEST = 0.125
# Limit of the occupied cells with an edge of half a radius.
_FEW_CELLS = 5_000
# Limit of the occupied cells with a longer edge.
_MANY_CELLS = 60_000
# An OcTree of coal has this many cells on each side of its origin, along each axis.
_HALF_DEPTH = 1 << 15
# A ball counts as touching a cell if their distance is below this share of the radius.
_TOUCHING = 1e-9
# A grid of at most this many cells is stored as a table of booleans.
_TABLE = 1 << 25
# A drawn ball has this many corners on each circle.
_CORNERS = 6
_MESSAGE_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # `datatype` of a PointCloud2


def _points(key: str, value: Any) -> FloatArray:
    if isinstance(value, Sized) and not len(value):
        raise InputError("the point cloud is empty", key)
    return _finite(float_array(value, (None, 3), key), key)


@dataclass(frozen=True, eq=False)
class PointCloud(Shape):
    """A point cloud, in which each point is the centre of a ball.

    Points with NaN or infinity, which cameras send for missing measurements, are dropped. The log gives their number.

    Parameters
    ----------
    radius : float
        Radius of the ball around each point [m], at least 0.0001.
    file : path-like, optional
        A PLY file (ASCII or binary), or an NPY file with an array of shape (N, 3).
    points : array_like, shape (N, 3), optional
        The points [m], instead of a file. They are stored as a read-only array.
    resolution : float, optional
        Edge of the cells that cover the balls [m], at least an eighth of the radius. Default: half the radius, doubled
        until the number of cells is small. An edge above the radius is logged.

    Raises
    ------
    InputError
        If there is no finite point, a point is farther than 10 000 m away, or a value cannot be used.

    Notes
    -----
    Up to 32 points collide exactly, as balls. A larger cloud collides as the union of all grid cells that a ball
    touches (a `coal.OcTree`). The cells contain the balls, so collision queries (with or without margin) and distance
    queries are conservative. Each point of a cell is within √3·`resolution` of a ball, so distances are underestimated
    by at most this.

    The danger points are points of the cloud, thinned to the spacing.

    Examples
    --------
    >>> PointCloud(radius=0.02, points=[[0.6, 0.1, 0.5], [0.62, 0.1, 0.5]])
    PointCloud(radius=0.02, points=<2 points>)
    """

    kind: ClassVar[str] = "pointcloud"
    radius: float = key(document.number, at_least=_LEAST_RADIUS, at_most=LONGEST)
    file: Path | None = key(document.file, default=None, endings=(".ply", ".npy"))
    points: ArrayLike | None = key(_points, default=None)
    resolution: float | None = key(document.number, default=None, at_most=LONGEST)

    # Type checkers see the types of the arguments. The fields hold what the arguments are converted to.
    if TYPE_CHECKING:

        def __init__(
            self,
            radius: float,
            file: str | Path | None = ...,
            points: ArrayLike | None = ...,
            resolution: float | None = ...,
        ) -> None: ...

    def check(self) -> None:
        """Raise InputError unless the cloud has points, and a resolution that fits the radius."""
        if (self.points is None) == (self.file is None):
            raise InputError("give either points or file, one of the two", "points")
        self.centres  # noqa: B018 (reads and checks the file now, so that it is needed no more)
        if self.resolution is not None:
            document.number("resolution", self.resolution, at_least=_FINEST * self.radius, at_most=LONGEST)

    @classmethod
    def from_message(cls, message: Any, radius: float, *, resolution: float | None = None) -> PointCloud:
        """Convert a ROS `sensor_msgs/PointCloud2` message, or a mapping with its keys, to a cloud, without ROS.

        Points are in the frame of the message. The pose of the obstacle is the pose of this frame in the world. Raises
        InputError if the message has no x, y and z, its sizes contradict each other, or no point is finite.
        """
        return cls(radius, points=_message_points(message), resolution=resolution)

    @cached_property
    def centres(self) -> FloatArray:
        """The finite points (N, 3) [m], read-only."""
        if self.file is None:
            return np.asarray(self.points)
        return _finite(_READERS[self.file.suffix.lower()](self.file), "file")

    def __repr__(self) -> str:
        source = f"points=<{len(self.centres)} points>" if self.file is None else f"file={str(self.file)!r}"
        resolution = "" if self.resolution is None else f", resolution={self.resolution!r}"
        return f"PointCloud(radius={self.radius:g}, {source}{resolution})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, PointCloud):
            return NotImplemented
        mine, its = ((c.radius, c.file, c.resolution) for c in (self, other))
        return mine == its and np.array_equal(self.centres, other.centres)

    def __hash__(self) -> int:
        return hash((self.radius, self.file, self.resolution, self.centres.tobytes()))

    def with_measurement(self, measured: Any, pose: Pose) -> PointCloud:
        """Return the cloud with other points (N, 3) [m], given in the world frame."""
        points = _points("points", measured)
        own = placed(pose.se3.inverse(), points) if pose != Pose() else points
        return PointCloud(self.radius, points=own, resolution=self.resolution)

    def same_body(self, other: Shape) -> bool:
        """Return whether another cloud has the same radius and resolution."""
        sizes = self.radius, self.resolution
        return isinstance(other, PointCloud) and (other.radius, other.resolution) == sizes

    def parts(self) -> list[Part]:
        count = len(self.centres)
        if count > _MOST_BALLS:
            return [self._solid]
        return [
            Part(str(k) if count > 1 else "", coal.Sphere(self.radius), pin.SE3(np.eye(3), centre))
            for k, centre in enumerate(self.centres)
        ]

    @cached_property
    def _solid(self) -> Part:
        """The cells as one geometry, cached because building it is slow."""
        edge = self.cell_edge
        return cell_tree(touched_cells(self.centres, self.radius, edge), edge)

    @cached_property
    def cell_edge(self) -> float:
        """Edge of the cells that cover a large cloud [m]: `resolution`, or its default for the number of points."""
        if self.resolution is not None:
            return self.resolution
        edge = self.radius / 2
        while _count_cells(self.centres, edge) > (_FEW_CELLS if edge < self.radius else _MANY_CELLS):
            edge *= 2
        if edge > self.radius:
            _log.info(
                "cloud of %d points, radius %g m: collides as cells of %g m; give a resolution for others",
                *(len(self.centres), self.radius, edge),
            )
        return edge

    def most_danger_points(self, spacing: float) -> float:
        return float(len(self.centres))

    def danger_points(self, spacing: float) -> FloatArray:
        """Return points (M, 3) of the cloud such that each other point is within `spacing` [m] of one of them."""
        return surfaces.thinned(self.centres, spacing)

    def triangles(self, resolution: int) -> Triangles:
        """Return coarse balls; in a large cloud one per cell with an edge of a radius."""
        centres = self.centres
        # Only the first point in each cell is kept.
        if len(centres) > _MOST_BALLS:
            centres = centres[np.sort(np.unique(_cells_of(centres, self.radius)[0], return_index=True)[1])]
        corners, faces = Sphere(self.radius).triangles(_CORNERS)
        first = len(corners) * np.arange(len(centres), dtype=np.intp)
        vertices = (centres[:, None] + corners).reshape(-1, 3)
        return vertices, (first[:, None, None] + faces).reshape(-1, 3)

    def canonical(self) -> dict[str, Any]:
        resolution = {} if self.resolution is None else {"resolution": self.resolution}
        return {"radius": self.radius, "points": array_digest(self.centres), **resolution}


def _finite(points: FloatArray, key: str) -> FloatArray:
    """Return the finite points as a read-only array, and log the number of the others."""
    finite = np.isfinite(points).all(axis=1)
    dropped = len(points) - int(finite.sum())
    if dropped == len(points):
        why = f": none of {len(points)} points is finite" if dropped else ""
        raise InputError(f"the point cloud is empty{why}", key)
    if dropped:
        _log.info("%s: %d of %d points are NaN or infinite and are left out", key, dropped, len(points))
    kept = points[finite]
    far = np.abs(kept).max(axis=1)
    if far.max() > LONGEST:
        worst = int(far.argmax())
        raise InputError(f"point {kept[worst].tolist()} is farther than {LONGEST:g} m away; are they in metres?", key)
    middle = float(np.median(far))
    if middle > _UNLIKELY:
        warn_once(
            _log,
            f"{key}: half of {len(kept)} points are more than {middle:.0f} m from the origin: points are in metres; "
            "those of a cloud in millimetres are to be multiplied by 0.001",
        )
    kept.flags.writeable = False
    return kept


def touched_cells(centres: FloatArray, radius: float, edge: float) -> IntArray:
    """Return the grid cells (C, 3) that balls around `centres: (N, 3)` [m] touch. Their union contains the balls.

    Cell k covers [k·edge, (k + 1)·edge] along each axis [m]: no point of the union is farther than √3·edge from a ball.
    Raises InputError if the cells extend farther than coal's trees support.
    """
    span = float(np.ptp(centres, axis=0).max()) + 2 * radius
    if span / edge >= 2 * _HALF_DEPTH - 4:
        raise InputError(
            f"{edge:g} m is too fine for points that are {span:g} m apart; give at least "
            f"{span / _HALF_DEPTH / 2 * 1.01:.3g}, or leave the far ones out",
            "resolution",
        )
    home = np.floor(centres / edge).astype(np.intp)
    reach = range(-ceil(radius / edge) - 1, ceil(radius / edge) + 2)
    low = home.min(axis=0) + reach[0]
    extent = home.max(axis=0) + reach[-1] + 1 - low
    stride = np.array([extent[1] * extent[2], extent[2], 1])
    first = (home - low) @ stride
    # This is the position of each centre in its cell, shape (3, N), from 0 to the edge.
    beyond = np.ascontiguousarray((centres - home * edge).T)
    # A tree of coal rounds its extent to single precision, so the balls are enlarged by this rounding.
    limit = (radius * (1 + _TOUCHING) + SINGLE_ROUNDING * edge * float(extent.max())) ** 2
    # These are the squared distances, along each axis, of the centres from cells that are k cells away from their own.
    gaps = {k: np.square(np.maximum(np.maximum(k * edge - beyond, beyond - (k + 1) * edge), 0.0)) for k in reach}
    flat = _Numbers(int(extent.prod()))
    for i, j in product(reach, repeat=2):
        across = gaps[i][0] + gaps[j][1]
        if across.min() <= limit:
            for k in reach:
                flat.add(first[across + gaps[k][2] <= limit] + int(np.array([i, j, k]) @ stride))
    return np.asarray(np.column_stack(np.unravel_index(flat.all(), tuple(extent))) + low)


class _Numbers:
    """A set of integers from 0 to `count` − 1, as a table if `count` is small, else as a list of arrays."""

    def __init__(self, count: int) -> None:
        self._table = np.zeros(count, dtype=bool) if count <= _TABLE else None
        self._lists: list[IntArray] = []

    def add(self, numbers: IntArray) -> None:
        if self._table is not None:
            self._table[numbers] = True
        else:
            self._lists.append(np.unique(numbers))

    def all(self) -> IntArray:
        """Return the numbers, sorted and without repeats."""
        if self._table is not None:
            return np.asarray(np.flatnonzero(self._table), dtype=np.intp)
        return np.unique(np.concatenate(self._lists))


def cell_tree(cells: IntArray, edge: float) -> Part:
    """Return the union of the `cells: (C, 3)` with this `edge` [m] as a part with a tree of coal."""
    middle = (cells.min(axis=0) + cells.max(axis=0)) // 2
    tree = coal.makeOctree((cells - middle + 0.5) * edge, edge)
    tree.computeLocalAABB()
    return Part("", tree, pin.SE3(np.eye(3), middle * edge), Voxels(cells - middle, edge))


def _count_cells(points: FloatArray, edge: float) -> int:
    """Return the number of grid cells that contain points (N, 3) [m]."""
    cells, count = _cells_of(points, edge)
    found = _Numbers(count)
    found.add(cells)
    return len(found.all())


def _cells_of(points: FloatArray, edge: float) -> tuple[IntArray, int]:
    """Return the numbers (N,) of the grid cells that contain points (N, 3) [m], and the number of all cells."""
    home = np.floor((points - points.min(axis=0)) / edge).astype(np.intp)
    extent = home.max(axis=0) + 1
    return (home[:, 0] * extent[1] + home[:, 1]) * extent[2] + home[:, 2], int(extent.prod())


def _message_points(message: Any) -> FloatArray:
    """Return the points (N, 3) [m] of a `PointCloud2` (attributes or keys) in its frame; some may be NaN."""
    names = ("height", "width", "fields", "is_bigendian", "point_step", "row_step", "data")
    height, width, fields, big, step, row_step, data = (_part(message, name) for name in names)
    offsets, order = {}, ">" if big else "<"
    for field in fields:
        kind = _MESSAGE_TYPES.get(_part(field, "datatype"))
        if _part(field, "name") in ("x", "y", "z") and kind is not None:
            offsets[_part(field, "name")] = int(_part(field, "offset")), np.dtype(order + kind)
    missing = [axis for axis in "xyz" if axis not in offsets]
    if missing:
        raise InputError(f"the message has no field {' and '.join(missing)}", "fields")
    raw = np.frombuffer(bytes(data), dtype=np.uint8)
    ends = [offset + kind.itemsize for offset, kind in offsets.values()]
    if min(offset for offset, _ in offsets.values()) < 0 or max(ends) > step or row_step < width * step:
        raise InputError(f"fields of {max(ends)} bytes and {width} points a row do not fit", "point_step")
    if len(raw) < height * row_step:
        raise InputError(f"has {len(raw)} bytes, but {height} rows of {row_step} are announced", "data")
    rows = raw[: height * row_step].reshape(height, row_step)[:, : width * step]
    points = rows.reshape(height * width, step)
    columns = [
        np.ascontiguousarray(points[:, offset : offset + kind.itemsize]).view(kind).ravel()
        for offset, kind in (offsets[axis] for axis in "xyz")
    ]
    return np.column_stack([column.astype(np.float64) for column in columns])


def _part(whole: Any, name: str) -> Any:
    try:
        return whole[name] if isinstance(whole, Mapping) else getattr(whole, name)
    except (KeyError, AttributeError):
        raise InputError("the PointCloud2 message lacks it", name) from None


def _read_ply(file: Path) -> FloatArray:
    with document.within("file", ": "):
        content = read_ply(file)
        for element in content.elements:
            if element.name in PLY_SURFACES and element.count:
                raise InputError(
                    f"{file} holds a surface ({element.name}), but a pointcloud uses its vertices only: "
                    "give it as a mesh"
                )
        try:
            columns = [np.asarray(content["vertex"][axis], dtype=np.float64) for axis in "xyz"]
        except (KeyError, ValueError, TypeError) as error:
            raise InputError(f"{file} cannot be read as PLY with vertices x, y and z: {error}") from None
    return np.column_stack(columns)


def _read_npy(file: Path) -> FloatArray:
    try:
        given = np.load(file, allow_pickle=False)
        if given.dtype.kind not in "fiu":
            raise TypeError(f"it holds {given.dtype}")
        points = given.astype(np.float64)
    except (OSError, ValueError, TypeError, AttributeError, EOFError) as error:
        raise InputError(f"{file} cannot be read as an array of numbers: {error}", "file") from None
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{file} must hold an array of shape (N, 3), got {points.shape}", "file")
    return np.ascontiguousarray(points)


_READERS = {".ply": _read_ply, ".npy": _read_npy}
