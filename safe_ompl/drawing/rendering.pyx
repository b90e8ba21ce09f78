"""Pictures of triangles in light: a z-buffer, shadow maps, and the colour of each pixel."""

from libc.math cimport ceil, floor, isfinite, pow, rint, sqrt

from typing import NamedTuple

import numpy as np

from safe_ompl.common import InputError

# Subpixels along each side of a pixel, and in all.
cdef enum:
    SIDE = 2
    EACH = 4
# How bright the empty floor is in a picture, in linear light.
cdef double FLOOR = 0.87

SUBPIXELS = SIDE
FLOOR_VALUE = FLOOR

# Light from the floor on what looks down, and the highlight of glossy things.
cdef double BOUNCE = 0.22
cdef double GLOSS = 0.16
cdef double SHININESS = 60.0


def draw_triangles(
    const double[:, ::1] points, const Py_ssize_t[:, ::1] faces, int first, float[:, ::1] nearness, int[:, ::1] owner
):
    """Draw triangles over what is there: where they are nearer, `nearness` and `owner` (height, width) become theirs.

    Triangles are `faces: (F, 3)` of vertices `points: (V, 3)`: columns and rows in pixels, centres at integers, and
    nearness, which must be affine on a triangle in the picture: 1/depth of a perspective, or a height. NaN: not to be
    drawn. Their numbers begin with `first`. A pixel is in a triangle where the three edge functions
    (b − a) × (p − a) have the sign of its area; along a row they bound an interval of columns.
    """
    cdef Py_ssize_t height = nearness.shape[0], width = nearness.shape[1], f, row, column, lowest, highest
    cdef int edge
    cdef const double *corner[4]
    cdef const double *a
    cdef const double *b
    cdef const double *c
    cdef double area, turn, across, down, left, right, slope, value, near
    _check_faces(points, faces)
    if owner.shape[0] != height or owner.shape[1] != width:
        raise InputError("nearness and owner must have the same shape")
    with nogil:
        for f in range(faces.shape[0]):
            a, b, c = &points[faces[f, 0], 0], &points[faces[f, 1], 0], &points[faces[f, 2], 0]
            corner[0], corner[1], corner[2], corner[3] = a, b, c, a
            area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
            if not isfinite(area + a[2] + b[2] + c[2]) or area == 0.0:
                continue
            turn = 1.0 if area > 0.0 else -1.0
            across = ((b[2] - a[2]) * (c[1] - a[1]) - (c[2] - a[2]) * (b[1] - a[1])) / area
            down = ((c[2] - a[2]) * (b[0] - a[0]) - (b[2] - a[2]) * (c[0] - a[0])) / area
            lowest = <Py_ssize_t> min(max(ceil(min(min(a[1], b[1]), c[1])), 0.0), <double> height)
            highest = <Py_ssize_t> max(min(floor(max(max(a[1], b[1]), c[1])), height - 1.0), -1.0)
            for row in range(lowest, highest + 1):
                left, right = 0.0, width - 1.0
                for edge in range(3):
                    # The slope of the edge function along the row.
                    slope = -turn * (corner[edge + 1][1] - corner[edge][1])
                    value = turn * (corner[edge + 1][0] - corner[edge][0]) * (row - corner[edge][1]) - (
                        slope * corner[edge][0]
                    )
                    if slope > 0.0:
                        left = max(left, -value / slope)
                    elif slope < 0.0:
                        right = min(right, -value / slope)
                    elif value < 0.0:
                        right = -1.0
                if not left <= width:
                    continue
                for column in range(<Py_ssize_t> ceil(left), <Py_ssize_t> floor(max(right, -1.0)) + 1):
                    near = a[2] + across * (column - a[0]) + down * (row - a[1])
                    if near > nearness[row, column]:
                        nearness[row, column] = <float> near
                        owner[row, column] = first + <int> f


def nearest_triangles(points, faces, Py_ssize_t width, Py_ssize_t height):
    """Return how near the nearest triangle is at each pixel (height, width), -inf beside all, and which it is, or -1.

    See `draw_triangles`.
    """
    nearness = np.full((height, width), -np.inf, dtype=np.float32)
    owner = np.full((height, width), -1, dtype=np.int32)
    draw_triangles(points, faces, 0, nearness, owner)
    return nearness, owner


cdef int _check_faces(const double[:, ::1] points, const Py_ssize_t[:, ::1] faces) except -1:
    cdef Py_ssize_t f, k, V = points.shape[0]
    if points.shape[1] != 3 or faces.shape[1] != 3:
        raise InputError("vertices and faces must have three columns")
    for f in range(faces.shape[0]):
        for k in range(3):
            if not 0 <= faces[f, k] < V:
                raise InputError(f"face {f} has a corner that there is not")
    return 0


# The shares of the second and third corner of a triangle.
cdef struct Shares:
    double u
    double v


cdef Shares _meets(
    const double[:, ::1] vertices, const Py_ssize_t *corners, const double *eye, const double *ray
) noexcept nogil:
    """Return where a ray (3,) from the eye meets the triangle of three corners.

    A ray that misses its triangle, as one through the edge may, has the shares of the edge.
    """
    cdef const double *p = &vertices[corners[0], 0]
    cdef const double *q = &vertices[corners[1], 0]
    cdef const double *r = &vertices[corners[2], 0]
    cdef double ax = eye[0] - p[0], ay = eye[1] - p[1], az = eye[2] - p[2]
    cdef double ux = q[0] - p[0], uy = q[1] - p[1], uz = q[2] - p[2]
    cdef double vx = r[0] - p[0], vy = r[1] - p[1], vz = r[2] - p[2]
    cdef double cx = ray[1] * vz - ray[2] * vy, cy = ray[2] * vx - ray[0] * vz, cz = ray[0] * vy - ray[1] * vx
    cdef double determinant = ux * cx + uy * cy + uz * cz, u, v
    if determinant == 0.0:
        determinant = 1.0
    u = min(max((ax * cx + ay * cy + az * cz) / determinant, 0.0), 1.0)
    v = ray[0] * (ay * uz - az * uy) + ray[1] * (az * ux - ax * uz) + ray[2] * (ax * uy - ay * ux)
    return Shares(u, min(max(v / determinant, 0.0), 1.0 - u))


cdef inline double _interpolate(
    const double[:, ::1] values, const Py_ssize_t *corners, Py_ssize_t column, Shares at
) noexcept nogil:
    """Return a column of values of vertices at a point of the triangle of three corners."""
    return (
        (1.0 - at.u - at.v) * values[corners[0], column] + at.u * values[corners[1], column]
        + at.v * values[corners[2], column]
    )


def interpolated(
    const double[:, ::1] vertices, const Py_ssize_t[:, ::1] corners, const double[:, ::1] values,
    const double[::1] eye, const double[:, ::1] rays,
):
    """Return values (V, C) of vertices where rays (P, 3) from the eye meet triangles of corners (P, 3): (P, C)."""
    cdef Py_ssize_t P = rays.shape[0], C = values.shape[1], p, c
    cdef Shares at
    _check_faces(vertices, corners)
    if corners.shape[0] != P or values.shape[0] != vertices.shape[0] or eye.shape[0] != 3 or rays.shape[1] != 3:
        raise InputError("there must be a triangle for each ray, and values for each vertex")
    found = np.empty((P, C))
    cdef double[:, ::1] out = found
    for p in range(P):
        at = _meets(vertices, &corners[p, 0], &eye[0], &rays[p, 0])
        for c in range(C):
            out[p, c] = _interpolate(values, &corners[p, 0], c, at)
    return found


class Painted(NamedTuple):
    """Triangles of several things.

    Vertices (V, 3) [m] and their normals (V, 3); faces (F, 3), and which thing each is of, (F,); of each thing its
    linear RGB, and 1 if it is glossy, or 0, (T, 4).
    """

    vertices: object
    normals: object
    faces: object
    owners: object
    paint: object


class View(NamedTuple):
    """What a camera sees of light.

    The eye (3,) [m]; axes (3, 3), rows: to the right and up in the picture, and back; the size of a subpixel per metre
    of depth; the unit vector (3,) to the key light.
    """

    eye: object
    axes: object
    scale: float
    key: object


cdef class Shading:
    """Colours of a solid on a floor in light.

    Parameters
    ----------
    solid : Painted
        The triangles.
    light : Light
        The light, with shadow maps.
    view : View
        What the camera sees of it.
    """

    cdef const double[:, ::1] vertices, normals, paint, axes, slants, lights, on_floor
    cdef const Py_ssize_t[:, ::1] faces
    cdef const Py_ssize_t[::1] owners
    cdef const float[:, :, ::1] maps
    cdef const double[::1] eye, key, corner
    cdef double scale, floor_height, texel

    def __init__(self, solid, light, view):
        self.vertices, self.normals, self.faces, self.owners, self.paint = solid
        self.eye, self.axes, self.scale, self.key = view
        self.floor_height, self.texel, self.corner = light.floor, light.texel, light.corner
        self.slants, self.lights, self.maps, self.on_floor = light.slants, light.lights, light.maps, light.on_floor
        _check_faces(self.vertices, self.faces)
        F, T, L = self.faces.shape[0], self.paint.shape[0], self.lights.shape[0]
        if self.owners.shape[0] != F or (F and not 0 <= np.min(solid.owners) <= np.max(solid.owners) < T):
            raise InputError("each face must be of one of the things that are painted")
        if np.shape(solid.normals) != np.shape(solid.vertices) or self.paint.shape[1] != 4:
            raise InputError("there must be a normal for each vertex, and four numbers for each thing's paint")
        if self.slants.shape[0] != L or self.maps.shape[0] != L or self.maps.shape[1] != self.maps.shape[2]:
            raise InputError("there must be a slant and a square shadow map for each light")
        if self.slants.shape[1] != 2 or self.lights.shape[1] != 4 or self.on_floor.shape[0] != self.on_floor.shape[1]:
            raise InputError("lights must have four numbers, slants two, and the floor's light must be a square")
        if (self.eye.shape[0], self.key.shape[0], *np.shape(view.axes), self.corner.shape[0]) != (3, 3, 3, 3, 2):
            raise InputError("eye, axes and key light must be of three dimensions")

    def picture(self, const int[:, ::1] faces, const double[:, ::1] floor_nearness):
        """Return a picture in linear RGB (height, width, 3).

        Subpixels (H, W) see triangles, or the floor where that is -1 and 1/depth of the floor is positive. Of those of
        one pixel that see the same thing from the same side only the first is shaded.
        """
        cdef Py_ssize_t height = faces.shape[0], width = faces.shape[1], row, column, s, other, i, j, k, alike
        cdef Py_ssize_t groups[EACH]
        cdef double colours[EACH][3]
        cdef double ray[3]
        cdef double x, y, depth
        cdef int face
        if floor_nearness.shape[0] != height or floor_nearness.shape[1] != width:
            raise InputError("faces and the floor's nearness must have the same shape")
        if height and width and not -1 <= np.min(faces) <= np.max(faces) < self.faces.shape[0]:
            raise InputError("subpixels must see faces that there are")
        found = np.zeros((height // SIDE, width // SIDE, 3))
        cdef double[:, :, ::1] out = found
        with nogil:
            for row in range(out.shape[0]):
                for column in range(out.shape[1]):
                    for s in range(EACH):
                        i, j = SIDE * row + s // SIDE, SIDE * column + s % SIDE
                        face, alike = faces[i, j], -1
                        groups[s] = self._facet(face) if face >= 0 else -1
                        for other in range(s):
                            if groups[other] == groups[s]:
                                alike = other
                                break
                        if alike >= 0:
                            for k in range(3):
                                colours[s][k] = colours[alike][k]
                        else:
                            x, y = self.scale * (j - (width - 1) / 2.0), self.scale * ((height - 1) / 2.0 - i)
                            for k in range(3):
                                ray[k] = x * self.axes[0, k] + y * self.axes[1, k] - self.axes[2, k]
                            if face >= 0:
                                self._shade(face, ray, colours[s])
                            else:
                                depth = 1.0
                                if floor_nearness[i, j] > 0.0:
                                    depth = 1.0 / floor_nearness[i, j]
                                    depth = self._light_on_floor(
                                        self.eye[0] + depth * ray[0], self.eye[1] + depth * ray[1]
                                    )
                                for k in range(3):
                                    colours[s][k] = FLOOR * depth
                        for k in range(3):
                            out[row, column, k] += colours[s][k] / EACH
        return found

    cdef Py_ssize_t _facet(self, Py_ssize_t face) noexcept nogil:
        """Return a number that tells the thing of a triangle and roughly its direction.

        Edges between different numbers are smoothed.
        """
        cdef const double *a = &self.vertices[self.faces[face, 0], 0]
        cdef const double *b = &self.vertices[self.faces[face, 1], 0]
        cdef const double *c = &self.vertices[self.faces[face, 2], 0]
        cdef double ux = b[0] - a[0], uy = b[1] - a[1], uz = b[2] - a[2]
        cdef double vx = c[0] - a[0], vy = c[1] - a[1], vz = c[2] - a[2]
        cdef double x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx
        cdef double length = max(sqrt(x * x + y * y + z * z), 1e-12)
        cdef double side = 25 * rint(2 * x / length) + 5 * rint(2 * y / length) + rint(2 * z / length)
        # It is no number where a vertex is none.
        return 1000 * self.owners[face] + (<Py_ssize_t> side + 62 if isfinite(side) else 0)

    cdef void _shade(self, Py_ssize_t face, const double *ray, double *colour) noexcept nogil:
        """Write the colour (3,) of a triangle where a ray meets it."""
        cdef const Py_ssize_t *corners = &self.faces[face, 0]
        cdef Py_ssize_t k
        cdef Shares at = _meets(self.vertices, corners, &self.eye[0], ray)
        cdef const double *paint = &self.paint[self.owners[face], 0]
        cdef double place[3]
        cdef double normal[3]
        cdef double to_eye[3]
        cdef double towards, brightness, seen = 0.0, facing
        for k in range(3):
            place[k] = _interpolate(self.vertices, corners, k, at)
            normal[k] = _interpolate(self.normals, corners, k, at)
            to_eye[k] = self.eye[k] - place[k]
        _scale(to_eye, 1.0)
        towards = normal[0] * to_eye[0] + normal[1] * to_eye[1] + normal[2] * to_eye[2]
        _scale(normal, -1.0 if towards < 0.0 else 1.0)
        brightness = self._light_at(place, normal, &seen)
        for k in range(3):
            to_eye[k] += self.key[k]
        _scale(to_eye, 1.0)
        facing = min(max(normal[0] * to_eye[0] + normal[1] * to_eye[1] + normal[2] * to_eye[2], 0.0), 1.0)
        for k in range(3):
            colour[k] = paint[k] * brightness + paint[3] * GLOSS * pow(facing, SHININESS) * seen

    cdef double _light_at(self, const double *place, const double *normal, double *seen) noexcept nogil:
        """Return the light that a surface receives at a place (3,), and add the share of the key light that it sees."""
        cdef Py_ssize_t size = self.maps.shape[1], k
        cdef double height = place[2] + 1.5 * self.texel * normal[2] - self.floor_height
        cdef double x = (place[0] + 1.5 * self.texel * normal[0] - self.corner[0]) / self.texel
        cdef double y = (place[1] + 1.5 * self.texel * normal[1] - self.corner[1]) / self.texel
        cdef double found = BOUNCE * (0.5 - 0.5 * normal[2]), column, row
        cdef const double *towards
        for k in range(self.slants.shape[0]):
            column, row = rint(x - height * self.slants[k, 0]), rint(y - height * self.slants[k, 1])
            if 0 <= column < size and 0 <= row < size:
                if self.maps[k, <Py_ssize_t> row, <Py_ssize_t> column] > height + self.texel:
                    continue
            towards = &self.lights[k, 0]
            found += max(normal[0] * towards[0] + normal[1] * towards[1] + normal[2] * towards[2], 0.0)
            seen[0] += towards[3]
        return found

    cdef double _light_on_floor(self, double x, double y) noexcept nogil:
        """Return the light on the floor at a place, 1 where it is open."""
        cdef double left, below, u, v, low, high
        cdef Py_ssize_t column, row, last = self.on_floor.shape[0] - 1
        x, y = (x - self.corner[0]) / self.texel, (y - self.corner[1]) / self.texel
        left, below = floor(x), floor(y)
        if not (0 <= left < last and 0 <= below < last):
            return 1.0
        column, row = <Py_ssize_t> left, <Py_ssize_t> below
        u, v = x - column, y - row
        low = (1 - u) * self.on_floor[row, column] + u * self.on_floor[row, column + 1]
        high = (1 - u) * self.on_floor[row + 1, column] + u * self.on_floor[row + 1, column + 1]
        return (1 - v) * low + v * high


cdef void _scale(double *vector, double length) noexcept nogil:
    """Give a vector (3,) a length; a negative one turns it."""
    cdef double scale = length / max(
        sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]), 1e-9
    )
    cdef Py_ssize_t k
    for k in range(3):
        vector[k] *= scale
