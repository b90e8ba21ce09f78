"""Bounds of the speeds of a robot's bodies along cells of a curve, and of the distances of people from the bodies."""

from libc.math cimport INFINITY, sqrt
from libc.stdlib cimport free

from safe_ompl.geometry.convex cimport (
    Bodies, Body, Search, ShapeTable, Vector, begin_axis, distance_bound, distance_bounds, from_box, place_moving,
)
from safe_ompl.robot.kinematics cimport JointTable, move_joints, place_joints

import numpy as np

from safe_ompl.common import InputError
from safe_ompl.geometry import DISTANCE_ERROR

# Bound of the rounding error of a requested distance [m].
cdef double DISTANCE_ROUNDING = 1e-9
cdef double COAL_ERROR = DISTANCE_ERROR


cdef class BodyCorners:
    """Corners of the boxes around G bodies, which joints carry.

    Parameters
    ----------
    joints : JointTable
        The m joints of Pinocchio's model.
    carriers : ndarray of intp, shape (G,)
        Pinocchio's index of the joint that carries each body; 0: the base.
    corners : ndarray, shape (G, 8, 3)
        The corners in the frame of that joint [m].
    pads : ndarray, shape (G,)
        Padding of the boxes on all sides [m].
    """

    cdef readonly JointTable joints
    cdef const Py_ssize_t[::1] carriers
    cdef const double[:, :, ::1] corners
    cdef const double[::1] pads
    cdef object _given

    def __init__(self, JointTable joints not None, carriers, corners, pads):
        self._given = joints, carriers, corners, pads
        self.joints, self.carriers, self.corners, self.pads = joints, carriers, corners, pads
        cdef Py_ssize_t G = self.carriers.shape[0]
        if np.shape(corners) != (G, 8, 3) or self.pads.shape[0] != G:
            raise InputError(f"corners must have shape ({G}, 8, 3), and pads ({G},)")
        _check_range("carriers", self.carriers, 0, joints.m + 1)

    def __reduce__(self):
        return BodyCorners, self._given

    def speeds(self, const double[:, ::1] values, const double[:, ::1] rates):
        """Return speed bounds (B, G) of the points of the boxes at joint `values` and `rates` (B, m)."""
        cdef Py_ssize_t B = values.shape[0], m = self.joints.m, G = self.carriers.shape[0], b, g, k, joint
        cdef double most, x, y, z, u, v, w
        cdef const double *p
        cdef const double *R
        cdef const double *o
        cdef const double *twist
        _check_shape("values", values, B, m)
        _check_shape("rates", rates, B, m)
        found = np.zeros((B, G))
        cdef double[:, ::1] fastest = found
        cdef double[::1] memory = np.empty(21 * m + 1)
        cdef double *rotation = &memory[0]
        cdef double *origin = rotation + 9 * m
        cdef double *axis = origin + 3 * m
        cdef double *twists = axis + 3 * m
        with nogil:
            for b in range(B if m else 0):
                place_joints(self.joints.data, m, &values[b, 0], rotation, origin, axis)
                move_joints(self.joints.data, m, &rates[b, 0], origin, axis, twists)
                for g in range(G):
                    joint = self.carriers[g] - 1
                    if joint < 0:
                        continue
                    twist, R, o = twists + 6 * joint, rotation + 9 * joint, origin + 3 * joint
                    most = 0.0
                    for k in range(8):
                        p = &self.corners[g, k, 0]
                        x = o[0] + R[0] * p[0] + R[1] * p[1] + R[2] * p[2]
                        y = o[1] + R[3] * p[0] + R[4] * p[1] + R[5] * p[2]
                        z = o[2] + R[6] * p[0] + R[7] * p[1] + R[8] * p[2]
                        u, v = twist[3] + twist[1] * z - twist[2] * y, twist[4] + twist[2] * x - twist[0] * z
                        w = twist[5] + twist[0] * y - twist[1] * x
                        most = max(most, u * u + v * v + w * w)
                    fastest[b, g] = sqrt(most) + self.pads[g] * sqrt(
                        twist[0] * twist[0] + twist[1] * twist[1] + twist[2] * twist[2]
                    )
        return found


def acceleration_bounds(
    const double[:, ::1] radii, turned, const double[:, ::1] dq_ds, const double[:, ::1] d2q_ds2
):
    """Return bounds (N, G) of ‖x″‖ of every point of G bodies along a curve, by arc length; see `BodySpeeds`.

    `radii: (G, m)` are R̄ of the m joints of the model. `turned` tells which of the joints are revolute and move each
    body. `dq_ds` and `d2q_ds2`, (N, m), are bounds of the joints' |q′| and |q″|.
    """
    cdef const unsigned char[:, ::1] turns = np.ascontiguousarray(turned, dtype=np.bool_).view(np.uint8)
    cdef Py_ssize_t N = dq_ds.shape[0], m = dq_ds.shape[1], G = radii.shape[0], k, g, j
    cdef double below, turn, bound
    _check_shape("radii", radii, G, m)
    _check_shape("d2q_ds2", d2q_ds2, N, m)
    if turns.shape[0] != G or turns.shape[1] != m:
        raise InputError(f"turned must have shape ({G}, {m}), got ({turns.shape[0]}, {turns.shape[1]})")
    found = np.zeros((N, G))
    cdef double[:, ::1] bounds = found
    with nogil:
        for k in range(N):
            for g in range(G):
                below, bound = 0.0, 0.0
                for j in range(m):
                    turn = dq_ds[k, j] if turns[g, j] else 0.0
                    bound += radii[g, j] * (dq_ds[k, j] * (2 * below + turn) + d2q_ds2[k, j])
                    below += turn
                bounds[k, g] = bound
    return found


cdef class ClosingGaps:
    """The P gaps, between two bodies of a robot or a body and a fixed obstacle, in which limbs may be clamped.

    Parameters
    ----------
    joints : JointTable
        The m joints of Pinocchio's model.
    shapes : ShapeTable
        The bodies; G of them move.
    pairs : ndarray of intp, shape (P, 2)
        The bodies of each gap.
    sides : ndarray of intp, shape (P, 2)
        The bodies of each gap as indices among the moving bodies, where G means a fixed body. The first body moves.
    radii : ndarray, shape (P, m)
        Bound of the closing of the gap by each joint [m/rad]; 1 for prismatic joints.
    widths : ndarray, shape (K,)
        Widths of limbs [m].
    harmless : ndarray, shape (K,)
        Largest closing speed, as a share of the body's speed, at which clamping a limb is no worse than contact.
    """

    cdef readonly JointTable joints
    cdef readonly ShapeTable shapes
    cdef const Py_ssize_t[:, ::1] pairs
    cdef const Py_ssize_t[:, ::1] sides
    cdef const double[:, ::1] radii
    cdef const double[::1] widths
    cdef const double[::1] harmless
    cdef object _given

    def __init__(self, JointTable joints not None, ShapeTable shapes not None, pairs, sides, radii, widths, harmless):
        self._given = joints, shapes, pairs, sides, radii, widths, harmless
        self.joints, self.shapes = joints, shapes
        self.pairs, self.sides, self.radii, self.widths, self.harmless = pairs, sides, radii, widths, harmless
        cdef Py_ssize_t P = self.pairs.shape[0]
        _check_shape("radii", self.radii, P, joints.m)
        if self.pairs.shape[1] != 2 or self.sides.shape[0] != P or self.sides.shape[1] != 2:
            raise InputError(f"pairs and sides must have shape ({P}, 2)")
        if self.harmless.shape[0] != self.widths.shape[0]:
            raise InputError(f"harmless must have {self.widths.shape[0]} rows, got {self.harmless.shape[0]}")
        _check_range("pairs", pairs.ravel(), 0, shapes.count)
        _check_carried(joints, shapes)

    def __reduce__(self):
        return ClosingGaps, self._given

    def rates(
        self, const double[:, ::1] values, const double[::1] sizes, const double[:, ::1] dq_ds,
        const double[:, ::1] bodies,
    ):
        """Return the largest closing speeds (N, G, K) of the gaps of each body in which a limb may fit, by width.

        Speeds are by arc length [m/rad]. Gaps that close at a harmless speed do not count. Distances are computed only
        for gaps that close faster than another gap of the body in which the limb fits. `values: (N, m)` are the joint
        values at the centres of cells with `sizes` (N,). `dq_ds: (N, m)` are bounds of |q′|, and `bodies: (N, G + 1)`
        of the speeds of the moving bodies, with a last column of 0.
        """
        cdef Py_ssize_t N = values.shape[0], m = self.joints.m, G = bodies.shape[1] - 1, K = self.widths.shape[0]
        cdef Py_ssize_t P = self.pairs.shape[0], row, p, g, i, k, a, b, x
        cdef double rate, half, apart, width
        cdef Bodies placed = self.shapes.data
        cdef Search search
        _check_shape("values", values, N, m)
        _check_shape("dq_ds", dq_ds, N, m)
        _check_shape("bodies", bodies, N, G + 1)
        if sizes.shape[0] != N:
            raise InputError(f"sizes must have {N} rows, got {sizes.shape[0]}")
        for p in range(P):
            if not (0 <= self.sides[p, 0] < G and 0 <= self.sides[p, 1] <= G):
                raise InputError(f"the bodies of gap {p} must be among {G} that move, the second may stand still: {G}")
        found = np.zeros((N, G, K))
        cdef double[:, :, ::1] closing = found
        cdef double[:, ::1] axes = np.zeros((P, 3))
        cdef double[::1] memory = np.empty(15 * m + 1)
        cdef double *rotation = &memory[0]
        placed.pose = self.shapes.new_poses()
        with nogil:
            for row in range(N if m else 0):
                place_joints(
                    self.joints.data, m, &values[row, 0], rotation, rotation + 9 * m, rotation + 12 * m
                )
                place_moving(placed.body, self.shapes.count, placed.pose, rotation, rotation + 9 * m)
                for p in range(P):
                    g, rate, a, b = self.sides[p, 0], 0.0, self.pairs[p, 0], self.pairs[p, 1]
                    for i in range(m):
                        rate += self.radii[p, i] * dq_ds[row, i]
                    rate = min(rate, bodies[row, g] + bodies[row, self.sides[p, 1]])
                    half, apart = 0.5 * sizes[row] * rate, -INFINITY
                    for k in range(K - 1, -1, -1):
                        width = self.widths[k]
                        if rate <= max(closing[row, g, k], self.harmless[k] * bodies[row, g]):
                            continue
                        if width < INFINITY and not apart > width:
                            for x in range(3):
                                search.axis[x] = axes[p, x]
                            apart = distance_bound(&placed, a, b, &search, width + half + DISTANCE_ROUNDING) - half
                            for x in range(3):
                                axes[p, x] = search.axis[x]
                        if not apart > width:
                            closing[row, g, k] = rate
        free(placed.pose)
        return found


cdef class LimbArrivals:
    """B moving bodies of a robot, and M limbs of people that may reach the bodies.

    Parameters
    ----------
    joints : JointTable
        The m joints of Pinocchio's model.
    shapes : ShapeTable
        The bodies of the robot and the limbs.
    bodies, limbs : ndarray of intp, shapes (B,) and (M,)
        Indices of bodies and limbs among the shapes.
    speeds : ndarray, shape (M,)
        Largest speeds of the limbs [m/s].
    clearance : float
        Required distance of limbs from bodies [m].
    reaction : float
        Time until the robot brakes [s].
    """

    cdef readonly JointTable joints
    cdef readonly ShapeTable shapes
    cdef const Py_ssize_t[::1] bodies
    cdef const Py_ssize_t[::1] limbs
    cdef const double[::1] speeds
    cdef double clearance, reaction
    cdef object _given

    def __init__(
        self, JointTable joints not None, ShapeTable shapes not None, bodies, limbs, speeds, double clearance,
        double reaction,
    ):
        self._given = joints, shapes, bodies, limbs, speeds, clearance, reaction
        self.joints, self.shapes, self.clearance, self.reaction = joints, shapes, clearance, reaction
        self.bodies, self.limbs, self.speeds = bodies, limbs, speeds
        if self.speeds.shape[0] != self.limbs.shape[0]:
            raise InputError(f"there must be speeds of {self.limbs.shape[0]} limbs, got {self.speeds.shape[0]}")
        _check_range("bodies", self.bodies, 0, shapes.count)
        _check_range("limbs", self.limbs, 0, shapes.count)
        _check_carried(joints, shapes)

    def __reduce__(self):
        return LimbArrivals, self._given

    def along(self, const double[:, ::1] values, const double[:, ::1] half, double soon, double short):
        """Return distances and arrival times (N, M) of limbs, and the body (N, M) that each limb reaches first.

        `values: (N, m)` are joint values at the centres of cells, and bodies move by at most `half: (N, B)` [m] from
        there. Limbs at rest that are far enough away never arrive. A time is tight, up to the motion of bodies in a
        cell, if it is less than `soon` [s], and either the least of its cell or less than `short` [s]. Other times only
        show that the limb does not arrive earlier than the limbs that matter.
        """
        cdef Py_ssize_t N = values.shape[0], m = self.joints.m, B = self.bodies.shape[0], M = self.limbs.shape[0]
        cdef Py_ssize_t row, turn, look, leader, earliest = 0, limb, before, g, a, c, k
        cdef double first, enough, lower, time, x, y, z
        cdef Bodies placed = self.shapes.data
        cdef const Body *body
        cdef const double *p
        cdef const double *q
        cdef double *axis
        cdef Vector way
        cdef Search search
        _check_shape("values", values, N, m)
        _check_shape("half", half, N, B)
        gaps, arrivals, closest = np.full((N, M), np.inf), np.full((N, M), np.inf), np.zeros((N, M), np.intp)
        cdef double[:, ::1] distances = gaps
        cdef double[:, ::1] times = arrivals
        cdef Py_ssize_t[:, ::1] nearest = closest
        # The last separating axis of each body and limb; zeros if there is none yet.
        cdef double[:, :, ::1] axes = np.zeros((B, M, 3))
        cdef double[::1] memory = np.empty(15 * m + 1)
        cdef double *rotation = &memory[0]
        placed.pose = self.shapes.new_poses()
        with nogil:
            for row in range(N if m and B else 0):
                place_joints(
                    self.joints.data, m, &values[row, 0], rotation, rotation + 9 * m, rotation + 12 * m
                )
                place_moving(placed.body, self.shapes.count, placed.pose, rotation, rotation + 9 * m)
                first, leader = INFINITY, earliest
                for turn in range(M):
                    # The limb that arrived first in the previous cell is processed first, so that coarser bounds
                    # suffice for the others.
                    limb = leader if turn == 0 else (turn - 1 if turn <= leader else turn)
                    before = nearest[max(row - 1, 0), limb]
                    for look in range(B):
                        g = before if look == 0 else (look - 1 if look <= before else look)
                        a, c, axis = self.bodies[g], self.limbs[limb], &axes[g, limb, 0]
                        enough = min(min(soon, times[row, limb]), max(first, short))
                        enough = self._reach(limb, enough) + half[row, g] + COAL_ERROR + DISTANCE_ROUNDING
                        p, q, body = placed.pose[a].centre, placed.pose[c].centre, &placed.body[c]
                        x, y, z = p[0] - q[0], p[1] - q[1], p[2] - q[2]
                        lower = sqrt(x * x + y * y + z * z) - placed.body[a].reach - body.reach
                        if lower < enough and axis[0] == 0.0 and axis[1] == 0.0 and axis[2] == 0.0:
                            way = from_box(body, &placed.pose[c], p)
                            lower = max(
                                lower, sqrt(way.x * way.x + way.y * way.y + way.z * way.z) - placed.body[a].reach
                            )
                            begin_axis(axis, way, x, y, z)
                        if lower < enough:
                            for k in range(3):
                                search.axis[k] = axis[k]
                            lower = max(
                                lower, distance_bounds(&placed, a, c, &search, enough, -INFINITY, True).lower
                            )
                            for k in range(3):
                                axis[k] = search.axis[k]
                        lower -= half[row, g] + COAL_ERROR
                        distances[row, limb] = min(distances[row, limb], lower)
                        time = self._arrival(limb, lower)
                        if time < times[row, limb]:
                            times[row, limb], nearest[row, limb] = time, g
                    if times[row, limb] < first and self.speeds[limb] > 0.0:
                        first, earliest = times[row, limb], limb
        free(placed.pose)
        return gaps, arrivals, closest

    cdef double _arrival(self, Py_ssize_t m, double distance) noexcept nogil:
        """Return the arrival time of limb m from a distance; infinite at rest, −∞ if the limb is already too near."""
        cdef double room = distance - self.clearance, speed = self.speeds[m]
        return (room / speed if speed > 0.0 else INFINITY if room > 0.0 else -INFINITY) - self.reaction

    cdef double _reach(self, Py_ssize_t m, double time) noexcept nogil:
        """Return the distance from which limb m does not arrive before a time."""
        cdef double speed = self.speeds[m]
        return self.clearance + (speed * (time + self.reaction) if speed > 0.0 else 0.0)


cdef int _check_carried(JointTable joints, ShapeTable shapes) except -1:
    """Raise InputError unless joints exist for all bodies."""
    cdef Py_ssize_t g
    for g in range(shapes.count):
        if shapes.data.body[g].joint > joints.m:
            raise InputError(f"body {g}: there is no joint {shapes.data.body[g].joint}")
    return 0


cdef int _check_range(str name, const Py_ssize_t[::1] numbers, Py_ssize_t low, Py_ssize_t beyond) except -1:
    """Raise InputError unless all numbers are in the range from `low` to below `beyond`."""
    cdef Py_ssize_t k
    for k in range(numbers.shape[0]):
        if not low <= numbers[k] < beyond:
            raise InputError(f"{name}: must be from {low} to {beyond - 1}, got {numbers[k]}")
    return 0


cdef int _check_shape(str name, const double[:, ::1] array, Py_ssize_t rows, Py_ssize_t columns) except -1:
    if array.shape[0] != rows or array.shape[1] != columns:
        raise InputError(f"{name} must have shape ({rows}, {columns}), got ({array.shape[0]}, {array.shape[1]})")
    return 0
