"""Bounds of the distance of two convex bodies by their support functions, and of a convex body and a solid of cells.

A body is the Minkowski sum of the convex hull of vertices, a box, a disc about its z axis and a ball, in its own frame.
Boxes, spheres, capsules, cylinders and polytopes have this form. The support function is the sum of the supports,

    h(n) = max_k n·v_k + Σ_i |n_i| b_i + ρ √(n_x² + n_y²) + r.

For any unit axis n from body B to body A the distance is at least −h_A(−n) − h_B(n), the width of the slab that
separates them. The bound holds for every axis; the search for an axis only makes it tight.
"""

from libc.math cimport fabs
from libc.stdlib cimport free, malloc

import numpy as np

from safe_ompl.common import InputError

BODY = np.dtype(
    [
        # Pinocchio's number of the joint that carries the body; 0: the world.
        ("joint", np.intp),
        # The body's frame in that of the joint.
        ("rotation", np.float64, (3, 3)),
        ("translation", np.float64, (3,)),
        # In the body's frame: centre and radius of the bounding ball, half sides of the bounding box with this centre
        # [m].
        ("centre", np.float64, (3,)),
        ("reach", np.float64),
        ("extent", np.float64, (3,)),
        # The summands b, ρ and r [m].
        ("box", np.float64, (3,)),
        ("disc", np.float64),
        ("ball", np.float64),
        # The size of the grid of vertex lists, see `extreme_vertices`, and the index of the body's first list.
        ("grid", np.intp),
        ("first_cell", np.intp),
        # For a solid of cells: the body of a cell of the lowest level, and the first node of the solid's tree.
        # Both are 0 if the body is no solid.
        ("levels", np.intp),
        ("root", np.intp),
    ],
    align=True,
)
NODE = np.dtype(
    [
        # The centre of a cell in the frame of the solid.
        ("centre", np.float64, (3,)),
        ("level", np.intp),
        # The number of nodes of the subtree, which follows the node.
        ("size", np.uintp),
    ],
    align=True,
)
POSE = np.dtype(
    [
        # The pose of a body in the world, and the centre of its bounding ball.
        ("rotation", np.float64, (3, 3)),
        ("origin", np.float64, (3,)),
        ("centre", np.float64, (3,)),
    ],
    align=True,
)

# The search for an axis ends after STEPS steps, or if the lower bound is at least the share TIGHT of the upper one, or
# EXACT if the nearest points are wanted.
cdef enum:
    STEPS = 32
cdef double TIGHT = 0.9
cdef double EXACT = 1.0 - 1e-6
# Bodies at most this far apart count as overlapping [m].
cdef double OVERLAPPING = 1e-12
# Cells of solids above this level are only bounded by balls and boxes.
cdef enum:
    HIGHEST_LEVEL = 3
    # More cells along a side of the grid of a body's lists would take 6·1024² lists.
    MOST_CELLS = 1024
# If bounds need not be tight, cells smaller than this share of the distance beyond `least` are not divided.
cdef double FINE = 0.3
# Triangles in which the squared sine of an angle is below this count as segments.
cdef double FLAT = 1e-12
# Cells of vertex lists overlap by this, so that a direction on a border may be looked up in either cell.
cdef double CELL_OVERLAP = 1e-9


# An array of one of the types above.
Records = np.ndarray


cdef class ShapeTable:
    """Convex bodies for compiled code, and the lists and trees that they refer to.

    Parameters
    ----------
    bodies : ndarray of shape (G,) and type `BODY`
        The bodies.
    starts : ndarray of intp, shape (C + 1,)
        Where the lists of vertices begin, and where the last one ends.
    vertices : ndarray, shape (E, 3)
        The lists of vertices [m]. No list is empty.
    nodes : ndarray of shape (N,) and type `NODE`
        The trees of solids of cells.

    Raises
    ------
    InputError
        If an index is outside of its table.
    """

    def __init__(self, bodies, starts, vertices, nodes):
        cdef const Body[::1] body = bodies
        cdef const Py_ssize_t[::1] start = starts
        cdef const double[:, ::1] vertex = vertices
        cdef const Node[::1] node = nodes
        cdef Py_ssize_t C = start.shape[0] - 1, g, c, k, last
        if C < 1 or vertex.shape[1] != 3 or start[0] != 0 or start[C] != vertex.shape[0]:
            raise InputError("starts must lead from 0 to the number of the vertices (E, 3)")
        for c in range(C):
            if not start[c] < start[c + 1]:
                raise InputError(f"list {c} of vertices is empty")
        for k in range(node.shape[0]):
            _check_node(node, k)
        for g in range(body.shape[0]):
            last = C + 1
            if 0 <= body[g].grid <= MOST_CELLS and 0 <= body[g].first_cell <= C:
                last = body[g].first_cell + max(1, 6 * body[g].grid * body[g].grid)
            if body[g].joint < 0 or last > C:
                raise InputError(f"body {g} refers to a joint or to lists of vertices that there are not")
            if body[g].levels:
                if not 0 <= body[g].root < node.shape[0]:
                    raise InputError(f"body {g}: there is no node {body[g].root}")
                last = body.shape[0] - node[body[g].root].level
                if not 0 < body[g].levels < last:
                    raise InputError(f"body {g}: there is no body for each level of its cells")
        self.bodies, self.starts, self.vertices, self.nodes = bodies, starts, vertices, nodes
        self.count = body.shape[0]
        self.bounded = bool(np.isfinite(bodies["reach"]).all())
        self.data.body = &body[0] if self.count else NULL
        self.data.starts, self.data.vertices = &start[0], &vertex[0, 0]
        self.data.nodes = &node[0] if node.shape[0] else NULL

    def __reduce__(self):
        return ShapeTable, (self.bodies, self.starts, self.vertices, self.nodes)

    cdef Pose *new_poses(self) except NULL:
        """Return new memory with the poses of the bodies that no joint carries, and room for the others."""
        cdef Pose *poses = <Pose *> malloc(max(self.count, 1) * sizeof(Pose))
        cdef Py_ssize_t g
        if not poses:
            raise MemoryError
        for g in range(self.count):
            place_still(&self.data.body[g], &poses[g])
        return poses

    def distance_bounds(self, Py_ssize_t a, Py_ssize_t b, axis, double enough, double least):
        """Return the lower and the upper bound [m] of the distance of two bodies that no joint carries.

        The search begins with an axis (3,), and ends if the lower bound is at least `enough` [m], or the upper bound is
        below `least`.
        """
        cdef Bodies bodies = self.data
        cdef Search search
        cdef Bounds found
        cdef Vector way = _vector("axis", axis)
        self._check_body(min(a, b))
        self._check_body(max(a, b))
        search.axis[0], search.axis[1], search.axis[2] = way.x, way.y, way.z
        bodies.pose = self.new_poses()
        found = distance_bounds(&bodies, a, b, &search, enough, least, False)
        free(bodies.pose)
        return found.lower, found.upper

    def support(self, Py_ssize_t g, direction):
        """Return the support point (3,) [m] of a body that no joint carries, without its ball."""
        cdef Bodies bodies = self.data
        cdef Vector found, way = _vector("direction", direction)
        self._check_body(g)
        bodies.pose = self.new_poses()
        found = support(&bodies, g, way.x, way.y, way.z)
        free(bodies.pose)
        return np.array([found.x, found.y, found.z])

    cdef int _check_body(self, Py_ssize_t g) except -1:
        if not (0 <= g < self.count and self.data.body[g].joint == 0):
            raise InputError(f"there is no body {g} that no joint carries")
        return 0

    def farthest_from_axes(
        self, const double[:, ::1] centers, const double[:, ::1] axes, const double[::1] radii,
        const double[::1] half_lengths,
    ):
        """Return bounds (G, m) [m] of the largest distances of bodies that no joint carries from m axes.

        The axes may be anywhere on cylinders about unit `axes: (m, 3)` through `centers: (m, 3)`, with `radii: (m,)`
        and half lengths [m], as the ends of their links. If a half length is infinite, the axis is at its center.
        """
        cdef Py_ssize_t m = axes.shape[0], g, k, i, first, last, corners
        if centers.shape[0] != m or radii.shape[0] != m or half_lengths.shape[0] != m:
            raise InputError("centers, axes, radii and half lengths must be of as many axes each")
        if centers.shape[1] != 3 or axes.shape[1] != 3:
            raise InputError("centers and axes must have 3 columns")
        found = np.zeros((self.count, m))
        cdef double[:, ::1] far = found
        cdef const Body *body
        cdef const double *v
        cdef double x, y, z, a, b, c, along, away
        with nogil:
            for g in range(self.count):
                body = &self.data.body[g]
                first, last = body.first_cell, body.first_cell + max(1, 6 * body.grid * body.grid)
                corners = 8 if body.box[0] + body.box[1] + body.box[2] + body.disc > 0.0 else 1
                for k in range(corners * (self.data.starts[last] - self.data.starts[first])):
                    v = self.data.vertices + 3 * (self.data.starts[first] + k // corners)
                    x = v[0] + (body.box[0] + body.disc) * (1.0 - 2.0 * (k & 1))
                    y = v[1] + (body.box[1] + body.disc) * (1.0 - (k & 2))
                    z = v[2] + body.box[2] * (1.0 - 0.5 * (k & 4))
                    for i in range(m):
                        a = _coordinate(body, 0, x, y, z) - centers[i, 0]
                        b = _coordinate(body, 1, x, y, z) - centers[i, 1]
                        c = _coordinate(body, 2, x, y, z) - centers[i, 2]
                        along = a * axes[i, 0] + b * axes[i, 1] + c * axes[i, 2]
                        a, b, c = a - along * axes[i, 0], b - along * axes[i, 1], c - along * axes[i, 2]
                        away = sqrt(a * a + b * b + c * c)
                        if half_lengths[i] < INFINITY:
                            a, b = away + radii[i], fabs(along) + half_lengths[i]
                            away = sqrt(a * a + b * b)
                        far[g, i] = max(away + body.ball, far[g, i] if k > 0 else 0.0)
        return found


cdef int _check_node(const Node[::1] nodes, Py_ssize_t k) except -1:
    """Raise InputError unless a node and its descendants, which follow it, are a tree of decreasing levels."""
    cdef size_t below = nodes.shape[0] - k - 1, child, end
    if not (0 < nodes[k].size <= below + 1 and nodes[k].level >= 0 and (nodes[k].level == 0) == (nodes[k].size == 1)):
        raise InputError(f"node {k} has level {nodes[k].level} and size {nodes[k].size}, and {below} nodes follow")
    child, end = k + 1, k + nodes[k].size
    while child < end:
        if not (0 < nodes[child].size <= end - child and nodes[child].level < nodes[k].level):
            raise InputError(f"node {child} does not fit in node {k}")
        child += nodes[child].size
    return 0


cdef Vector _vector(str name, given) except *:
    cdef const double[::1] found = np.ascontiguousarray(given, dtype=np.float64)
    if found.shape[0] != 3:
        raise InputError(f"{name} must have 3 numbers, got {found.shape[0]}")
    return Vector(found[0], found[1], found[2])


cdef inline double _coordinate(const Body *body, Py_ssize_t k, double x, double y, double z) noexcept nogil:
    """Return a coordinate of a point of the body's frame, in the frame that carries the body."""
    return body.rotation[k][0] * x + body.rotation[k][1] * y + body.rotation[k][2] * z + body.translation[k]


cdef inline Vector support(const Bodies *bodies, Py_ssize_t g, double x, double y, double z) noexcept nogil:
    """Return the support point of a body, without its ball, in the direction (x, y, z) of the world."""
    cdef const Body *body = &bodies.body[g]
    cdef const Pose *pose = &bodies.pose[g]
    cdef double a = pose.rotation[0][0] * x + pose.rotation[1][0] * y + pose.rotation[2][0] * z
    cdef double b = pose.rotation[0][1] * x + pose.rotation[1][1] * y + pose.rotation[2][1] * z
    cdef double c = pose.rotation[0][2] * x + pose.rotation[1][2] * y + pose.rotation[2][2] * z
    cdef Py_ssize_t cell = body.first_cell + cell_of(a, b, c, body.grid), k
    cdef const double *best = bodies.vertices + 3 * bodies.starts[cell]
    cdef const double *vertex
    cdef double most = a * best[0] + b * best[1] + c * best[2], height, u, v, w, across
    for k in range(bodies.starts[cell] + 1, bodies.starts[cell + 1]):
        vertex = bodies.vertices + 3 * k
        height = a * vertex[0] + b * vertex[1] + c * vertex[2]
        if height > most:
            best, most = vertex, height
    u = best[0] + (body.box[0] if a >= 0 else -body.box[0])
    v = best[1] + (body.box[1] if b >= 0 else -body.box[1])
    w = best[2] + (body.box[2] if c >= 0 else -body.box[2])
    if body.disc > 0:
        across = sqrt(a * a + b * b)
        if across > 0:
            u += body.disc * a / across
            v += body.disc * b / across
    return Vector(
        pose.rotation[0][0] * u + pose.rotation[0][1] * v + pose.rotation[0][2] * w + pose.origin[0],
        pose.rotation[1][0] * u + pose.rotation[1][1] * v + pose.rotation[1][2] * w + pose.origin[1],
        pose.rotation[2][0] * u + pose.rotation[2][1] * v + pose.rotation[2][2] * w + pose.origin[2],
    )


cdef Bounds distance_bounds(
    const Bodies *bodies, Py_ssize_t a, Py_ssize_t b, Search *search, double enough, double least, bint exact
) noexcept nogil:
    """Return a lower and an upper bound of the distance [m] of bodies a and b. If they overlap, the upper one is −∞.

    The algorithm of Gilbert, Johnson and Keerthi. It begins with the search's axis from b to a. It ends if the lower
    bound is `enough`, or tight and above `least`, or if the upper bound is at most `least`. The best axis is stored in
    the search. If the bounds are to be `exact` they are tight to a millionth, and the simplex has points of a − b, each
    beside the point of a, without its ball. Body b may be a solid of cells.
    """
    if bodies.body[b].levels > 0:
        return _cell_bounds(bodies, a, b, search, enough, least, exact)
    return _convex_bounds(bodies, a, b, search, enough, least, exact)


cdef Bounds _convex_bounds(
    const Bodies *bodies, Py_ssize_t a, Py_ssize_t b, Search *search, double enough, double least, bint exact
) noexcept nogil:
    """Compute the result of `distance_bounds` for two convex bodies."""
    cdef double balls = bodies.body[a].ball + bodies.body[b].ball, tight = EXACT if exact else TIGHT
    cdef double lower = -INFINITY, upper = INFINITY, bound, between, u, v, w
    cdef Vector axis = Vector(search.axis[0], search.axis[1], search.axis[2]), p, q
    cdef int corners = 0, _
    cdef double *row
    for _ in range(STEPS):
        p = support(bodies, a, -axis.x, -axis.y, -axis.z)
        q = support(bodies, b, axis.x, axis.y, axis.z)
        u, v, w = p.x - q.x, p.y - q.y, p.z - q.z
        bound = (u * axis.x + v * axis.y + w * axis.z) / sqrt(
            axis.x * axis.x + axis.y * axis.y + axis.z * axis.z
        ) - balls
        if bound > lower:
            lower = bound
            search.axis[0], search.axis[1], search.axis[2] = axis.x, axis.y, axis.z
        if lower >= enough or (lower > least and lower >= tight * upper):
            break
        row = search.simplex[corners]
        row[0], row[1], row[2], row[3], row[4], row[5] = u, v, w, p.x, p.y, p.z
        corners = nearest_in_simplex(search.simplex, corners + 1, &axis)
        between = sqrt(axis.x * axis.x + axis.y * axis.y + axis.z * axis.z)
        if corners == 4 or between < OVERLAPPING:
            return Bounds(lower, -INFINITY, corners)
        upper = between - balls
        if upper <= least:
            break
    return Bounds(lower, upper, corners)


cdef void _place_cell(const Node *node, const Pose *solid, Pose *pose) noexcept nogil:
    """Write the pose of a cell of a solid at a pose, but for the rotation, which is the same."""
    cdef Py_ssize_t x
    for x in range(3):
        pose.centre[x] = pose.origin[x] = (
            solid.origin[x] + solid.rotation[x][0] * node.centre[0] + solid.rotation[x][1] * node.centre[1]
            + solid.rotation[x][2] * node.centre[2]
        )


cdef size_t _likely_cell(const Node *nodes, size_t root, const Pose *solid, const double *point) noexcept nogil:
    """Return a cell of the lowest level near a point of the world: the nearest cell on each level is followed."""
    cdef double x = point[0] - solid.origin[0], y = point[1] - solid.origin[1], z = point[2] - solid.origin[2]
    cdef double a = solid.rotation[0][0] * x + solid.rotation[1][0] * y + solid.rotation[2][0] * z
    cdef double b = solid.rotation[0][1] * x + solid.rotation[1][1] * y + solid.rotation[2][1] * z
    cdef double c = solid.rotation[0][2] * x + solid.rotation[1][2] * y + solid.rotation[2][2] * z
    cdef size_t best = root, k, end
    cdef double square, least, u, v, w
    while nodes[best].level > 0:
        # The first one below is taken if no distance is a number.
        k, end, least = best + 1, best + nodes[best].size, INFINITY
        best += 1
        while k < end:
            u, v, w = nodes[k].centre[0] - a, nodes[k].centre[1] - b, nodes[k].centre[2] - c
            square = u * u + v * v + w * w
            if square < least:
                best, least = k, square
            k += nodes[k].size
    return best


cdef Bounds _cell_bounds(
    const Bodies *bodies, Py_ssize_t a, Py_ssize_t b, Search *search, double enough, double least, bint exact
) noexcept nogil:
    """Compute the result of `distance_bounds` for a convex body and a solid of cells.

    Cells that are not nearer than the nearest cell so far are skipped with their descendants, by bounding balls, by
    ball and box, and by GJK. A cell that is probably near is evaluated first.
    """
    cdef const Body *body = &bodies.body[a]
    cdef const Pose *pose = &bodies.pose[a]
    cdef const Pose *solid = &bodies.pose[b]
    cdef const double *at = &pose.centre[0]
    cdef const Node *nodes = bodies.nodes
    cdef const Body *cell
    cdef Pose *place
    cdef size_t root = bodies.body[b].root, end = root + nodes[root].size, here
    cdef size_t k = _likely_cell(nodes, root, solid, at), nearest = k
    cdef Py_ssize_t first = bodies.body[b].levels, level
    cdef double bound = enough, upper = INFINITY, x, y, z, far
    cdef bint begun = False
    cdef Vector way
    cdef Bounds found
    while k < end:
        here = k
        k = k + nodes[k].size if begun else root
        begun, level = True, nodes[here].level
        cell, place = &bodies.body[first + level], &bodies.pose[first + level]
        _place_cell(&nodes[here], solid, place)
        x, y, z = at[0] - place.centre[0], at[1] - place.centre[1], at[2] - place.centre[2]
        far = bound + cell.reach + body.reach
        if x * x + y * y + z * z >= far * far:
            continue
        way = from_box(body, pose, place.centre)
        far = bound + cell.reach
        if way.x * way.x + way.y * way.y + way.z * way.z >= far * far:
            continue
        way = from_box(cell, place, at)
        far = bound + body.reach
        if way.x * way.x + way.y * way.y + way.z * way.z >= far * far:
            continue
        found = Bounds(-INFINITY, INFINITY, 0)
        if level <= HIGHEST_LEVEL:
            begin_axis(search.axis, way, x, y, z)
            found = _convex_bounds(bodies, a, first + level, search, bound, least, exact)
        if found.lower >= bound:
            continue
        if level > 0 and (exact or not 2.0 * cell.reach <= FINE * (found.lower - max(least, 0.0))):
            k = here + 1
            continue
        bound, nearest = found.lower, here
        if level == 0:
            upper = min(upper, found.upper)
            if upper <= least:
                break
    if not exact or not bound < enough:
        return Bounds(bound, upper, 0)
    place = &bodies.pose[first]
    _place_cell(&nodes[nearest], solid, place)
    begin_axis(
        search.axis, Vector(0.0, 0.0, 0.0), at[0] - place.centre[0], at[1] - place.centre[1], at[2] - place.centre[2]
    )
    return _convex_bounds(bodies, a, first, search, INFINITY, least, exact)


cdef double distance_bound(
    const Bodies *bodies, Py_ssize_t a, Py_ssize_t b, Search *search, double enough
) noexcept nogil:
    """Return a lower bound of the distance [m] of bodies a and b; −∞ instead of NaN.

    First the bounding balls are used, then the box of b and the ball of a, then `distance_bounds`. The search ends if a
    bound is at least `enough` [m], or cannot become so large. The search's best axis is kept for the next call; zeros
    mean no axis.
    """
    cdef const double *p = bodies.pose[a].centre
    cdef const double *q = bodies.pose[b].centre
    cdef double x = p[0] - q[0], y = p[1] - q[1], z = p[2] - q[2], reach = bodies.body[a].reach
    cdef double lower = sqrt(x * x + y * y + z * z) - reach - bodies.body[b].reach
    cdef Vector way
    if lower < enough:
        way = from_box(&bodies.body[b], &bodies.pose[b], p)
        lower = max(lower, sqrt(way.x * way.x + way.y * way.y + way.z * way.z) - reach)
        if lower < enough:
            if search.axis[0] == 0.0 and search.axis[1] == 0.0 and search.axis[2] == 0.0:
                begin_axis(search.axis, way, x, y, z)
            lower = max(lower, distance_bounds(bodies, a, b, search, enough, enough, False).lower)
    return lower if lower == lower else -INFINITY


# A point of a simplex, and the bits of the corners whose convex hull contains it.
cdef struct Found:
    Vector point
    int between


cdef Found _in_segment(double (*S)[EDGES], int i, int j) noexcept nogil:
    """Return the nearest point of the segment of corners i and j."""
    cdef double *a = S[i]
    cdef double *b = S[j]
    cdef double x = b[0] - a[0], y = b[1] - a[1], z = b[2] - a[2]
    cdef double square = x * x + y * y + z * z, along = -(a[0] * x + a[1] * y + a[2] * z), t
    if along <= 0.0:
        return Found(Vector(a[0], a[1], a[2]), 1 << i)
    if along >= square:
        return Found(Vector(b[0], b[1], b[2]), 1 << j)
    t = along / square
    return Found(Vector(a[0] + t * x, a[1] + t * y, a[2] + t * z), (1 << i) | (1 << j))


cdef Found _in_triangle(double (*S)[EDGES], int i, int j, int k) noexcept nogil:
    """Return the nearest point of the triangle of corners i, j and k."""
    cdef double *a = S[i]
    cdef double *b = S[j]
    cdef double *c = S[k]
    cdef double ux = b[0] - a[0], uy = b[1] - a[1], uz = b[2] - a[2]
    cdef double vx = c[0] - a[0], vy = c[1] - a[1], vz = c[2] - a[2]
    cdef double uu = ux * ux + uy * uy + uz * uz, uv = ux * vx + uy * vy + uz * vz, vv = vx * vx + vy * vy + vz * vz
    cdef double pu = a[0] * ux + a[1] * uy + a[2] * uz, pv = a[0] * vx + a[1] * vy + a[2] * vz
    cdef double area = uu * vv - uv * uv, s, t, square, least = INFINITY
    cdef Found best, found
    cdef int n
    if area > FLAT * uu * vv:
        s, t = (uv * pv - vv * pu) / area, (uv * pu - uu * pv) / area
        if s > 0.0 and t > 0.0 and s + t < 1.0:
            return Found(
                Vector(a[0] + s * ux + t * vx, a[1] + s * uy + t * vy, a[2] + s * uz + t * vz),
                (1 << i) | (1 << j) | (1 << k),
            )
    best = _in_segment(S, i, j)
    for n in range(3):
        found = best if n == 0 else (_in_segment(S, i, k) if n == 1 else _in_segment(S, j, k))
        square = found.point.x * found.point.x + found.point.y * found.point.y + found.point.z * found.point.z
        if square < least:
            best, least = found, square
    return best


cdef bint _hides(double (*S)[EDGES], int i, int j, int k, int opposite) noexcept nogil:
    """Return whether the face of corners i, j and k separates the origin from the fourth corner."""
    cdef double *a = S[i]
    cdef double *b = S[j]
    cdef double *c = S[k]
    cdef double *d = S[opposite]
    cdef double ux = b[0] - a[0], uy = b[1] - a[1], uz = b[2] - a[2]
    cdef double vx = c[0] - a[0], vy = c[1] - a[1], vz = c[2] - a[2]
    cdef double x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx
    cdef double to_origin = -(x * a[0] + y * a[1] + z * a[2])
    cdef double to_corner = x * d[0] + y * d[1] + z * d[2] + to_origin
    return not to_origin * to_corner > 0.0


cdef int nearest_in_simplex(double (*simplex)[EDGES], int corners, Vector *nearest) noexcept nogil:
    """Compute the point of a simplex with `corners` corners nearest to the origin, as a combination of few corners.

    Return the number of these corners. Their rows are moved to the front.
    """
    cdef Found found, face
    cdef double least = INFINITY, square
    cdef int opposite, i, j, k, count = 0, column
    if corners == 1:
        nearest[0] = Vector(simplex[0][0], simplex[0][1], simplex[0][2])
        return 1
    if corners == 2:
        found = _in_segment(simplex, 0, 1)
    elif corners == 3:
        found = _in_triangle(simplex, 0, 1, 2)
    else:
        found = Found(Vector(0.0, 0.0, 0.0), 15)
        for opposite in range(4):
            i, j, k = (opposite + 1) % 4, (opposite + 2) % 4, (opposite + 3) % 4
            if _hides(simplex, i, j, k, opposite):
                face = _in_triangle(simplex, i, j, k)
                square = face.point.x * face.point.x + face.point.y * face.point.y + face.point.z * face.point.z
                if square < least:
                    found, least = face, square
    for i in range(corners):
        if found.between >> i & 1:
            for column in range(EDGES):
                simplex[count][column] = simplex[i][column]
            count += 1
    nearest[0] = found.point
    return count


cdef inline Py_ssize_t cell_of(double x, double y, double z, Py_ssize_t grid) noexcept nogil:
    """Return the cell of a direction on six sides (±x, ±y, ±z) of grid × grid cells; 0 without a grid."""
    cdef double ax = fabs(x), ay = fabs(y), az = fabs(z), major = az, u = x, v = y
    cdef Py_ssize_t side = 4 if z > 0 else 5
    if grid == 0:
        return 0
    if ax >= ay and ax >= az:
        side, major, u, v = 0 if x > 0 else 1, ax, y, z
    elif ay >= az:
        side, major, u, v = 2 if y > 0 else 3, ay, z, x
    if not major > 0.0:
        return 0
    return (side * grid + _cell_along(v / major, grid)) * grid + _cell_along(u / major, grid)


cdef inline Py_ssize_t _cell_along(double share, Py_ssize_t grid) noexcept nogil:
    """Return the cell of a coordinate from −1 to 1; the last cell of NaN, which has no integer value."""
    cdef double place = (share + 1.0) * (0.5 * grid)
    return <Py_ssize_t> place if 0.0 <= place < grid - 1 else grid - 1


def extreme_vertices(const double[:, ::1] vertices, Py_ssize_t grid):
    """Return the lists of candidates for the support vertex: offsets (6g² + 1,) of the cells, and indices (E,).

    `vertices: (V, 3)` are any points; points inside the hull are left out. `grid` is g ≥ 1. The cube about the origin
    has g × g cells on each side. The directions through a cell are the cone of its corners c_1 … c_4. A vertex v is
    left out there if another vertex w has c_j·w ≥ c_j·v for all corners. So the support vertex of every direction is in
    the list of its cell.
    """
    cdef Py_ssize_t V = vertices.shape[0], cells = 6 * grid * grid, number = 0, count, remaining
    cdef Py_ssize_t cell, side, row, column, j, k, n, other
    cdef double width = 2.0 / grid, u, v
    cdef bint beaten
    cdef Vector corner
    if vertices.shape[1] != 3 or not 1 <= grid <= MOST_CELLS:
        raise InputError(f"vertices must be (V, 3) and the grid from 1 to {MOST_CELLS}, got {grid}")
    first, lists, corner_heights, remain = np.empty(cells + 1, np.intp), [], np.empty((V, 4)), np.empty(V, np.intp)
    cdef Py_ssize_t[::1] starts = first
    cdef Py_ssize_t[::1] kept = remain
    cdef double[:, ::1] heights = corner_heights
    for cell in range(cells):
        with nogil:
            starts[cell] = number
            side, row, column, count = cell // (grid * grid), cell // grid % grid, cell % grid, 0
            for j in range(4):
                u = width * (column + j % 2) - 1.0 + (CELL_OVERLAP if j % 2 else -CELL_OVERLAP)
                v = width * (row + j // 2) - 1.0 + (CELL_OVERLAP if j // 2 else -CELL_OVERLAP)
                corner = _corner(side, u, v)
                for k in range(V):
                    heights[k, j] = corner.x * vertices[k, 0] + corner.y * vertices[k, 1] + corner.z * vertices[k, 2]
            for k in range(V):
                remaining, beaten = 0, False
                for n in range(count):
                    other = kept[n]
                    if _beats(heights, other, k):
                        beaten = True
                        break
                    if not _beats(heights, k, other):
                        kept[remaining] = other
                        remaining += 1
                if not beaten:
                    kept[remaining] = k
                    count = remaining + 1
            number += count
        lists.append(remain[:count].copy())
    starts[cells] = number
    return first, np.concatenate(lists)


cdef inline Vector _corner(Py_ssize_t side, double u, double v) noexcept nogil:
    """Return a direction through a side of the cube about the origin."""
    cdef double sign = 1.0 if side % 2 == 0 else -1.0
    if side < 2:
        return Vector(sign, u, v)
    if side < 4:
        return Vector(v, sign, u)
    return Vector(u, v, sign)


cdef inline bint _beats(const double[:, ::1] heights, Py_ssize_t k, Py_ssize_t other) noexcept nogil:
    """Return whether vertex k is at least as high as another vertex in the directions of all corners."""
    return (
        heights[k, 0] >= heights[other, 0]
        and heights[k, 1] >= heights[other, 1]
        and heights[k, 2] >= heights[other, 2]
        and heights[k, 3] >= heights[other, 3]
    )
