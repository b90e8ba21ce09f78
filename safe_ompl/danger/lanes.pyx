"""Batched (SIMD) evaluation of the danger field: forward kinematics, fields, and gradients with respect to the joints.

The last axis of the arrays in `Frames`, `Rays` and `Forces` is the SIMD lane, one of W. Loops run over multiples of
GROUP lanes; unused lanes hold copies of the last used lane. The formulas and their order of operations are the same as
in `robot/kinematics.pyx` and `danger/static.pyx`.

For many points and one configuration the lanes are points, in blocks of BLOCK points.

The field of a link is φ = θ/ℓ with θ = log(1 + 2ℓ/(S − ℓ)), or θ if links are weighted by their length ℓ. S is the sum
of the distances of the point from the two ends of the link. The field of the robot is the sum over its links, and the
danger at a point is the field times the weight of the point. Equation numbers are those of B. Lacevic, P. Rocco,
Safety-oriented path planning for articulated robots, Robotica, 2013 (see `danger/link_field.py`).
"""

from libc.math cimport INFINITY, NAN, cos, fabs, sin, sqrt
from libc.stdint cimport int64_t, uint32_t, uint64_t
from libc.stdlib cimport free, malloc
from libc.string cimport memset
from cpython.pycapsule cimport PyCapsule_New

from safe_ompl.danger.skeleton cimport (
    ROUNDING, SERIES, ZERO, HighLevels, LaneFunctions, PointRange, Points, Skeleton, half_square_difference
)
from safe_ompl.robot.kinematics cimport Joint


cdef extern from "math.h" nogil:
    float sqrtf(float)

# W: number of lanes. GROUP: lanes per register. CHUNK: points per chunk. Of each chunk the largest upper bound of the
# danger is stored, so that the search for the maximum can skip the chunk. BLOCK: points per block, so that their
# distances fit into the first-level cache.
#
# Loops with these steps have the step as a number, because Cython makes a C loop only if the step is a number.
cdef enum:
    W = 16
    GROUP = 4
    CHUNK = 8
    BLOCK = 128

cdef double LN2 = 0.6931471805599453
# ℓ is the length of a link, S the sum of the distances of a point from its ends. Above this value of 2ℓ/(S − ℓ) the
# cancellation in S − ℓ is too large.
cdef double NEAR = 1e3
# Ratios are limited to this value, because the logarithm here gives NaN for infinity.
cdef double LARGEST = 1e300
# Unit roundoff of single precision.
cdef double SINGLE_ROUNDOFF = 2.0**-24


# Forward kinematics of W configurations of a `Skeleton` with m joints, K key points and L links. Index 0 of the first
# three arrays is the base, index i + 1 is joint i.
cdef struct Frames:
    # Rotations of the joint frames (m + 1, 9, W), row by row.
    double *rotation
    # Origins of the joint frames (m + 1, 3, W) [m].
    double *origin
    # Joint axes (m + 1, 3, W) in the world frame.
    double *axis
    # Key points (K, 3, W) [m].
    double *key_points
    # Lengths of the links (L, W) [m].
    double *lengths
    # The largest absolute coordinate of the key points (W,) [m].
    double *largest_coordinate
    # Working memory: rotation by the value of the present joint (9, W).
    double *turn
    # Working memory: displacement by the value of the present joint (W,) [m], 0 for a revolute joint.
    double *slide
    # Working memory: pose of the parent of the present joint (12, W), the rotation before the origin.
    double *parent_pose


# Pairs of a configuration and a danger point, one pair per lane.
cdef struct Rays:
    # The lane of the configuration in `Frames` (W,).
    Py_ssize_t *lane
    # Index of the danger point (W,).
    Py_ssize_t *point_index
    # Fields of the configuration at the point (W,).
    double *field
    # Key points of the configuration (K, 3, W) [m].
    double *key_points
    # Vectors from the key points to the point (K, 3, W) [m].
    double *ray
    # Lengths of these vectors (K, W) [m].
    double *distance
    # Coordinates of the point (3, W) [m].
    double *point
    # Lengths of the links (L, W) [m].
    double *lengths
    # The ratio 2ℓ/(S − ℓ) of one link, which is replaced by θ (W,).
    double *theta
    # Working memory of `_log1p_each` (W,).
    double *mantissa
    # Working memory of `_log1p_each` (W,).
    double *power


# Gradients of the fields at points.
cdef struct Forces:
    # Gradients with respect to the key points, called forces (K, 3, W).
    double *forces
    # Gradients with respect to the joint values (m, W).
    double *gradient
    # Working memory: wrenches on the joint frames (m + 1, 6, W).
    double *wrench
    # Working memory: (S² − ℓ²)/2 of one link (W,) [m²], or 1 where the point is on the link.
    double *half_square_gap
    # Working memory: 1 in lanes whose point is on no link, else 0 (W,).
    double *untouched
    # Working memory: forces at the two ends of one link (2, 3, W).
    double *end_forces


cdef double *_take(double **memory, Py_ssize_t numbers) noexcept nogil:
    """Allocate the next `numbers` doubles of a memory block. Arrays are aligned to 64 bytes."""
    cdef double *found = memory[0]
    memory[0] += (numbers + 7) // 8 * 8
    return found


cdef Py_ssize_t _frames_size(const Skeleton *s) noexcept nogil:
    return W * (15 * (s.m + 1) + 3 * s.K + s.L + 1 + 9 + 1 + 12)


cdef Frames _frames(const Skeleton *s, double **memory) noexcept nogil:
    """Allocate the frames of a skeleton, and set the frame of the base."""
    cdef Frames frames
    cdef Py_ssize_t x, b
    frames.rotation, frames.origin = _take(memory, 9 * W * (s.m + 1)), _take(memory, 3 * W * (s.m + 1))
    frames.axis, frames.key_points = _take(memory, 3 * W * (s.m + 1)), _take(memory, 3 * W * s.K)
    frames.lengths, frames.largest_coordinate = _take(memory, W * s.L), _take(memory, W)
    frames.turn = _take(memory, 9 * W)
    frames.slide, frames.parent_pose = _take(memory, W), _take(memory, 12 * W)
    memset(frames.rotation, 0, 9 * W * sizeof(double))
    memset(frames.origin, 0, 3 * W * sizeof(double))
    for x in range(3):
        for b in range(W):
            frames.rotation[4 * W * x + b] = 1.0
    return frames


cdef Py_ssize_t _rays_size(const Skeleton *s) noexcept nogil:
    return W * (2 + 1 + 7 * s.K + 3 + s.L + 3)


cdef Rays _rays_of(const Skeleton *s, double **memory) noexcept nogil:
    """Allocate memory for pairs of configurations and points."""
    cdef Rays rays
    rays.lane, rays.point_index = <Py_ssize_t *> _take(memory, W), <Py_ssize_t *> _take(memory, W)
    rays.field = _take(memory, W)
    rays.key_points, rays.ray = _take(memory, 3 * W * s.K), _take(memory, 3 * W * s.K)
    rays.distance, rays.point, rays.lengths = _take(memory, W * s.K), _take(memory, 3 * W), _take(memory, W * s.L)
    rays.theta, rays.mantissa, rays.power = _take(memory, W), _take(memory, W), _take(memory, W)
    return rays


cdef Py_ssize_t _forces_size(const Skeleton *s) noexcept nogil:
    return W * (3 * s.K + s.m + 6 * (s.m + 1) + 8)


cdef Forces _forces_of(const Skeleton *s, double **memory) noexcept nogil:
    """Allocate memory for the forces at the key points."""
    cdef Forces forces
    forces.forces, forces.gradient = _take(memory, 3 * W * s.K), _take(memory, W * s.m)
    forces.wrench, forces.half_square_gap = _take(memory, 6 * W * (s.m + 1)), _take(memory, W)
    forces.untouched, forces.end_forces = _take(memory, W), _take(memory, 6 * W)
    return forces


cdef Py_ssize_t _forward_kinematics(
    const Skeleton *s, const double *values, Py_ssize_t count, Frames frames
) noexcept nogil:
    """Compute joint frames, key points and lengths of links at `values: (count ≤ W, m)`.

    Return the number of lanes in use.
    """
    cdef Py_ssize_t lanes = (count + GROUP - 1) // GROUP * GROUP, i, b, x, k, link
    cdef const Joint *joint
    cdef double *turn = frames.turn
    cdef double *slide = frames.slide
    cdef double *parent_pose = frames.parent_pose
    cdef double *R
    cdef double *source
    cdef double *parent_row
    cdef double *o
    cdef double *z
    cdef double *key_point
    cdef double *first
    cdef double *last
    cdef double *length
    cdef double a0, a1, a2, t0, t1, t2, m00, m01, m02, m10, m11, m12, m20, m21, m22
    cdef double q, c, n, d, f0, f1, f2, r0, r1, r2, along, u, v, w, largest
    for i in range(s.m):
        joint = &s.joints[i]
        a0, a1, a2 = joint.axis[0], joint.axis[1], joint.axis[2]
        t0, t1, t2 = joint.translation[0], joint.translation[1], joint.translation[2]
        m00, m01, m02 = joint.rotation[0][0], joint.rotation[0][1], joint.rotation[0][2]
        m10, m11, m12 = joint.rotation[1][0], joint.rotation[1][1], joint.rotation[1][2]
        m20, m21, m22 = joint.rotation[2][0], joint.rotation[2][1], joint.rotation[2][2]
        for b in range(count):
            q = values[s.m * b + i]
            if joint.slides:
                slide[b], turn[b], turn[W + b] = q, 1.0, 0.0
            else:
                slide[b], turn[b], turn[W + b] = 0.0, cos(q), sin(q)
        for b in range(count, lanes):
            slide[b], turn[b], turn[W + b] = slide[count - 1], turn[count - 1], turn[W + count - 1]
        for b in range(lanes):
            c, n = turn[b], turn[W + b]
            d = 1.0 - c
            turn[b], turn[W + b], turn[2 * W + b] = d * a0 * a0 + c, d * a0 * a1 - n * a2, d * a0 * a2 + n * a1
            turn[3 * W + b] = d * a1 * a0 + n * a2
            turn[4 * W + b], turn[5 * W + b] = d * a1 * a1 + c, d * a1 * a2 - n * a0
            turn[6 * W + b], turn[7 * W + b] = d * a2 * a0 - n * a1, d * a2 * a1 + n * a0
            turn[8 * W + b] = d * a2 * a2 + c
        source = frames.rotation + 9 * W * joint.parent
        for x in range(9 * W):
            parent_pose[x] = source[x]
        source = frames.origin + 3 * W * joint.parent
        for x in range(3 * W):
            parent_pose[9 * W + x] = source[x]
        for x in range(3):
            R = frames.rotation + W * (9 * (i + 1) + 3 * x)
            o, z = frames.origin + W * (3 * (i + 1) + x), frames.axis + W * (3 * (i + 1) + x)
            parent_row = parent_pose + 3 * W * x
            for b in range(lanes):
                f0, f1, f2 = parent_row[b], parent_row[W + b], parent_row[2 * W + b]
                r0 = f0 * m00 + f1 * m10 + f2 * m20
                r1 = f0 * m01 + f1 * m11 + f2 * m21
                r2 = f0 * m02 + f1 * m12 + f2 * m22
                along = r0 * a0 + r1 * a1 + r2 * a2
                z[b] = along
                o[b] = parent_pose[(9 + x) * W + b] + f0 * t0 + f1 * t1 + f2 * t2 + along * slide[b]
                R[b] = r0 * turn[b] + r1 * turn[3 * W + b] + r2 * turn[6 * W + b]
                R[W + b] = r0 * turn[W + b] + r1 * turn[4 * W + b] + r2 * turn[7 * W + b]
                R[2 * W + b] = r0 * turn[2 * W + b] + r1 * turn[5 * W + b] + r2 * turn[8 * W + b]
    for k in range(s.K):
        t0, t1, t2 = s.keys[k].offset[0], s.keys[k].offset[1], s.keys[k].offset[2]
        for x in range(3):
            R = frames.rotation + W * (9 * s.keys[k].joint + 3 * x)
            o, key_point = frames.origin + W * (3 * s.keys[k].joint + x), frames.key_points + W * (3 * k + x)
            for b in range(lanes):
                key_point[b] = o[b] + R[b] * t0 + R[W + b] * t1 + R[2 * W + b] * t2
    for b in range(W):
        frames.largest_coordinate[b] = 0.0
    for k in range(s.K):
        key_point = frames.key_points + 3 * W * k
        for b in range(lanes):
            largest = max(max(fabs(key_point[b]), fabs(key_point[W + b])), fabs(key_point[2 * W + b]))
            frames.largest_coordinate[b] = max(frames.largest_coordinate[b], largest)
    for link in range(s.L):
        first = frames.key_points + 3 * W * s.links[2 * link]
        last = frames.key_points + 3 * W * s.links[2 * link + 1]
        length = frames.lengths + W * link
        for b in range(lanes):
            u, v, w = last[b] - first[b], last[W + b] - first[W + b], last[2 * W + b] - first[2 * W + b]
            length[b] = max(sqrt(u * u + v * v + w * w), ZERO)
    return lanes


cdef Py_ssize_t _cast_rays(
    const Skeleton *s, Frames frames, const Points *points, Py_ssize_t count, Rays rays
) noexcept nogil:
    """Compute the vectors from the key points to the points. Return the number of lanes in use."""
    cdef Py_ssize_t lanes = (count + GROUP - 1) // GROUP * GROUP, b, x, k, link
    cdef double *ray
    cdef double *distance
    cdef double *key_point
    cdef const double *source
    cdef double u, v, w
    for b in range(count, lanes):
        rays.lane[b], rays.point_index[b] = rays.lane[count - 1], rays.point_index[count - 1]
    for x in range(3):
        for b in range(lanes):
            rays.point[W * x + b] = points.columns[points.M * x + rays.point_index[b]]
        for k in range(s.K):
            source, key_point = frames.key_points + W * (3 * k + x), rays.key_points + W * (3 * k + x)
            ray = rays.ray + W * (3 * k + x)
            for b in range(lanes):
                key_point[b] = source[rays.lane[b]]
            for b in range(lanes):
                ray[b] = rays.point[W * x + b] - key_point[b]
    for k in range(s.K):
        ray, distance = rays.ray + 3 * W * k, rays.distance + W * k
        for b in range(lanes):
            u, v, w = ray[b], ray[W + b], ray[2 * W + b]
            distance[b] = sqrt(u * u + v * v + w * w)
    for link in range(s.L):
        for b in range(lanes):
            rays.lengths[W * link + b] = frames.lengths[W * link + rays.lane[b]]
    return lanes


cdef bint _write_fields(const Skeleton *s, Py_ssize_t lanes, Rays rays) noexcept nogil:
    """Compute the fields at the points. Return False if a point is so near that `_fields_at_points` must be used."""
    cdef Py_ssize_t link, b, near = 0
    cdef const double *first
    cdef const double *last
    cdef const double *length
    cdef double *theta = rays.theta
    for b in range(W):
        rays.field[b] = 0.0
    for link in range(s.L):
        first, last = rays.distance + W * s.links[2 * link], rays.distance + W * s.links[2 * link + 1]
        length = rays.lengths + W * link
        for b in range(lanes):
            theta[b] = 2.0 * length[b] / (first[b] + last[b] - length[b])
            near += not (0.0 <= theta[b] and theta[b] <= NEAR)
        _log1p_each(theta, rays.mantissa, rays.power, lanes)
        if s.by_length:
            for b in range(lanes):
                rays.field[b] += theta[b]
        else:
            for b in range(lanes):
                rays.field[b] += 1.0 / length[b] * theta[b]
    return near == 0


cdef void _write_forces(
    const Skeleton *s, const double *weights, Py_ssize_t lanes, Rays rays, Forces forces
) noexcept nogil:
    """Compute the forces, weight × ∂φ/∂(key point), for weights (W,). The forces are 0 for a point on a segment.

    For the field φ = θ/ℓ of a link from a to b, ∂φ/∂a = c e₁ − κ (b − a) and ∂φ/∂b = c e₂ + κ (b − a), with
    c = 2/(S² − ℓ²), κ = (c S − φ)/ℓ², and the unit vectors e₁ and e₂ from a and b to the point. If links are weighted
    by length, the field is ℓφ. Then both gradients are multiplied by ℓ, −φ (b − a)/ℓ is added to the first, and
    +φ (b − a)/ℓ to the second. The code adds φ/ℓ² to κ before the multiplication by ℓ, which is the same.
    """
    cdef Py_ssize_t link, b, x, k, i, j
    cdef const double *u
    cdef const double *v
    cdef const double *d1
    cdef const double *d2
    cdef const double *length
    cdef double *theta = rays.theta
    cdef double *half_square_gap = forces.half_square_gap
    cdef double *untouched = forces.untouched
    # The first end force overwrites the segment b − a, after the segment is read.
    cdef double *segment = forces.end_forces
    cdef double *end_forces = forces.end_forces
    cdef double *at
    cdef double w0, w1, w2, along, product, area, half, S, c, square, phi, y, ratio, total, kappa, weight
    cdef double first_factor, last_factor, stretch
    cdef bint touching
    for b in range(3 * W * s.K):
        forces.forces[b] = 0.0
    for b in range(W):
        untouched[b] = 1.0
    for link in range(s.L):
        i, j = s.links[2 * link], s.links[2 * link + 1]
        length, d1, d2 = rays.lengths + W * link, rays.distance + W * i, rays.distance + W * j
        u, v = rays.ray + 3 * W * i, rays.ray + 3 * W * j
        for x in range(3):
            for b in range(lanes):
                segment[W * x + b] = rays.key_points[W * (3 * j + x) + b] - rays.key_points[W * (3 * i + x) + b]
        # The formula of `half_square_difference`, (S² − ℓ²)/2, without branches, so that compilers vectorize the loop.
        for b in range(lanes):
            w0 = u[W + b] * v[2 * W + b] - u[2 * W + b] * v[W + b]
            w1 = u[2 * W + b] * v[b] - u[b] * v[2 * W + b]
            w2 = u[b] * v[W + b] - u[W + b] * v[b]
            along = u[b] * v[b] + u[W + b] * v[W + b] + u[2 * W + b] * v[2 * W + b]
            product, area = d1[b] * d2[b], sqrt(w0 * w0 + w1 * w1 + w2 * w2)
            half = area * area / (product - along) if along < 0.0 else product + along
            touching = (min(d1[b], d2[b]) <= ROUNDING * max(d1[b], d2[b])) | (
                (along < 0.0) & (area <= ROUNDING * product)
            ) | (half <= 0.0)
            untouched[b] = 0.0 if touching else untouched[b]
            half_square_gap[b] = 1.0 if touching else half
            theta[b] = min(length[b] * (d1[b] + d2[b] + length[b]) / half_square_gap[b], LARGEST)
        _log1p_each(theta, rays.mantissa, rays.power, lanes)
        # The formula of `_gradient_terms` in `moving.pyx` without branches, so that compilers vectorize the loop.
        for b in range(lanes):
            S, c, square = d1[b] + d2[b], 1.0 / half_square_gap[b], length[b] * length[b]
            phi, ratio = theta[b] / length[b], length[b] / S
            y = ratio * ratio
            total = 0.0
            total = total * y + 18.0 / 19.0
            total = total * y + 16.0 / 17.0
            total = total * y + 14.0 / 15.0
            total = total * y + 12.0 / 13.0
            total = total * y + 10.0 / 11.0
            total = total * y + 8.0 / 9.0
            total = total * y + 6.0 / 7.0
            total = total * y + 4.0 / 5.0
            total = total * y + 2.0 / 3.0
            kappa = (c * S - phi) / square if y > SERIES else 2.0 * total / (S * S * S)
            weight = weights[b] * (length[b] if s.by_length else 1.0)
            kappa += phi / square if s.by_length else 0.0
            first_factor, last_factor = weight * c / d1[b], weight * c / d2[b]
            stretch = weight * kappa
            for x in range(3):
                w0 = stretch * segment[W * x + b]
                end_forces[W * x + b] = first_factor * u[W * x + b] - w0
                end_forces[W * (3 + x) + b] = last_factor * v[W * x + b] + w0
        for x in range(3):
            at = forces.forces + W * (3 * i + x)
            for b in range(lanes):
                at[b] += end_forces[W * x + b]
            at = forces.forces + W * (3 * j + x)
            for b in range(lanes):
                at[b] += end_forces[W * (3 + x) + b]
    for k in range(3 * s.K):
        at = forces.forces + W * k
        for b in range(lanes):
            at[b] = at[b] if untouched[b] > 0.0 else 0.0


cdef void _jacobian_transpose_product(
    const Skeleton *s, Py_ssize_t lanes, Frames frames, const double *forces, Forces work
) noexcept nogil:
    """Compute the joint torques Jᵀf of forces f (K, 3, W) at the key points, and write them to `work.gradient`.

    The wrench of each joint frame is the sum of the wrenches of the key points that the joint moves. The torque is the
    component of the wrench along the joint axis. See also `KeyPointTable`.
    """
    cdef Py_ssize_t k, x, y, z, b, i
    cdef double *wrench = work.wrench
    cdef double *joint_wrench
    cdef double *parent_wrench
    cdef const double *position
    cdef const double *force
    cdef const double *origin
    cdef const double *axis
    cdef double turned, total
    for b in range(6 * W * (s.m + 1)):
        wrench[b] = 0.0
    for k in range(s.K):
        joint_wrench = wrench + 6 * W * s.keys[k].joint
        position, force = frames.key_points + 3 * W * k, forces + 3 * W * k
        for x in range(3):
            y, z = (x + 1) % 3, (x + 2) % 3
            for b in range(lanes):
                joint_wrench[W * x + b] += force[W * x + b]
            for b in range(lanes):
                joint_wrench[W * (3 + x) + b] += (
                    position[W * y + b] * force[W * z + b] - position[W * z + b] * force[W * y + b]
                )
    for i in range(s.m - 1, -1, -1):
        joint_wrench, parent_wrench = wrench + 6 * W * (i + 1), wrench + 6 * W * s.joints[i].parent
        origin, axis = frames.origin + 3 * W * (i + 1), frames.axis + 3 * W * (i + 1)
        if s.joints[i].slides:
            for b in range(lanes):
                total = 0.0
                total += axis[b] * joint_wrench[b]
                total += axis[W + b] * joint_wrench[W + b]
                total += axis[2 * W + b] * joint_wrench[2 * W + b]
                work.gradient[W * i + b] = total
        else:
            for b in range(lanes):
                total = 0.0
                turned = origin[W + b] * joint_wrench[2 * W + b] - origin[2 * W + b] * joint_wrench[W + b]
                total += axis[b] * (joint_wrench[3 * W + b] - turned)
                turned = origin[2 * W + b] * joint_wrench[b] - origin[b] * joint_wrench[2 * W + b]
                total += axis[W + b] * (joint_wrench[4 * W + b] - turned)
                turned = origin[b] * joint_wrench[W + b] - origin[W + b] * joint_wrench[b]
                total += axis[2 * W + b] * (joint_wrench[5 * W + b] - turned)
                work.gradient[W * i + b] = total
        for x in range(6):
            for b in range(lanes):
                parent_wrench[W * x + b] += joint_wrench[W * x + b]


cdef void _log1p_each(double *x, double *mantissa, double *power, Py_ssize_t count) noexcept nogil:
    """Replace the first `count` entries of `x` by log(1 + x), in loops that compilers vectorize. 0 ≤ x < ∞ is required.

    With 1 + x = 2ᵏ(1 + f), √½ ≤ 1 + f < √2, and s = f/(2 + f), the logarithm is k log 2 + 2 atanh s. For atanh a
    polynomial in s² is accurate to rounding (fdlibm's `e_log.c`). For k = 0, f is x, so small x keep their relative
    accuracy.
    """
    cdef Py_ssize_t j
    cdef int64_t *bits = <int64_t *> mantissa
    cdef int64_t k
    cdef double f, s, z, series
    for j in range(count):
        mantissa[j] = 1.0 + x[j]
    for j in range(count):
        k = (bits[j] - <int64_t> 0x3FE6A09E00000000) >> 52
        bits[j] = <int64_t> (<uint64_t> bits[j] - (<uint64_t> k << 52))
        power[j] = <double> k
    for j in range(count):
        f = x[j] if power[j] == 0.0 else mantissa[j] - 1.0
        s = f / (2.0 + f)
        z = s * s
        series = 1.531383769920937332e-01 + z * 1.479819860511658591e-01
        series = 2.222219843214978396e-01 + z * (1.818357216161805012e-01 + z * series)
        series = 3.999999999940941908e-01 + z * (2.857142874366239149e-01 + z * series)
        series = z * (6.666666666666735130e-01 + z * series)
        x[j] = power[j] * LN2 + s * (2.0 + series)


# ------------------------------------------------------------------------------ one configuration and many points

# A block of points, for one configuration.
cdef struct Block:
    # Coordinates of the points (3, BLOCK) [m].
    double *points
    # Ratios 2ℓ/(S − ℓ) of one link, which are replaced by θ (BLOCK,).
    double *theta
    # Working memory of `_log1p_each` (BLOCK,).
    double *mantissa
    # Working memory of `_log1p_each` (BLOCK,).
    double *power
    # Distances of the points from the key points (K, BLOCK) [m].
    double *distances


cdef Block _block(void *memory) noexcept nogil:
    cdef double *row = <double *> memory
    return Block(row, row + 3 * BLOCK, row + 4 * BLOCK, row + 5 * BLOCK, row + 6 * BLOCK)


cdef Py_ssize_t _block_size(Py_ssize_t K) noexcept nogil:
    return (6 + K) * BLOCK * sizeof(double)


cdef void _fields_at_points(
    const double *key_points, const Skeleton *s, const PointRange *points, double *fields, Py_ssize_t row_stride,
    bint summed, void *memory,
) noexcept nogil:
    """See `LaneFunctions.fields_at_points`. Writes the field of each link, eq. (7), or the sum over links, eq. (5).

    Rows of `fields` are `row_stride` apart. A sum is written into one row.
    """
    cdef Block block = _block(memory)
    cdef Py_ssize_t begin = points.begin, end = points.end, first, number, lanes, link, a, b, j
    cdef double length, scale
    cdef double *row
    for link in range(1 if summed else s.L):
        for j in range(end - begin):
            fields[row_stride * link + j] = 0.0
    for first in range(begin, end, 128):
        number = min(<Py_ssize_t> BLOCK, end - first)
        lanes = _take_points(key_points, s.K, points.columns, points.stride, first, number, block)
        for link in range(s.L):
            a, b = s.links[2 * link], s.links[2 * link + 1]
            length = _length(key_points + 3 * a, key_points + 3 * b)
            _log_ratios(key_points, a, b, length, block, lanes)
            scale = 1.0 if s.by_length else 1.0 / length
            row = fields + (0 if summed else row_stride * link) + (first - begin)
            for j in range(number):
                row[j] += scale * block.theta[j]


cdef double _length(const double *a, const double *b) noexcept nogil:
    """Return the length of a link [m], at least `ZERO`."""
    cdef double x = b[0] - a[0], y = b[1] - a[1], z = b[2] - a[2]
    return max(sqrt(x * x + y * y + z * z), ZERO)


cdef Py_ssize_t _take_points(
    const double *key_points, Py_ssize_t K, const double *columns, Py_ssize_t stride, Py_ssize_t begin,
    Py_ssize_t number, Block block,
) noexcept nogil:
    """Copy a block of points, and compute their distances (K, ·) from all key points.

    The last point is repeated to fill the last W lanes, because a scalar loop over the remainder took as long as many
    groups of lanes. Return the padded number of points.
    """
    cdef Py_ssize_t lanes = min(<Py_ssize_t> BLOCK, (number + W - 1) // W * W), x, j, k
    cdef double *copies
    cdef double *distances
    cdef double x0, y0, z0, dx, dy, dz
    for x in range(3):
        copies = block.points + BLOCK * x
        for j in range(number):
            copies[j] = columns[stride * x + begin + j]
        for j in range(number, lanes):
            copies[j] = copies[number - 1]
    copies = block.points
    for k in range(K):
        x0, y0, z0 = key_points[3 * k], key_points[3 * k + 1], key_points[3 * k + 2]
        distances = block.distances + BLOCK * k
        for j in range(lanes):
            dx, dy, dz = copies[j] - x0, copies[BLOCK + j] - y0, copies[2 * BLOCK + j] - z0
            distances[j] = sqrt(dx * dx + dy * dy + dz * dz)
    return lanes


cdef void _log_ratios(
    const double *key_points, Py_ssize_t start, Py_ssize_t end, double length, Block block, Py_ssize_t number
) noexcept nogil:
    """Compute θ = log(1 + 2ℓ/(S − ℓ)) of a link at a block of points."""
    cdef double *theta = block.theta
    cdef const double *first = block.distances + BLOCK * start
    cdef const double *last = block.distances + BLOCK * end
    cdef Py_ssize_t j, near = 0
    for j in range(number):
        theta[j] = 2.0 * length / (first[j] + last[j] - length)
        near += not (0.0 <= theta[j] and theta[j] <= NEAR)
    if near:
        _restore_digits(key_points + 3 * start, key_points + 3 * end, first, last, length, block, number)
    _log1p_each(theta, block.mantissa, block.power, number)
    if near:
        _mark_contacts(first, last, theta, number)


cdef void _restore_digits(
    const double *a, const double *b, const double *first, const double *last, double length, Block block,
    Py_ssize_t number,
) noexcept nogil:
    """Where S − ℓ cancels, recompute 2ℓ/(S − ℓ) as ℓ (S + ℓ)/((S² − ℓ²)/2). Write 0 on the segment.

    `_mark_contacts` uses this 0 to find the points on the segment.
    """
    cdef double *ratios = block.theta
    cdef double u[3]
    cdef double v[3]
    cdef double half
    cdef Py_ssize_t j, x
    for j in range(number):
        if not (0.0 <= ratios[j] and ratios[j] <= NEAR):
            for x in range(3):
                u[x], v[x] = block.points[BLOCK * x + j] - a[x], block.points[BLOCK * x + j] - b[x]
            half = half_square_difference(u, v, first[j], last[j])
            ratios[j] = length * (first[j] + last[j] + length) / half if half > 0.0 else 0.0


cdef void _mark_contacts(const double *first, const double *last, double *theta, Py_ssize_t number) noexcept nogil:
    """Set θ to infinity on the segment, where `_restore_digits` made θ 0, and to NaN if a distance is NaN.

    θ stays 0 for points at infinity.
    """
    cdef Py_ssize_t j
    cdef double S
    for j in range(number):
        S = first[j] + last[j]
        if not S >= 0.0:
            theta[j] = NAN
        elif theta[j] == 0.0 and INFINITY > S:
            theta[j] = INFINITY


# ------------------------------------------------------------------------------- the maximum danger at configurations

# Working memory for the maximum danger at W configurations. N is the number of points, rounded up to a multiple of
# CHUNK.
cdef struct Peaks:
    # The number N.
    Py_ssize_t padded
    # Coordinates of the points (3, N) in single precision [m].
    float *single
    # Distances of the points from the key points (K, N) of one configuration [m].
    float *distances
    # Upper bounds of the danger of the points (W, N).
    float *bounds
    # Bit patterns of the largest bound of each chunk (W, N/CHUNK).
    uint32_t *tops
    # Index of the most dangerous point so far (W,).
    Py_ssize_t *best
    # The danger at this point (W,).
    double *peak
    # The danger from which on a point is a candidate (W,).
    double *threshold


cdef Py_ssize_t _peaks_size(Py_ssize_t K, Py_ssize_t M) noexcept nogil:
    """Return the number of doubles that `_peaks` allocates."""
    cdef Py_ssize_t padded = (M + CHUNK - 1) // CHUNK * CHUNK
    return (3 + K + W) * padded + W * padded // CHUNK + 3 * W


cdef Peaks _peaks(Py_ssize_t K, const Points *points, double **memory) noexcept nogil:
    """Allocate memory for the maximum danger, and copy the points.

    The last point is repeated to fill the last chunk (see `_take_points`).
    """
    cdef Peaks peaks
    cdef Py_ssize_t M = points.M, N = (M + CHUNK - 1) // CHUNK * CHUNK, x, k
    peaks.padded = N
    peaks.single, peaks.distances = <float *> _take(memory, 3 * N), <float *> _take(memory, K * N)
    peaks.bounds, peaks.tops = <float *> _take(memory, W * N), <uint32_t *> _take(memory, W * (N // CHUNK))
    peaks.best, peaks.peak, peaks.threshold = <Py_ssize_t *> _take(memory, W), _take(memory, W), _take(memory, W)
    for x in range(3):
        for k in range(M):
            peaks.single[N * x + k] = points.single[M * x + k]
        for k in range(M, N):
            peaks.single[N * x + k] = peaks.single[N * x + M - 1]
    return peaks


cdef void _upper_bounds(
    const Skeleton *s, Frames frames, Py_ssize_t lane, double largest_coordinate, const Peaks *peaks, float *out
) noexcept nogil:
    """Compute upper bounds (N,) of the field in single precision, in an eighth of the time of `_fields_at_points`.

    log(1 + r) ≤ r (6 + r)/(6 + 4r), and r = 2ℓ/g with the gap g = S − ℓ. So the field of a link is at most
    2 (3g + ℓ)/(g (3g + 4ℓ)), which decreases with g. Let R be the largest absolute coordinate of points
    (`largest_coordinate`) and key points, and u = 2⁻²⁴. The error of a difference of coordinates is at most 3uR, that
    of a distance at most √3·3uR + 4u·√12 R < 20uR, and that of S − ℓ less than 64uR. Therefore the computed gap is
    reduced by 64uR. The remaining operations have a relative error below (16 + L) u, for which the constant
    `two_rounded_up` has the margin (32 + L) u.
    """
    cdef Py_ssize_t N = peaks.padded, k, m, link
    cdef float x, y, z, dx, dy, dz, length, length_and_error, weight, gap, three_gap_length, bound
    cdef float two_rounded_up = <float> (2.0 * (1.0 + (32.0 + s.L) * SINGLE_ROUNDOFF)), three = 3.0
    cdef float smallest_gap = <float> 1e-18, infinite = INFINITY
    cdef float error = <float> (64.0 * SINGLE_ROUNDOFF * max(largest_coordinate, frames.largest_coordinate[lane]))
    cdef const float *points = peaks.single
    cdef const float *first
    cdef const float *last
    cdef float *distances
    for k in range(s.K):
        x = <float> frames.key_points[3 * W * k + lane]
        y = <float> frames.key_points[3 * W * k + W + lane]
        z = <float> frames.key_points[3 * W * k + 2 * W + lane]
        distances = peaks.distances + N * k
        for m in range(N):
            dx, dy, dz = points[m] - x, points[N + m] - y, points[2 * N + m] - z
            distances[m] = sqrtf(dx * dx + dy * dy + dz * dz)
    for m in range(N):
        out[m] = 0.0
    for link in range(s.L):
        first, last = peaks.distances + N * s.links[2 * link], peaks.distances + N * s.links[2 * link + 1]
        length = <float> frames.lengths[W * link + lane]
        length_and_error = length + error
        weight = two_rounded_up * length if s.by_length else two_rounded_up
        for m in range(N):
            gap = first[m] + last[m] - length_and_error
            three_gap_length = three * gap + length
            bound = weight * three_gap_length / (gap * (three_gap_length + three * length))
            out[m] += bound if gap > smallest_gap else infinite


cdef void _bound(const Skeleton *s, Frames frames, const Points *points, Py_ssize_t lane, Peaks *peaks) noexcept nogil:
    """Compute upper bounds of the danger of all points at one configuration; the largest gives the first candidate."""
    cdef Py_ssize_t N = peaks.padded, M = points.M, k, c, likely = 0, best
    cdef float *bounds = peaks.bounds + N * lane
    cdef const uint32_t *bits = <const uint32_t *> bounds
    cdef uint32_t *tops = peaks.tops + (N // CHUNK) * lane
    cdef uint32_t top
    _upper_bounds(s, frames, lane, points.reach, peaks, bounds)
    for k in range(M):
        bounds[k] *= <float> points.point_weights[k]
    for k in range(M, N):
        bounds[k] = 0.0
    # The bit patterns of non-negative floats sort like the floats themselves, and NaN sorts last.
    for c in range(N // CHUNK):
        top = 0
        for k in range(CHUNK):
            top = max(top, bits[CHUNK * c + k])
        tops[c] = top
        likely = c if top > tops[likely] else likely
    best = CHUNK * likely
    while bits[best] != tops[likely]:
        best += 1
    peaks.best[lane], peaks.peak[lane], peaks.threshold[lane] = best, -INFINITY, -INFINITY


# The lane and the chunk at which the search for candidates continues.
cdef struct Cursor:
    Py_ssize_t lane
    Py_ssize_t chunk


cdef Py_ssize_t _candidates(
    Py_ssize_t M, Py_ssize_t count, Cursor *at, const double *high_dangers, const Peaks *peaks, Rays rays
) noexcept nogil:
    """Of M points, collect those from the cursor on whose upper bound reaches the threshold. Return their number.

    At most W points are collected, into `rays`. `high_dangers` (M,) or NULL are the high dangers found before. Points
    that were evaluated before are skipped: the best point of each lane, and points with `high_dangers` > 0.
    """
    cdef Py_ssize_t number = 0, N = peaks.padded, chunks = peaks.padded // CHUNK, k, best
    cdef const float *bounds
    cdef const float *tops
    cdef float threshold
    while at.lane < count:
        bounds, best = peaks.bounds + N * at.lane, peaks.best[at.lane]
        # The threshold is lowered by more than the rounding to single precision.
        threshold = <float> (peaks.threshold[at.lane] * (1.0 - 1e-7))
        tops = <const float *> (peaks.tops + chunks * at.lane)
        while at.chunk < chunks:
            if not tops[at.chunk] < threshold:
                if number > W - CHUNK:
                    return number
                for k in range(CHUNK * at.chunk, min(CHUNK * (at.chunk + 1), M)):
                    if not (
                        bounds[k] < threshold or k == best or (high_dangers != NULL and high_dangers[k] > 0.0)
                    ):
                        rays.lane[number], rays.point_index[number] = at.lane, k
                        number += 1
            at.chunk += 1
        at.lane += 1
        at.chunk = 0
    return number


cdef int _highest(
    const Skeleton *s, const double *values, Py_ssize_t B, const Points *points, double *gradients,
    const HighLevels *high_levels, double *out,
) noexcept nogil:
    """See `LaneFunctions.highest`.

    The danger is computed in double precision only for points whose bound in single precision reaches the threshold.
    The first pass finds the most dangerous point of each configuration. With `high_levels` a second pass finds all
    other points whose danger reaches the threshold of `high_levels`.
    """
    cdef Py_ssize_t m = s.m, K = s.K, M = points.M, first, count, filled, lane, number, lanes, b, k, i, point
    # The alignment of each of about 40 arrays wastes at most 7 doubles.
    cdef Py_ssize_t numbers = (
        _frames_size(s) + _rays_size(s) + _forces_size(s) + _peaks_size(K, M) + W + 3 * K + 64 * 8
    )
    cdef double *memory = <double *> malloc(numbers * sizeof(double) + _block_size(K))
    cdef double *rest = memory
    cdef Frames frames
    cdef Rays rays
    cdef Forces forces
    cdef Peaks peaks
    cdef Cursor at
    cdef PointRange alone
    cdef double *point_weights
    cdef double *key_points
    cdef double *high_dangers = NULL if high_levels == NULL else high_levels.levels
    cdef double danger, peak
    cdef bint second_pass
    if memory == NULL:
        return -1
    frames, rays, forces = _frames(s, &rest), _rays_of(s, &rest), _forces_of(s, &rest)
    peaks, point_weights, key_points = _peaks(K, points, &rest), _take(&rest, W), _take(&rest, 3 * K)
    for first in range(0, B, 16):
        count, at, second_pass = min(<Py_ssize_t> W, B - first), Cursor(0, 0), False
        filled = _forward_kinematics(s, values + m * first, count, frames)
        for lane in range(count):
            _bound(s, frames, points, lane, &peaks)
            rays.lane[lane], rays.point_index[lane] = lane, peaks.best[lane]
        number = count
        while number > 0:
            lanes = _cast_rays(s, frames, points, number, rays)
            if not _write_fields(s, lanes, rays):
                for b in range(number):
                    for k in range(3 * K):
                        key_points[k] = rays.key_points[W * k + b]
                    point = rays.point_index[b]
                    alone = PointRange(points.columns, M, point, point + 1)
                    _fields_at_points(key_points, s, &alone, &rays.field[b], 1, True, rest)
            for b in range(number):
                lane, point = rays.lane[b], rays.point_index[b]
                danger, peak = rays.field[b] * points.point_weights[point], peaks.peak[lane]
                if second_pass:
                    high_dangers[point] = (
                        max(high_dangers[point], danger) if danger >= peaks.threshold[lane] else high_dangers[point]
                    )
                elif danger > peak or (danger == peak and point < peaks.best[lane]) or peak == -INFINITY:
                    peaks.peak[lane], peaks.best[lane], peaks.threshold[lane] = danger, point, danger
            number = _candidates(M, count, &at, high_dangers if second_pass else NULL, &peaks, rays)
            if number == 0 and not second_pass and high_dangers != NULL:
                second_pass, at = True, Cursor(0, 0)
                for lane in range(count):
                    # On a link the danger is infinite, and a share of 0 would give NaN.
                    peaks.threshold[lane] = high_levels.min_level
                    if high_levels.min_share > 0.0:
                        peaks.threshold[lane] = max(high_levels.min_share * peaks.peak[lane], high_levels.min_level)
                    if peaks.peak[lane] >= peaks.threshold[lane]:
                        high_dangers[peaks.best[lane]] = max(high_dangers[peaks.best[lane]], peaks.peak[lane])
                number = _candidates(M, count, &at, high_dangers, &peaks, rays)
        for lane in range(count):
            out[first + lane] = peaks.peak[lane]
        if gradients != NULL:
            for lane in range(filled):
                rays.lane[lane], rays.point_index[lane] = lane, peaks.best[min(lane, count - 1)]
                point_weights[lane] = points.point_weights[rays.point_index[lane]]
            _cast_rays(s, frames, points, filled, rays)
            _write_forces(s, point_weights, filled, rays, forces)
            _jacobian_transpose_product(s, filled, frames, forces.forces, forces)
            for lane in range(count):
                for i in range(m):
                    gradients[m * (first + lane) + i] = forces.gradient[W * i + lane]
    free(memory)
    return 0


cdef int _gradients(
    const Skeleton *s, const double *values, Py_ssize_t B, const Points *points, const Py_ssize_t *chosen,
    const double *weights, Py_ssize_t J, double *out,
) noexcept nogil:
    """See `LaneFunctions.gradients`. Points on a link have the gradient 0."""
    cdef Py_ssize_t m = s.m, K = s.K, first, count, lanes, begin, number, pair_lanes, b, k, i
    cdef Py_ssize_t numbers = _frames_size(s) + _rays_size(s) + _forces_size(s) + W + 3 * W * K + 64 * 8
    cdef double *memory = <double *> malloc(numbers * sizeof(double))
    cdef double *rest = memory
    cdef Frames frames
    cdef Rays rays
    cdef Forces work
    cdef double *pair_weights
    cdef double *forces
    if memory == NULL:
        return -1
    frames, rays, work = _frames(s, &rest), _rays_of(s, &rest), _forces_of(s, &rest)
    pair_weights, forces = _take(&rest, W), _take(&rest, 3 * W * K)
    for first in range(0, B, 16):
        count = min(<Py_ssize_t> W, B - first)
        lanes = _forward_kinematics(s, values + m * first, count, frames)
        for k in range(3 * W * K):
            forces[k] = 0.0
        for begin in range(0, count * J, 16):
            number = min(<Py_ssize_t> W, count * J - begin)
            for b in range(number):
                rays.lane[b] = (begin + b) // J
                rays.point_index[b], pair_weights[b] = chosen[J * first + begin + b], weights[J * first + begin + b]
            pair_lanes = _cast_rays(s, frames, points, number, rays)
            for b in range(number, pair_lanes):
                pair_weights[b] = 0.0
            _write_forces(s, pair_weights, pair_lanes, rays, work)
            for k in range(3 * K):
                for b in range(number):
                    forces[W * k + rays.lane[b]] += work.forces[W * k + b]
        _jacobian_transpose_product(s, lanes, frames, forces, work)
        for b in range(count):
            for i in range(m):
                out[m * (first + b) + i] = work.gradient[W * i + b]
    free(memory)
    return 0


# With LaneFunctions(…) Cython would generate an unused Python wrapper of `_block_size`. So the members are assigned one
# by one.
cdef LaneFunctions _functions
_functions.block_size, _functions.fields_at_points = _block_size, _fields_at_points
_functions.highest, _functions.gradients = _highest, _gradients

functions = PyCapsule_New(&_functions, "safe_ompl.danger.LaneFunctions", NULL)
