"""Kinematics of a tree of joints: frames, key points, velocities, and gradients with respect to the joints.

Joint i is revolute or prismatic, with axis a_i and placement (R⁰_i, t⁰_i) in the frame of its parent. If it is revolute

    R_i = R_parent·R⁰_i·exp(q_i [a_i]×),   o_i = o_parent + R_parent·t⁰_i.

If it is prismatic, R_i = R_parent·R⁰_i, and o_i moves by q_i along the axis z_i = R_i·a_i. Parents precede their
children and have Pinocchio's numbers: 0 is the base, and joint i of a table is Pinocchio's joint i + 1.
"""

from libc.math cimport INFINITY, M_PI, fabs, rint, sqrt
from libc.stdlib cimport free, malloc

import numpy as np

from safe_ompl.common import InputError

JOINT = np.dtype(
    [
        ("rotation", np.float64, (3, 3)),
        ("translation", np.float64, (3,)),
        ("axis", np.float64, (3,)),
        ("parent", np.intp),
        ("slides", np.intp),
    ],
    align=True,
)
KEY_POINT = np.dtype([("offset", np.float64, (3,)), ("joint", np.intp)], align=True)


cdef enum:
    # Sweeps of Jacobi's rotations at most. Matrices of six rows need about six.
    SWEEPS = 30

# Rotations end when the elements off the diagonal are below this share of the largest one on it.
cdef double DIAGONAL = 1e-15


cdef struct Frames:
    double *rotation  # (m, 3, 3)
    double *origin    # (m, 3)
    double *axis      # (m, 3)


cdef class JointTable:
    """The m joints of a robot, for compiled code.

    Parameters
    ----------
    table : ndarray of shape (m,) and type `JOINT`
        R⁰, t⁰ [m], the unit axis in the joint's frame, the parent's number, and whether the joint is prismatic. The
        array is not copied and must not change.
    """

    def __init__(self, table):
        cdef const Joint[::1] joints = table
        cdef Py_ssize_t i
        for i in range(joints.shape[0]):
            if not 0 <= joints[i].parent <= i:
                raise InputError(f"joint {i}: its parent is {joints[i].parent}, and must be one of 0 to {i}")
        self.array, self.m = table, joints.shape[0]
        self.data = &joints[0] if self.m else NULL

    def __reduce__(self):
        return JointTable, (self.array,)

    def frames(self, const double[:, ::1] values):
        """Return rotations (B, m, 3, 3), origins (B, m, 3) [m] and world axes (B, m, 3) at `values: (B, m)`."""
        cdef Py_ssize_t B = values.shape[0], b
        rotations, origins, axes = np.empty((B, self.m, 3, 3)), np.empty((B, self.m, 3)), np.empty((B, self.m, 3))
        cdef double[:, :, :, ::1] R = rotations
        cdef double[:, :, ::1] o = origins
        cdef double[:, :, ::1] z = axes
        _check_columns("values", values.shape[1], self.m)
        if self.m:
            with nogil:
                for b in range(B):
                    place_joints(self.data, self.m, &values[b, 0], &R[b, 0, 0, 0], &o[b, 0, 0], &z[b, 0, 0])
        return rotations, origins, axes


cdef class KeyPointTable:
    """K key points that the joints of a robot carry, for compiled code.

    Parameters
    ----------
    table : ndarray of shape (K,) and type `KEY_POINT`
        The offset [m] of each key point in the frame of its joint, and the number of this joint. The array is not
        copied and must not change.
    joints : JointTable
        The joints.
    """

    def __init__(self, table, JointTable joints not None):
        cdef const KeyPoint[::1] keys = table
        cdef Py_ssize_t k
        for k in range(keys.shape[0]):
            if not 0 <= keys[k].joint <= joints.m:
                raise InputError(f"key point {k}: its joint is {keys[k].joint}, and must be one of 0 to {joints.m}")
        self.array, self.joints, self.K = table, joints, keys.shape[0]
        self.data = &keys[0] if self.K else NULL

    def __reduce__(self):
        return KeyPointTable, (self.array, self.joints)

    def places(self, const double[:, ::1] values):
        """Return the key points (B, K, 3) [m] in the world at joint `values: (B, m)`."""
        cdef Py_ssize_t B = values.shape[0], m = self.joints.m, b
        found = np.empty((B, self.K, 3))
        cdef double[:, :, ::1] places = found
        _check_columns("values", values.shape[1], m)
        cdef double *memory = <double *> _room(15 * m)
        cdef Frames frames = _frames(memory, m)
        if self.K:
            with nogil:
                for b in range(B):
                    place_joints(self.joints.data, m, _row(values, b), frames.rotation, frames.origin, frames.axis)
                    place_key_points(self.data, self.K, frames.rotation, frames.origin, &places[b, 0, 0])
        free(memory)
        return found

    def jacobian_transpose_product(self, const double[:, ::1] values, const double[:, :, ::1] forces):
        """Return Σ_k J_kᵀ f_k (B, m) for forces f (B, K, 3) at the key points, at joint `values: (B, m)`."""
        cdef Py_ssize_t B = values.shape[0], m = self.joints.m, K = self.K, b
        found = np.empty((B, m))
        cdef double[:, ::1] out = found
        _check_columns("values", values.shape[1], m)
        _check_forces(forces, B, K)
        cdef double *memory = <double *> _room(15 * m + 6 * m + 3 * K)
        cdef Frames frames = _frames(memory, m)
        cdef double *wrenches = memory + 15 * m
        cdef double *places = wrenches + 6 * m
        if m:
            with nogil:
                for b in range(B):
                    place_joints(self.joints.data, m, &values[b, 0], frames.rotation, frames.origin, frames.axis)
                    place_key_points(self.data, K, frames.rotation, frames.origin, places)
                    _pull(self, frames, places, &forces[b, 0, 0] if K else NULL, wrenches, &out[b, 0])
        free(memory)
        return found

    def motions(self, const double[:, ::1] values, const double[:, ::1] rates):
        """Return positions [m], velocities and accelerations (B, K, 3) of key points at constant `rates: (B, m)`.

        Let r be the vector from the parent's origin to the joint's, v, a, ω and α the motion of the parent, and
        s = z_i q̇_i. A point at r has the velocity v + ω × r and the acceleration a + α × r + ω × (ω × r). A revolute
        joint i adds s to ω and ω × s to α; a prismatic joint adds s to v and 2ω × s to a.
        """
        cdef Py_ssize_t B = values.shape[0], m = self.joints.m, K = self.K, b
        found = np.empty((3, B, K, 3))
        cdef double[:, :, :, ::1] out = found
        _check_columns("values", values.shape[1], m)
        _check_columns("rates", rates.shape[1], m)
        if rates.shape[0] != B:
            raise InputError(f"rates must have {B} rows, as the values have, got {rates.shape[0]}")
        # The first row is the base, which is at rest. The joints follow.
        cdef double *memory = <double *> _room(15 * m + 12 * (m + 1))
        cdef Frames frames = _frames(memory, m)
        cdef double *moving = memory + 15 * m
        if K:
            with nogil:
                for b in range(B):
                    place_joints(self.joints.data, m, _row(values, b), frames.rotation, frames.origin, frames.axis)
                    place_key_points(self.data, K, frames.rotation, frames.origin, &out[0, b, 0, 0])
                    _move_frames(self.joints, frames, _row(rates, b), moving)
                    _move_key_points(self, frames, moving, &out[0, b, 0, 0], &out[1, b, 0, 0], &out[2, b, 0, 0])
        free(memory)
        return found[0], found[1], found[2]

    def motion_gradients(
        self, const double[:, ::1] values, const double[:, ::1] rates, const double[:, :, :, ::1] forces
    ):
        """Return gradients (2, B, m) by joint values and joint rates from gradients by key points.

        `forces: (2, B, K, 3)` are the gradients by positions and by velocities of the key points.

        A rotation of joint i rotates a key point and its velocity relative to the parent of i, and the parent's motion
        acts at another position. With the axis z, the origin o and the parent's angular velocity Ω

            ∂v_k/∂q_i = z × (v_k − v_parent(x_k)) + Ω × (z × (x_k − o));    Ω × z for a prismatic joint.
        """
        cdef Py_ssize_t B = values.shape[0], m = self.joints.m, K = self.K, b, side
        found = np.empty((2, B, m))
        cdef double[:, :, ::1] out = found
        _check_columns("values", values.shape[1], m)
        _check_columns("rates", rates.shape[1], m)
        if rates.shape[0] != B or forces.shape[0] != 2:
            raise InputError("values, rates and forces must have as many rows each")
        _check_forces(forces[0], B, K)
        cdef double *memory = <double *> _room(15 * m + 6 * m + 6 * m + 6 * K)
        cdef Frames frames = _frames(memory, m)
        cdef double *wrenches = memory + 15 * m
        cdef double *twists = wrenches + 6 * m
        cdef double *places = twists + 6 * m
        cdef double *velocities = places + 3 * K
        if m and K:
            with nogil:
                for b in range(B):
                    place_joints(self.joints.data, m, &values[b, 0], frames.rotation, frames.origin, frames.axis)
                    place_key_points(self.data, K, frames.rotation, frames.origin, places)
                    move_joints(self.joints.data, m, &rates[b, 0], frames.origin, frames.axis, twists)
                    key_point_velocities(self.data, K, twists, places, velocities)
                    for side in range(2):
                        _pull(self, frames, places, &forces[side, b, 0, 0], wrenches, &out[side, b, 0])
                    _add_turned(self, frames, twists, places, velocities, &forces[1, b, 0, 0], &out[0, b, 0])
        elif m:
            out[:] = 0.0
        free(memory)
        return found


cdef void _pull(
    KeyPointTable keys, Frames frames, const double *places, const double *forces, double *wrenches, double *out
) noexcept nogil:
    """Write Σ_k J_kᵀ f_k (m,) for forces f (K, 3) at the key points; `wrenches: (m, 6)` is working memory.

    The result of joint i is z_i·F_i if it is prismatic, else z_i·(T_i − o_i × F_i). F and T are the sums of forces and
    torques about the world origin over all key points that the joint moves, summed from the tips to the base.
    """
    cdef Py_ssize_t m = keys.joints.m, i, k, x, y, z, carrier, parent
    cdef const Joint *joints = keys.joints.data
    cdef double *wrench
    cdef const double *origin
    cdef double moved
    for i in range(6 * m):
        wrenches[i] = 0.0
    for k in range(keys.K):
        carrier = keys.data[k].joint - 1
        if carrier >= 0:
            wrench = wrenches + 6 * carrier
            for x in range(3):
                y, z = (x + 1) % 3, (x + 2) % 3
                wrench[x] += forces[3 * k + x]
                wrench[3 + x] += places[3 * k + y] * forces[3 * k + z] - places[3 * k + z] * forces[3 * k + y]
    for i in range(m - 1, -1, -1):
        wrench, origin, parent = wrenches + 6 * i, frames.origin + 3 * i, joints[i].parent - 1
        out[i] = 0.0
        for x in range(3):
            y, z = (x + 1) % 3, (x + 2) % 3
            moved = wrench[x] if joints[i].slides else wrench[3 + x] - (origin[y] * wrench[z] - origin[z] * wrench[y])
            out[i] += frames.axis[3 * i + x] * moved
        if parent >= 0:
            for x in range(6):
                wrenches[6 * parent + x] += wrench[x]


cdef void _move_frames(JointTable table, Frames frames, const double *rates, double *moving) noexcept nogil:
    """Write v, a, ω and α (3,) of the base and the joints, `moving: (m + 1, 12)`."""
    cdef Py_ssize_t i, x, y, z, parent
    cdef double *own
    cdef double *above
    cdef const double *axis
    cdef double arm[3]
    cdef double step, bent, s_y, s_z
    for x in range(12):
        moving[x] = 0.0
    for i in range(table.m):
        parent = table.data[i].parent
        above, own, axis = moving + 12 * parent, moving + 12 * (i + 1), frames.axis + 3 * i
        for x in range(3):
            arm[x] = frames.origin[3 * i + x] - (frames.origin[3 * (parent - 1) + x] if parent > 0 else 0.0)
        _carry(above, arm, own, own + 3)
        for x in range(3):
            y, z = (x + 1) % 3, (x + 2) % 3
            s_y, s_z = axis[y] * rates[i], axis[z] * rates[i]
            step, bent = axis[x] * rates[i], above[6 + y] * s_z - above[6 + z] * s_y
            if table.data[i].slides:
                own[x] += step
                own[3 + x] += 2 * bent
                own[6 + x], own[9 + x] = above[6 + x], above[9 + x]
            else:
                own[6 + x], own[9 + x] = above[6 + x] + step, above[9 + x] + bent


cdef void _carry(const double *moving, const double *arm, double *velocity, double *acceleration) noexcept nogil:
    """Write v + ω × r and a + α × r + ω × (ω × r) (3,) at `arm: (3,)` = r, of v, a, ω and α, `moving: (12,)`."""
    cdef Py_ssize_t x, y, z
    cdef const double *omega = moving + 6
    cdef const double *alpha = moving + 9
    cdef double swept[3]
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        swept[x] = omega[y] * arm[z] - omega[z] * arm[y]
        velocity[x] = moving[x] + swept[x]
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        acceleration[x] = (
            moving[3 + x] + alpha[y] * arm[z] - alpha[z] * arm[y] + (omega[y] * swept[z] - omega[z] * swept[y])
        )


cdef void _move_key_points(
    KeyPointTable keys, Frames frames, const double *moving, const double *places, double *velocities,
    double *accelerations,
) noexcept nogil:
    """Write velocities and accelerations (K, 3) of the key points; they are zero for key points on the base."""
    cdef Py_ssize_t k, x, carrier
    cdef double arm[3]
    for k in range(keys.K):
        carrier = keys.data[k].joint
        for x in range(3):
            arm[x] = places[3 * k + x] - (frames.origin[3 * (carrier - 1) + x] if carrier > 0 else 0.0)
        _carry(moving + 12 * carrier, arm, velocities + 3 * k, accelerations + 3 * k)


cdef void _add_turned(
    KeyPointTable keys, Frames frames, const double *twists, const double *places, const double *velocities,
    const double *forces, double *out,
) noexcept nogil:
    """Add Σ_k f_k·∂v_k/∂q_i (m,) of forces (K, 3) on the velocities; see `KeyPointTable.motion_gradients`."""
    cdef Py_ssize_t k, i, x, y, z, parent
    cdef const Joint *joints = keys.joints.data
    cdef const double *twist
    cdef const double *axis
    cdef const double *origin
    cdef const double *place
    cdef double still[6]
    cdef double arm[3]
    cdef double point_velocity[3]
    cdef double change
    for x in range(6):
        still[x] = 0.0
    for k in range(keys.K):
        i, place = keys.data[k].joint - 1, places + 3 * k
        while i >= 0:
            parent = joints[i].parent - 1
            twist = twists + 6 * parent if parent >= 0 else still
            axis, origin = frames.axis + 3 * i, frames.origin + 3 * i
            for x in range(3):
                y, z = (x + 1) % 3, (x + 2) % 3
                arm[x] = velocities[3 * k + x] - twist[3 + x] - (twist[y] * place[z] - twist[z] * place[y])
                if joints[i].slides:
                    point_velocity[x] = axis[x]
                else:
                    point_velocity[x] = axis[y] * (place[z] - origin[z]) - axis[z] * (place[y] - origin[y])
            for x in range(3):
                y, z = (x + 1) % 3, (x + 2) % 3
                change = twist[y] * point_velocity[z] - twist[z] * point_velocity[y]
                if not joints[i].slides:
                    change += axis[y] * arm[z] - axis[z] * arm[y]
                out[i] += forces[3 * k + x] * change
            i = parent


cdef class EdgeTable:
    """Limits of the n planned joints, and their coupling to the m joints of Pinocchio's model.

    Parameters
    ----------
    coupling : ndarray of shape (m, 4)
        For each joint of the model: its planned joint, the factor, the offset [rad or m], and whether the planned joint
        is continuous (1) or not (0).
    bounds : ndarray of shape (2, n)
        Lower and upper limits [rad or m].
    """

    def __init__(self, coupling, bounds):
        cdef const double[:, ::1] couplings = coupling
        cdef const double[:, ::1] limits = bounds
        cdef Py_ssize_t j
        self.m, self.n = couplings.shape[0], limits.shape[1]
        if couplings.shape[1] != 4 or limits.shape[0] != 2:
            raise InputError("couplings must have shape (m, 4), and bounds (2, n)")
        for j in range(self.m):
            if not 0 <= couplings[j, 0] < self.n:
                raise InputError(f"joint {j} of the model: there is no planned joint {couplings[j, 0]:g}")
        self.coupling, self.bounds = coupling, bounds
        self.couplings = &couplings[0, 0] if self.m else NULL
        self.limits = &limits[0, 0] if self.n else NULL

    def hold(self, const double[:] q):
        """Return whether `q: (n,)` is finite and within the limits."""
        cdef Py_ssize_t i
        _check_columns("configurations", q.shape[0], self.n)
        for i in range(self.n):
            if not self.limits[i] <= q[i] <= self.limits[self.n + i]:
                return False
        return True

    def edge(self, const double[::1] start, const double[::1] end):
        """Return start and displacement (2, m) of the model's joints on the straight motion `start` → `end: (n,)`.

        Returns None if an end is not within the limits.
        """
        _check_columns("configurations", start.shape[0], self.n)
        _check_columns("configurations", end.shape[0], self.n)
        found = np.empty((2, self.m))
        cdef double[:, ::1] edge = found
        if self.m and not edge_between(self, &start[0], &end[0], &edge[0, 0]):
            return None
        return found

    def edges(self, const double[:, ::1] starts, const double[:, ::1] ends):
        """Return `edge` for E motions between configurations (E, n): (E, 2, m), and which have valid ends, (E,)."""
        cdef Py_ssize_t E = starts.shape[0], k
        _check_columns("configurations", starts.shape[1], self.n)
        _check_columns("configurations", ends.shape[1], self.n)
        if ends.shape[0] != E:
            raise InputError(f"motions need as many starts as ends, got {E} and {ends.shape[0]}")
        found, held = np.empty((E, 2, self.m)), np.ones(E, np.bool_)
        cdef double[:, :, ::1] edges = found
        cdef unsigned char[::1] within = held.view(np.uint8)
        if self.m:
            with nogil:
                for k in range(E):
                    within[k] = edge_between(self, &starts[k, 0], &ends[k, 0], &edges[k, 0, 0])
        return found, held


cdef bint edge_between(EdgeTable table, const double *start, const double *end, double *edge) noexcept nogil:
    """Write start and displacement (2, m) of the model's joints on the straight motion between configurations (n,).

    Returns False, and writes nothing, if an end is not within the limits.
    """
    cdef Py_ssize_t n = table.n, j, i
    cdef const double *row
    cdef const double *upper = table.limits + n
    if not (all_within(start, n, table.limits, upper) and all_within(end, n, table.limits, upper)):
        return False
    for j in range(table.m):
        row = table.couplings + 4 * j
        i = <Py_ssize_t>row[0]
        edge[j] = row[1] * start[i] + row[2]
        edge[table.m + j] = row[1] * difference(start[i], end[i], row[3] != 0.0)
    return True


def damped_pseudoinverse_step(
    const double[:, ::1] jacobian, const double[::1] error, const double[::1] drift, double singular, double damping
):
    """Return Δq (n,) = Δq₀ + Jᵀ(JJᵀ + Λ²)⁻¹(Δx − JΔq₀) for J (m, n), Δx (m,) and Δq₀ (n,), with m ≤ 6.

    Λ² is damping²·(1 − σ²/singular²) in directions of JJᵀ with singular values σ of J below `singular`, and 0 in
    others. The directions are found by Jacobi's rotations (Golub, Van Loan: Matrix Computations, §8.5).
    """
    cdef Py_ssize_t m = jacobian.shape[0], n = jacobian.shape[1], i, j, k, axis
    cdef double[6][6] square, directions
    cdef double[6] residual, solved
    cdef double total, largest
    if not (0 < m <= 6 and error.shape[0] == m and drift.shape[0] == n):
        raise InputError(
            f"a Jacobian of 1 to 6 rows must come with errors of its rows and drifts of its columns, got "
            f"{(m, n)}, {(error.shape[0],)} and {(drift.shape[0],)}"
        )
    found = np.array(drift)
    cdef double[::1] out = found
    with nogil:
        largest = 0.0
        for i in range(m):
            residual[i] = error[i]
            for k in range(n):
                residual[i] -= jacobian[i, k] * drift[k]
            for j in range(i + 1):
                total = 0.0
                for k in range(n):
                    total += jacobian[i, k] * jacobian[j, k]
                square[i][j] = square[j][i] = total
                directions[i][j] = directions[j][i] = 1.0 if i == j else 0.0
            largest = max(largest, square[i][i])
        for _ in range(SWEEPS):
            total = 0.0
            for i in range(m):
                for j in range(i):
                    total = max(total, fabs(square[i][j]))
                    if square[i][j] != 0.0:
                        _rotate_pair(square, directions, m, j, i)
            if total <= DIAGONAL * largest:
                break
        for axis in range(m):
            total = 0.0
            for i in range(m):
                total += directions[i][axis] * residual[i]
            largest = square[axis][axis]
            solved[axis] = total / (largest + damping * damping * max(0.0, 1.0 - largest / (singular * singular)))
        for i in range(m):
            total = 0.0
            for axis in range(m):
                total += directions[i][axis] * solved[axis]
            for k in range(n):
                out[k] += jacobian[i, k] * total
    return found


cdef void _rotate_pair(
    double[6] *square, double[6] *directions, Py_ssize_t m, Py_ssize_t p, Py_ssize_t q
) noexcept nogil:
    """Turn coordinates p and q of a symmetric matrix so that its element (p, q) is 0; turn the directions alike."""
    cdef double theta = (square[q][q] - square[p][p]) / (2.0 * square[p][q])
    cdef double t = (1.0 if theta >= 0.0 else -1.0) / (fabs(theta) + sqrt(theta * theta + 1.0))
    cdef double c = 1.0 / sqrt(t * t + 1.0), s = t * c, first, second
    cdef Py_ssize_t k
    for k in range(m):
        first, second = square[k][p], square[k][q]
        square[k][p], square[k][q] = c * first - s * second, s * first + c * second
    for k in range(m):
        first, second = square[p][k], square[q][k]
        square[p][k], square[q][k] = c * first - s * second, s * first + c * second
        first, second = directions[k][p], directions[k][q]
        directions[k][p], directions[k][q] = c * first - s * second, s * first + c * second
    square[p][q] = square[q][p] = 0.0


def unrolled(const double[:, ::1] path, continuous):
    """Return the path (N, n) with the jumps of continuous joints at ±π removed, as by `np.unwrap`."""
    cdef Py_ssize_t N = path.shape[0], n = path.shape[1], k, i
    cdef const unsigned char[::1] wraps = np.ascontiguousarray(continuous, dtype=np.bool_).view(np.uint8)
    cdef double step
    if wraps.shape[0] != n:
        raise InputError(f"way points must have {wraps.shape[0]} joints, got {n}")
    found, turned = np.array(path), np.zeros(n)
    cdef double[:, ::1] points = found
    cdef double[::1] turns = turned
    for k in range(1, N):
        for i in range(n):
            step = difference(path[k - 1, i], path[k, i], wraps[i])
            turns[i] += rint((step - (path[k, i] - path[k - 1, i])) / (2 * M_PI))
            points[k, i] += 2 * M_PI * turns[i]
    return found


cdef class Coordinates:
    """The n coordinates of configurations: their bounds, and which are continuous or quaternions.

    Parameters
    ----------
    lower, upper : ndarray of shape (n,)
        Bounds [rad or m].
    continuous : ndarray of bool, shape (n,)
        Which coordinates are angles without bounds, so that motions take the shorter direction.
    rotations : ndarray of shape (r,), optional
        The index of the first component of each unit quaternion x, y, z, w. Motions follow the shortest arc.
    """

    def __init__(self, lower, upper, continuous, rotations=()):
        self.lower = np.ascontiguousarray(lower, dtype=np.float64)
        self.upper = np.ascontiguousarray(upper, dtype=np.float64)
        self.continuous = np.ascontiguousarray(continuous, dtype=np.bool_).view(np.uint8)
        self.rotations = np.ascontiguousarray(rotations, dtype=np.intp)
        self.n, self.turns = self.lower.shape[0], self.rotations.shape[0]
        if self.upper.shape[0] != self.n or self.continuous.shape[0] != self.n:
            raise InputError("bounds must have the same shape (n,) each")
        if any(not 0 <= first <= self.n - 4 for first in self.rotations):
            raise InputError(f"quaternions must be four of {self.n} coordinates each")

    def steer(self, const double[::1] q, const double[::1] target, double step):
        """Return ρ(q, target), and (2, n): the end and the direction of a step from q (n,) towards `target` (n,)."""
        found = np.empty((2, self.n))
        cdef double[:, ::1] out = found
        _check_columns("configurations", q.shape[0], self.n)
        _check_columns("targets", target.shape[0], self.n)
        return steer(self, &q[0], &target[0], step, &out[0, 0], &out[1, 0]), found

    def descend(self, double[:, ::1] step, const double[::1] gradient, double reach):
        """Move a configuration down the gradient, perpendicular to a direction. Return whether it could be moved.

        The configuration and the direction are the rows of `step: (2, n)`. The result is written to the second row.
        """
        _check_columns("steps", step.shape[1], self.n)
        _check_columns("gradients", gradient.shape[0], self.n)
        if step.shape[0] != 2:
            raise InputError(f"a step is a place and a direction, got {step.shape[0]} rows")
        return descend(self, &step[0, 0], &step[1, 0], &gradient[0], reach)


cdef double steer(
    Coordinates space, const double *q, const double *target, double step, double *place, double *direction
) noexcept nogil:
    """Write the end and the direction (n,) of a step from q towards `target` (n,). Return ρ(q, target)."""
    cdef Py_ssize_t i
    cdef double length = motion_between(space, q, target, direction)
    for i in range(space.n):
        place[i] = target[i] if length <= step else q[i] + (step / length) * direction[i]
    if length > step:
        for i in range(space.turns):
            rotate(q + space.rotations[i], direction + space.rotations[i], step / length, place + space.rotations[i])
    for i in range(space.n):
        direction[i] /= length
    return length


cdef double motion_between(Coordinates space, const double *q, const double *target, double *motion) noexcept nogil:
    """Write the displacement (n,) from q to `target` (n,), and return its length ρ."""
    cdef Py_ssize_t i
    cdef double length = 0.0
    for i in range(space.n):
        motion[i] = difference(q[i], target[i], space.continuous[i])
    for i in range(space.turns):
        rotation_between(q + space.rotations[i], target + space.rotations[i], motion + space.rotations[i])
    for i in range(space.n):
        length += motion[i] * motion[i]
    return sqrt(length)


cdef bint descend(
    Coordinates space, const double *place, double *direction, const double *gradient, double reach
) noexcept nogil:
    """Write to `direction: (n,)` the place moved down a gradient (n,). Return False if its projection is zero.

    The motion is perpendicular to the direction. Its length is `reach`, times the norm of the projected gradient if
    this is below 1. The result is within the bounds, with continuous coordinates in [−π, π) and unit quaternions.
    """
    cdef Py_ssize_t i, k, first
    cdef double radial
    cdef double along = 0.0, steepness = 0.0
    for i in range(space.n):
        along += gradient[i] * direction[i]
    for i in range(space.n):
        direction[i] = gradient[i] - along * direction[i]
    # For quaternions, only the component tangent to the unit sphere is kept.
    for k in range(space.turns):
        first, radial = space.rotations[k], 0.0
        for i in range(first, first + 4):
            radial += direction[i] * place[i]
        for i in range(first, first + 4):
            direction[i] -= radial * place[i]
    for i in range(space.n):
        steepness += direction[i] * direction[i]
    steepness = sqrt(steepness)
    if not 0.0 < steepness < INFINITY:
        return False
    for i in range(space.n):
        direction[i] = bounded(
            place[i] - (reach * min(1.0, steepness) / steepness) * direction[i],
            space.lower[i], space.upper[i], space.continuous[i],
        )
    for k in range(space.turns):
        normalise(direction + space.rotations[k])
    return True


cdef Frames _frames(double *memory, Py_ssize_t m) noexcept nogil:
    """Return pointers to rotations, origins and axes of m joints in the first 15 m numbers of the memory."""
    return Frames(memory, memory + 9 * m, memory + 12 * m)


cdef const double *_row(const double[:, ::1] rows, Py_ssize_t b) noexcept nogil:
    """Return a pointer to row b, or NULL for empty rows (a robot without joints)."""
    return &rows[b, 0] if rows.shape[1] else NULL


cdef void *_room(Py_ssize_t numbers) except NULL:
    cdef void *memory = malloc(max(numbers, 1) * sizeof(double))
    if not memory:
        raise MemoryError
    return memory


cdef int _check_columns(str name, Py_ssize_t columns, Py_ssize_t wanted) except -1:
    if columns != wanted:
        raise InputError(f"{name} must have {wanted} columns, got {columns}")
    return 0


cdef int _check_forces(const double[:, :, ::1] forces, Py_ssize_t B, Py_ssize_t K) except -1:
    if forces.shape[0] != B or forces.shape[1] != K or forces.shape[2] != 3:
        raise InputError(f"forces must have shape ({B}, {K}, 3), got {tuple(np.shape(forces))}")
    return 0
