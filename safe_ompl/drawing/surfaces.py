"""Triangle surfaces of robots, obstacles and people, with shading normals and colours."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain
from operator import itemgetter
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray
from safe_ompl.drawing.style import Colour
from safe_ompl.geometry import Limb, Obstacle, Person, Triangles, surfaces
from safe_ompl.robot import Robot

# The number of facets around a round shape.
_FACETS_AROUND = 32
# Edges with a larger angle are sharp.
_CREASE = 0.6  # [rad]
# The largest number of smooth groups of triangles at one vertex.
_SMOOTH_GROUPS = 4
# Tolerances of equal positions [m], and of equal unit vectors.
_SAME_PLACE, _SAME_DIRECTION = 1e-6, 1e-3  # [m]


@dataclass(frozen=True)
class Surface:
    """Triangles with a shading normal per vertex."""

    vertices: FloatArray  # (V, 3) [m]
    normals: FloatArray  # (V, 3)
    # The vertex indices of each triangle (F, 3).
    faces: IntArray

    @classmethod
    def from_triangles(cls, vertices: FloatArray, faces: IntArray) -> Surface:
        """Return a surface with smooth shading, except across sharp edges."""
        vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.intp)
        _, welded = _distinct_rows(np.round(vertices / _SAME_PLACE))
        normals, places = _corner_normals(vertices, faces, welded, np.cos(_CREASE)), faces.reshape(-1)
        kept, index = _distinct_rows(np.column_stack([welded[places], np.round(normals / _SAME_DIRECTION)]))
        return cls(vertices[places[kept]], normals[kept], index.reshape(-1, 3))

    @classmethod
    def merged(cls, surfaces: Iterable[Surface]) -> Surface:
        """Merge surfaces into one."""
        parts = list(surfaces)
        if not parts:
            return cls(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3), dtype=np.intp))
        starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
        return cls(
            np.vstack([part.vertices for part in parts]),
            np.vstack([part.normals for part in parts]),
            np.vstack([part.faces + start for part, start in zip(parts, starts, strict=True)]),
        )

    def inflated(self, distance: float) -> Surface:
        """Return the surface moved outwards by a distance [m]."""
        return Surface(self.vertices + distance * self.normals, self.normals, self.faces)

    def simplified(self, cell: float) -> Surface:
        """Cluster vertices: replace all vertices within a cubic cell of edge `cell` [m] by one of them."""
        kept, index = _distinct_rows(np.round(self.vertices / cell))
        faces = index[self.faces]
        flat = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
        return Surface(self.vertices[kept], self.normals[kept], faces[~flat])

    def part(self, chosen: BoolArray) -> Surface:
        """Return the triangles for which `chosen: (F,)` is true."""
        return Surface(self.vertices, self.normals, self.faces[chosen])

    def moved(self, rotation: FloatArray, translation: FloatArray) -> Surface:
        """Return the surface after x ↦ R x + p."""
        return Surface(self.vertices @ rotation.T + translation, self.normals @ rotation.T, self.faces)


def _corner_normals(vertices: FloatArray, faces: IntArray, welded: IntArray, cos_crease: float) -> FloatArray:
    """Return normals (3 F, 3) of all triangle corners: area-weighted means over smooth groups of triangles.

    At each vertex, the largest triangle forms a group with all triangles whose normals differ by less than the crease
    angle. The largest remaining triangle forms the next group. Triangles that are left after `_SMOOTH_GROUPS` rounds
    keep their own normals. `welded: (V,)` is equal for vertices at the same position.
    """
    points = vertices[faces]
    area_normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    unit = _normalised(area_normals)
    by_area = np.argsort(-np.einsum("ij,ij->i", area_normals, area_normals), kind="stable")
    corners = (3 * by_area[:, None] + np.arange(3)).reshape(-1)
    corners = corners[np.argsort(welded[faces.reshape(-1)[corners]], kind="stable")]
    vertex = welded[faces.reshape(-1)[corners]]
    normals = np.repeat(unit, 3, axis=0)
    for _ in range(_SMOOTH_GROUPS):
        if not len(corners):
            break
        new = np.concatenate([[True], vertex[1:] != vertex[:-1]])
        first, group = np.flatnonzero(new), np.cumsum(new) - 1
        face = corners // 3
        close = np.einsum("ij,ij->i", unit[face], unit[face[first]][group]) > cos_crease
        close[first] = True
        means = _normalised(np.add.reduceat(np.where(close[:, None], area_normals[face], 0.0), first))
        normals[corners[close]] = means[group[close]]
        corners, vertex = corners[~close], vertex[~close]
    return normals


def _distinct_rows(rows: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the indices of the distinct rows of whole numbers (R, C), and for each row its distinct row (R,)."""
    low = rows.min(axis=0, initial=0.0)
    spans = rows.max(axis=0, initial=0.0) - low + 1.0
    # If a row fits into one integer, sorting is several times faster.
    if spans.prod() < 2.0**62:
        places = np.cumprod([1, *spans[:-1].astype(np.int64)])
        _, first, index = np.unique((rows - low).astype(np.int64) @ places, return_index=True, return_inverse=True)
        return first, index
    _, first, index = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    # NumPy 2.0 returns another shape.
    return first, index.ravel()


def _normalised(vectors: FloatArray) -> FloatArray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 0.0, vectors / np.where(length > 0.0, length, 1.0), (0.0, 0.0, 1.0))


def tessellate(geometry: Any) -> Triangles:
    """Return the triangles of a coal collision geometry in its own frame [m].

    Raises InputError if the kind of geometry cannot be drawn.
    """
    kind = type(geometry).__name__
    if kind == "Box":
        return surfaces.box_triangles(2.0 * geometry.halfSide)
    if kind.startswith(("BVHModel", "Convex")):
        shape = ("tri_indices", "num_tris", "vertices") if kind[0] == "B" else ("polygons", "num_polygons", "points")
        triangle, count, points = (getattr(geometry, name) for name in shape)
        corners = map(itemgetter(0, 1, 2), map(triangle, range(count)))
        faces = np.fromiter(chain.from_iterable(corners), dtype=np.intp, count=3 * count)
        return np.array(points(), dtype=float), faces.reshape(-1, 3)
    radius, half = float(getattr(geometry, "radius", 0.0)), float(getattr(geometry, "halfLength", 0.0))
    step = 2.0 * np.pi * radius / _FACETS_AROUND
    if kind == "Sphere":
        profile = surfaces.sphere_profile(radius, step)
    elif kind == "Cylinder":
        profile = surfaces.cylinder_profile(radius, 2.0 * half, np.inf)
    elif kind == "Capsule":
        profile = surfaces.capsule_profile(radius, 2.0 * half, step, np.inf)
    elif kind == "Cone":
        profile = np.array([(0.0, -half), (radius, -half), (0.0, half)])
    else:
        known = "mesh, convex, box, sphere, cylinder, capsule, cone"
        raise InputError(f"cannot draw a geometry of type {kind}; known: {known}")
    return surfaces.revolved_triangles(profile, _FACETS_AROUND)


def tube(points: FloatArray, radius: float) -> Triangles:
    """Return the triangles of a round tube along a polyline `points: (P, 3)` [m]; repeated points are skipped."""
    points = np.asarray(points, dtype=float)
    moving = np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6
    points = points[np.concatenate(([True], moving))]
    if len(points) < 2:
        vertices, faces = surfaces.revolved_triangles(surfaces.sphere_profile(radius, radius / 4), _FACETS_AROUND)
        return vertices + points[0], faces
    across, up = _transported_frame(_normalised(np.gradient(points, axis=0)))
    turn = np.arange(_FACETS_AROUND) * (2.0 * np.pi / _FACETS_AROUND)
    circle = np.cos(turn)[None, :, None] * across[:, None] + np.sin(turn)[None, :, None] * up[:, None]
    vertices = (points[:, None] + radius * circle).reshape(-1, 3)
    return vertices, _grid_faces(len(points), _FACETS_AROUND)


def _transported_frame(tangents: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors (P, 3) normal to each tangent, rotated as little as possible along the curve."""
    across = np.empty_like(tangents)
    seed = np.eye(3)[np.argmin(np.abs(tangents[0]))]
    for i, tangent in enumerate(tangents):
        seed = seed - tangent * (seed @ tangent)
        seed = seed / np.linalg.norm(seed)
        across[i] = seed
    return across, np.cross(tangents, across)


def _grid_faces(rows: int, columns: int) -> IntArray:
    """Return the triangles (2 (rows-1) columns, 3) between consecutive rings of `columns` vertices."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    here, right = i * columns + j, i * columns + (j + 1) % columns
    below, below_right = here + columns, right + columns
    quads = [np.stack([here, below, below_right], axis=-1), np.stack([here, below_right, right], axis=-1)]
    return np.concatenate([half.reshape(-1, 3) for half in quads])


@dataclass(frozen=True)
class ColouredSurface:
    """A surface with a colour."""

    surface: Surface
    colour: Colour
    # Whether the surface has specular highlights.
    glossy: bool = False


_HARMLESS_SURFACE: Colour = (0.80, 0.68, 0.53)
_DANGEROUS_SURFACE: Colour = (0.85, 0.45, 0.30)
_SKIN: Colour = (0.86, 0.64, 0.51)
SHIRT: Colour = (0.83, 0.43, 0.29)
_TROUSERS: Colour = (0.30, 0.33, 0.40)
_SHOES: Colour = (0.20, 0.20, 0.22)
_HAIR: Colour = (0.29, 0.21, 0.16)
# This rotation tilts the pole of the head backwards.
_HAIRLINE = pin.SE3(pin.utils.rotate("y", -0.65), np.zeros(3))
# The radius of the foot of a robot that has no base body.
_BASE_RADIUS = 0.06  # [m]
# The number of corners of every circle of an obstacle.
_CIRCLE_CORNERS = 48


class RobotBody:
    """The surfaces of a robot. `links` holds one surface per body, each in its own frame.

    The visual geometry is drawn. The collision geometry is drawn for joints without visual geometry, and for all joints
    if `coarse`. Details smaller than `detail` [m] are left out.
    """

    def __init__(self, robot: Robot, *, coarse: bool = False, detail: float = 1e-5) -> None:
        self._robot = robot
        self._geometry = robot.shared.collision_model if coarse else robot.visual_model
        shown = {part.parentJoint for part in self._geometry.geometryObjects}
        for part in robot.shared.collision_model.geometryObjects:
            # Collision geometry fills the gaps of joints without visual geometry.
            if part.parentJoint not in shown:
                self._geometry.addGeometryObject(part)
        parts = self._geometry.geometryObjects
        self.links = []
        for vertices, faces in (tessellate(part.geometry) for part in parts):
            rough = Surface(vertices, vertices, faces).simplified(detail)
            self.links.append(Surface.from_triangles(rough.vertices, rough.faces))

    def posed(self, q: FloatArray, moved_from: FloatArray | None = None) -> Surface:
        """Return the body at `q: (n,)` in the world frame, without the links posed as at `moved_from: (n,)`."""
        places = self.placements(q)
        before = [None] * len(places) if moved_from is None else self.placements(moved_from)
        return Surface.merged(
            link.moved(place.rotation, place.translation)
            for link, place, old in zip(self.links, places, before, strict=True)
            if old is None or not place.isApprox(old, 1e-6)
        )

    def footprint(self) -> tuple[FloatArray, float, float]:
        """Return centre (2,), radius and lowest height of the part of the body that never moves [m]."""
        base = [
            link.moved(part.placement.rotation, part.placement.translation).vertices
            for link, part in zip(self.links, self._geometry.geometryObjects, strict=False)
            if part.parentJoint == 0
        ]
        if not base:
            return np.zeros(2), _BASE_RADIUS, 0.0
        low, high = np.vstack(base).min(axis=0), np.vstack(base).max(axis=0)
        return (low[:2] + high[:2]) / 2, float((high - low)[:2].max()) / 2, float(low[2])

    def placements(self, q: FloatArray) -> list[pin.SE3]:
        """Return the pose of each link in the world at `q: (n,)`."""
        model, data = self._robot.shared.model, self._robot.shared.model.createData()
        bodies = self._geometry.createData()
        pin.updateGeometryPlacements(model, data, self._geometry, bodies, self._robot.pinocchio_configuration(q))
        return [pin.SE3(place) for place in bodies.oMg]


def scene_surfaces(obstacles: Iterable[Obstacle]) -> tuple[dict[str, list[ColouredSurface]], list[str]]:
    """Return the surfaces of each obstacle by name, and the names of the obstacles that are drawn as dangerous.

    No obstacle is drawn as dangerous if all are dangerous objects, without a person among them.
    """
    obstacles = tuple(obstacles)
    marked = any(o.weight == 0 or isinstance(o.shape, Person) for o in obstacles)
    drawn = {obstacle.name: obstacle_surfaces(obstacle, marked) for obstacle in obstacles}
    return drawn, [o.name for o in obstacles if marked and o.weight > 0]


def obstacle_surfaces(obstacle: Obstacle, marked: bool = True) -> list[ColouredSurface]:
    """Return the surfaces of an obstacle: people by limb, with skin and clothes; other obstacles in one colour.

    A colour that the obstacle defines is used, for a person as the colour of the shirt. With `marked`, dangerous
    obstacles have another colour than harmless ones.
    """
    own = None if obstacle.color is None else (obstacle.color[0], obstacle.color[1], obstacle.color[2])
    if isinstance(obstacle.shape, Person):
        limbs = [(obstacle.pose.se3 * limb.placement, limb) for limb in obstacle.shape.limbs()]
        return [
            ColouredSurface(piece.surface.moved(place.rotation, place.translation), piece.colour)
            for place, limb in limbs
            for piece in limb_surfaces(limb, own or SHIRT)
        ]
    colour = own or (_DANGEROUS_SURFACE if marked and obstacle.weight > 0 else _HARMLESS_SURFACE)
    return [ColouredSurface(Surface.from_triangles(*obstacle.triangles(_CIRCLE_CORNERS)), colour)]


def limb_surfaces(limb: Limb, shirt: Colour = SHIRT) -> list[ColouredSurface]:
    """Return the lower and the upper part of a person's limb, in the frame of the limb with z along the limb."""
    kind = limb.name.removeprefix("left_").removeprefix("right_")
    surface = Surface.from_triangles(*limb.shape.triangles(_CIRCLE_CORNERS))
    heights = surface.vertices[surface.faces, 2].mean(axis=1)
    covered = heights > (0.25 * limb.radius if kind == "head" else limb.length / 2)
    turn = _HAIRLINE.rotation if kind == "head" else np.eye(3)
    # For the head, the colours of face and hair. For limbs that are not bare, the colours of the lower and upper part.
    clothes = {
        "head": (_SKIN, _HAIR),
        "shoulders": (shirt, shirt),
        "torso": (shirt, _TROUSERS),
        "flank": (shirt, _TROUSERS),
        "upper_arm": (shirt, _SKIN),
        "foot": (_SHOES, _SHOES),
        **dict.fromkeys(("hips", "thigh", "shank"), (_TROUSERS, _TROUSERS)),
    }
    return [
        ColouredSurface(surface.part(faces).moved(turn, np.zeros(3)), colour)
        for colour, faces in zip(clothes.get(kind, (_SKIN, _SKIN)), (~covered, covered), strict=True)
        if faces.any()
    ]
