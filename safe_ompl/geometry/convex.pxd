"""Convex bodies: tables for compiled modules, and functions that are compiled into their callers.

The bounds by balls and boxes are inline, because they decide about most pairs, which are far apart.
"""

from libc.math cimport INFINITY, sqrt

cdef enum:
    # A row of a simplex has three coordinates of a point of A − B, and three of the point of A that belongs to it.
    EDGES = 6


cdef struct Vector:
    double x, y, z


# A row of `BODY` in `convex.pyx`, which explains the members.
cdef struct Body:
    Py_ssize_t joint
    double rotation[3][3]
    double translation[3]
    double centre[3]
    double reach
    double extent[3]
    double box[3]
    double disc
    double ball
    Py_ssize_t grid
    Py_ssize_t first_cell
    Py_ssize_t levels
    Py_ssize_t root


# A row of `NODE`: a cell in the tree of a solid.
cdef struct Node:
    double centre[3]
    Py_ssize_t level
    size_t size


# A row of `POSE`: the pose of a body in the world, and the centre of its bounding ball.
cdef struct Pose:
    double rotation[3][3]
    double origin[3]
    double centre[3]


# Bodies at their poses. The poses of a solid's cells are written while the distance of the solid is computed. So each
# thread needs an own array of poses; the other arrays are shared.
cdef struct Bodies:
    const Body *body
    const Py_ssize_t *starts
    const double *vertices
    const Node *nodes
    Pose *pose


# The state of a search for the distance of two bodies, which the next search of the same bodies may begin with.
cdef struct Search:
    # The best separating axis so far, from the second body to the first. Zeros mean that no axis is known.
    double axis[3]
    double simplex[4][EDGES]


# Bounds of a distance.
cdef struct Bounds:
    # [m] The upper bound is −∞ if the bodies overlap.
    double lower
    double upper
    # The number of corners of the simplex that span the nearest point, if exact bounds were asked for.
    int corners


cdef class ShapeTable:
    cdef readonly object bodies, starts, vertices, nodes
    cdef readonly Py_ssize_t count
    cdef readonly bint bounded
    cdef Bodies data
    cdef Pose *new_poses(self) except NULL
    cdef int _check_body(self, Py_ssize_t g) except -1


cdef Bounds distance_bounds(
    const Bodies *bodies, Py_ssize_t a, Py_ssize_t b, Search *search, double enough, double least, bint exact
) noexcept nogil

cdef double distance_bound(
    const Bodies *bodies, Py_ssize_t a, Py_ssize_t b, Search *search, double enough
) noexcept nogil

cdef int nearest_in_simplex(double (*simplex)[EDGES], int corners, Vector *nearest) noexcept nogil


cdef inline void place_still(const Body *body, Pose *pose) noexcept nogil:
    """Write the pose of a body that no joint carries."""
    cdef Py_ssize_t x, y
    for x in range(3):
        for y in range(3):
            pose.rotation[x][y] = body.rotation[x][y]
        pose.origin[x] = body.translation[x]
        pose.centre[x] = (
            pose.origin[x] + pose.rotation[x][0] * body.centre[0] + pose.rotation[x][1] * body.centre[1]
            + pose.rotation[x][2] * body.centre[2]
        )


cdef inline void place_moving(
    const Body *bodies, Py_ssize_t count, Pose *poses, const double *rotations, const double *origins
) noexcept nogil:
    """Write the poses of those of the first `count` bodies that joints carry.

    The joints have the frames `rotations: (m, 3, 3)` and `origins: (m, 3)`.
    """
    cdef Py_ssize_t g, x, y, joint
    cdef const Body *body
    cdef Pose *pose
    cdef const double *frame
    for g in range(count):
        body, pose, joint = &bodies[g], &poses[g], bodies[g].joint - 1
        if joint < 0:
            continue
        for x in range(3):
            frame = rotations + 9 * joint + 3 * x
            for y in range(3):
                pose.rotation[x][y] = (
                    frame[0] * body.rotation[0][y] + frame[1] * body.rotation[1][y] + frame[2] * body.rotation[2][y]
                )
            pose.origin[x] = (
                origins[3 * joint + x] + frame[0] * body.translation[0] + frame[1] * body.translation[1]
                + frame[2] * body.translation[2]
            )
            pose.centre[x] = (
                pose.origin[x] + pose.rotation[x][0] * body.centre[0] + pose.rotation[x][1] * body.centre[1]
                + pose.rotation[x][2] * body.centre[2]
            )


cdef inline Vector beyond_box(const Body *body, const Pose *pose, const double *point) noexcept nogil:
    """Return the shortest vector from the bounding box of a body to a point (3,) of the world, in the body's frame."""
    # Cython would keep a bare `pose.centre` in a temporary pointer without `const`.
    cdef const double *o = &pose.centre[0]
    cdef const double *half = &body.extent[0]
    cdef double x = point[0] - o[0], y = point[1] - o[1], z = point[2] - o[2]
    cdef double a = pose.rotation[0][0] * x + pose.rotation[1][0] * y + pose.rotation[2][0] * z
    cdef double b = pose.rotation[0][1] * x + pose.rotation[1][1] * y + pose.rotation[2][1] * z
    cdef double c = pose.rotation[0][2] * x + pose.rotation[1][2] * y + pose.rotation[2][2] * z
    return Vector(
        a - min(max(a, -half[0]), half[0]), b - min(max(b, -half[1]), half[1]), c - min(max(c, -half[2]), half[2])
    )


cdef inline Vector from_box(const Body *body, const Pose *pose, const double *point) noexcept nogil:
    """Return the shortest vector from the bounding box of a body to a point (3,), both in the world frame."""
    cdef Vector way = beyond_box(body, pose, point)
    return Vector(
        pose.rotation[0][0] * way.x + pose.rotation[0][1] * way.y + pose.rotation[0][2] * way.z,
        pose.rotation[1][0] * way.x + pose.rotation[1][1] * way.y + pose.rotation[1][2] * way.z,
        pose.rotation[2][0] * way.x + pose.rotation[2][1] * way.y + pose.rotation[2][2] * way.z,
    )


cdef inline void begin_axis(double *axis, Vector way, double x, double y, double z) noexcept nogil:
    """Write a first separating axis (3,): `way` between box and ball, or (x, y, z) between the centres if it is 0."""
    cdef double no_length = 1e-9  # [m]
    if way.x * way.x + way.y * way.y + way.z * way.z < no_length * no_length:
        way = Vector(x, y, z + no_length)
    axis[0], axis[1], axis[2] = way.x, way.y, way.z


cdef inline double outer_bound(
    const Bodies *bodies, Py_ssize_t a, Py_ssize_t b, double enough, double *axis
) noexcept nogil:
    """Return a lower bound of the distance [m] of two bodies by their bounding balls and boxes, at most `enough`.

    If the bound is below `enough`, the vector from the box of one body to the centre of the other is written to `axis:
    (3,)`, where the search for a better separating axis begins.
    """
    cdef const Body *A = &bodies.body[a]
    cdef const Body *B = &bodies.body[b]
    cdef const double *p = bodies.pose[a].centre
    cdef const double *q = bodies.pose[b].centre
    cdef double x = p[0] - q[0], y = p[1] - q[1], z = p[2] - q[2], far = enough + A.reach + B.reach
    cdef double first, second, lower
    cdef Vector way
    if x * x + y * y + z * z >= far * far:
        return enough
    way, far = beyond_box(B, &bodies.pose[b], p), enough + A.reach
    first = way.x * way.x + way.y * way.y + way.z * way.z
    if first >= far * far:
        return enough
    way, far = beyond_box(A, &bodies.pose[a], q), enough + B.reach
    second = way.x * way.x + way.y * way.y + way.z * way.z
    if second >= far * far:
        return enough
    lower = sqrt(first) - A.reach
    if lower >= sqrt(second) - B.reach:
        way = from_box(B, &bodies.pose[b], p)
    else:
        lower, way = sqrt(second) - B.reach, from_box(A, &bodies.pose[a], q)
        way = Vector(-way.x, -way.y, -way.z)
    begin_axis(axis, way, x, y, z)
    return lower
