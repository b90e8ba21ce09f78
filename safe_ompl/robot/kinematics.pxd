"""Forward kinematics: tables for compiled modules, and functions that are compiled into their callers.

The functions are inline, because they run in the innermost loops of proofs, danger fields and planners.
"""

from libc.math cimport M_PI, atan2, cos, fmod, rint, sin, sqrt


# A row of `JOINT` in `kinematics.pyx`.
cdef struct Joint:
    # The placement R⁰, t⁰ [m] in the frame of the parent.
    double rotation[3][3]
    double translation[3]
    # The unit axis a in the joint's frame.
    double axis[3]
    # Pinocchio's number of the parent joint; 0 is the base.
    Py_ssize_t parent
    # 1 if the joint is prismatic, 0 if it is revolute.
    Py_ssize_t slides


# A point that is fixed to a joint, such as the end of a link.
cdef struct KeyPoint:
    # The position in the joint's frame [m].
    double offset[3]
    # Pinocchio's number of the joint; 0 is the base.
    Py_ssize_t joint


# The classes are documented in `kinematics.pyx`. `array` keeps the memory alive to which `data` points.
cdef class JointTable:
    cdef readonly object array
    cdef const Joint *data
    cdef readonly Py_ssize_t m


cdef class KeyPointTable:
    cdef readonly object array
    cdef readonly JointTable joints
    cdef const KeyPoint *data
    cdef readonly Py_ssize_t K


cdef class Coordinates:
    cdef readonly Py_ssize_t n
    cdef const double[::1] lower
    cdef const double[::1] upper
    cdef const unsigned char[::1] continuous
    # The index of the first component of each unit quaternion, and the number of quaternions.
    cdef const Py_ssize_t[::1] rotations
    cdef readonly Py_ssize_t turns


cdef class EdgeTable:
    cdef readonly Py_ssize_t n
    cdef readonly Py_ssize_t m
    cdef readonly object coupling, bounds
    # Pointers to `coupling`, (m, 4), and `bounds`, (2, n).
    cdef const double *couplings
    cdef const double *limits


cdef bint edge_between(EdgeTable table, const double *start, const double *end, double *edge) noexcept nogil

cdef double steer(
    Coordinates space, const double *q, const double *target, double step, double *place, double *direction
) noexcept nogil

cdef double motion_between(Coordinates space, const double *q, const double *target, double *motion) noexcept nogil

cdef bint descend(
    Coordinates space, const double *place, double *direction, const double *gradient, double reach
) noexcept nogil


cdef inline void place_joints(
    const Joint *joints, Py_ssize_t m, const double *values, double *rotation, double *origin, double *axis,
) noexcept nogil:
    """Write R (m, 3, 3), o (m, 3) and z (m, 3) of the joints at `values: (m,)`.

    With exp(q [a]×) = cos·1 + sin·[a]× + (1 − cos)·aaᵀ.
    """
    cdef const Joint *joint
    cdef const double *frame
    cdef double *R
    cdef double a0, a1, a2, c, s, d, f0, f1, f2, at, r0, r1, r2, along
    cdef Py_ssize_t i, x, parent
    for i in range(m):
        joint = &joints[i]
        parent = joint.parent - 1
        a0, a1, a2 = joint.axis[0], joint.axis[1], joint.axis[2]
        c, s = cos(values[i]), sin(values[i])
        d = 1.0 - c
        for x in range(3):
            f0, f1, f2, at = <double>(x == 0), <double>(x == 1), <double>(x == 2), 0.0
            if parent >= 0:
                frame = rotation + 9 * parent + 3 * x
                f0, f1, f2, at = frame[0], frame[1], frame[2], origin[3 * parent + x]
            r0 = f0 * joint.rotation[0][0] + f1 * joint.rotation[1][0] + f2 * joint.rotation[2][0]
            r1 = f0 * joint.rotation[0][1] + f1 * joint.rotation[1][1] + f2 * joint.rotation[2][1]
            r2 = f0 * joint.rotation[0][2] + f1 * joint.rotation[1][2] + f2 * joint.rotation[2][2]
            along = r0 * a0 + r1 * a1 + r2 * a2
            axis[3 * i + x] = along
            origin[3 * i + x] = (
                at + f0 * joint.translation[0] + f1 * joint.translation[1] + f2 * joint.translation[2]
            )
            R = rotation + 9 * i + 3 * x
            if joint.slides:
                origin[3 * i + x] += along * values[i]
                R[0], R[1], R[2] = r0, r1, r2
            else:
                R[0] = r0 * (d * a0 * a0 + c) + r1 * (d * a1 * a0 + s * a2) + r2 * (d * a2 * a0 - s * a1)
                R[1] = r0 * (d * a0 * a1 - s * a2) + r1 * (d * a1 * a1 + c) + r2 * (d * a2 * a1 + s * a0)
                R[2] = r0 * (d * a0 * a2 + s * a1) + r1 * (d * a1 * a2 - s * a0) + r2 * (d * a2 * a2 + c)


cdef inline void place_key_points(
    const KeyPoint *keys, Py_ssize_t K, const double *rotation, const double *origin, double *places,
) noexcept nogil:
    """Write where the key points (K, 3) are, o + R·offset."""
    cdef const double *frame
    cdef Py_ssize_t k, x, carrier
    for k in range(K):
        carrier = keys[k].joint - 1
        for x in range(3):
            if carrier < 0:
                places[3 * k + x] = keys[k].offset[x]
            else:
                frame = rotation + 9 * carrier + 3 * x
                places[3 * k + x] = (
                    origin[3 * carrier + x] + frame[0] * keys[k].offset[0] + frame[1] * keys[k].offset[1]
                    + frame[2] * keys[k].offset[2]
                )


cdef inline void move_joints(
    const Joint *joints, Py_ssize_t m, const double *rates, const double *origin, const double *axis, double *twists,
) noexcept nogil:
    """Write the twists (m, 6) of the joints at `rates: (m,)`: angular velocity, and velocity at the world's origin."""
    cdef Py_ssize_t i, x, y, z, parent
    cdef double turn, about, spin, drift
    for i in range(m):
        parent = joints[i].parent - 1
        for x in range(3):
            y, z = (x + 1) % 3, (x + 2) % 3
            turn = axis[3 * i + x] * rates[i]
            about = (origin[3 * i + y] * axis[3 * i + z] - origin[3 * i + z] * axis[3 * i + y]) * rates[i]
            spin = twists[6 * parent + x] if parent >= 0 else 0.0
            drift = twists[6 * parent + 3 + x] if parent >= 0 else 0.0
            twists[6 * i + x] = spin + (0.0 if joints[i].slides else turn)
            twists[6 * i + 3 + x] = drift + (turn if joints[i].slides else about)


cdef inline void key_point_velocities(
    const KeyPoint *keys, Py_ssize_t K, const double *twists, const double *places, double *velocities
) noexcept nogil:
    """Write the velocities (K, 3) of the key points at their places (K, 3), from the twists (m, 6) of the joints."""
    cdef Py_ssize_t k, x, y, z, carrier
    cdef const double *twist
    for k in range(K):
        carrier = keys[k].joint - 1
        for x in range(3):
            y, z = (x + 1) % 3, (x + 2) % 3
            velocities[3 * k + x] = 0.0
            if carrier >= 0:
                twist = twists + 6 * carrier
                velocities[3 * k + x] = twist[3 + x] + twist[y] * places[3 * k + z] - twist[z] * places[3 * k + y]


cdef inline double difference(double start, double end, bint wraps) noexcept nogil:
    """Return the motion from one value of a joint to another, the short way round if the joint is continuous."""
    cdef double delta = end - start
    return delta - 2 * M_PI * rint(delta / (2 * M_PI)) if wraps else delta


cdef inline double bounded(double value, double lower, double upper, bint wraps) noexcept nogil:
    """Return the nearest value of a joint within its bounds; in [−π, π) if the joint is continuous."""
    cdef double turned
    if wraps:
        # The remainder has the sign of the divisor, as Python's has; C's `fmod` has that of the dividend.
        turned = fmod(value + M_PI, 2 * M_PI)
        return (turned + 2 * M_PI if turned < 0.0 else turned) - M_PI
    return min(max(value, lower), upper)


cdef inline void rotation_between(const double *start, const double *end, double *motion) noexcept nogil:
    """Write the motion (4,) from one unit quaternion to another, the short way: a tangent as long as the arc.

    The arc is half of the angle by which the rotations differ, OMPL's distance in SO(3).
    """
    cdef double cosine = 0.0, sine = 0.0, sign, scale
    cdef Py_ssize_t i
    for i in range(4):
        cosine += start[i] * end[i]
    # A quaternion and its negative are one rotation.
    sign = -1.0 if cosine < 0.0 else 1.0
    for i in range(4):
        motion[i] = sign * end[i] - sign * cosine * start[i]
        sine += motion[i] * motion[i]
    sine = sqrt(sine)
    scale = atan2(sine, sign * cosine) / sine if sine > 0.0 else 1.0
    for i in range(4):
        motion[i] *= scale


cdef inline void rotate(const double *start, const double *motion, double share, double *end) noexcept nogil:
    """Write the unit quaternion (4,) to which a share of a motion (4,) leads from another one."""
    cdef double arc = 0.0, along
    cdef Py_ssize_t i
    for i in range(4):
        arc += motion[i] * motion[i]
    arc = sqrt(arc)
    along = sin(share * arc) / arc if arc > 0.0 else 0.0
    for i in range(4):
        end[i] = cos(share * arc) * start[i] + along * motion[i]
    normalise(end)


cdef inline void normalise(double *quaternion) noexcept nogil:
    """Give a quaternion (4,) the norm 1; where its norm is 0 it becomes the identity (0, 0, 0, 1)."""
    cdef double norm = 0.0
    cdef Py_ssize_t i
    for i in range(4):
        norm += quaternion[i] * quaternion[i]
    norm = sqrt(norm)
    for i in range(4):
        quaternion[i] = quaternion[i] / norm if norm > 0.0 else <double>(i == 3)


cdef inline bint all_within(
    const double *values, Py_ssize_t n, const double *lower, const double *upper
) noexcept nogil:
    """Return whether all values (n,) lie within their bounds; NaN never does."""
    cdef Py_ssize_t i
    for i in range(n):
        if not lower[i] <= values[i] <= upper[i]:
            return False
    return True
