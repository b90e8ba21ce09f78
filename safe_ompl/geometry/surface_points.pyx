"""Points on the surfaces of boxes, solids of revolution about z, and bodies made of capsules."""

from libc.math cimport M_PI, ceil, cos, sin, sqrt

import numpy as np

from safe_ompl.common import InputError


# Limit of the steps along one direction: 10⁶ steps in two directions need more memory than a machine has.
cdef double MOST_STEPS = 1e6


cdef Py_ssize_t _steps(double length, double step) except -1:
    """Return the number of steps of at most `step` [m] that divide `length` [m], at least 1.

    Raises InputError for more than `MOST_STEPS` steps.
    """
    if not length <= MOST_STEPS * step:
        raise InputError(f"a length of {length:g} m needs more than {MOST_STEPS:.0f} steps of {step:g} m")
    # A length that is a multiple of the step up to rounding gets no additional step.
    return <Py_ssize_t> max(1.0, ceil(length / step - 1e-9))


cdef int _check_spacing(double spacing) except -1:
    if not spacing > 0.0:
        raise InputError(f"spacing must be positive, got {spacing:g}")
    return 0


def box_points(const double[::1] size, double spacing):
    """Return grid points (M, 3) on the faces and edges of a box centred at the origin, with edge lengths `size: (3,)`.

    The step between neighbours is at most `spacing` along x, y and z [m]. Points are sorted by x, then y, then z.
    """
    cdef Py_ssize_t X, Y, Z, i, j, k, row = 0
    _check_spacing(spacing)
    if size.shape[0] != 3:
        raise InputError("a box must have three sides")
    X, Y, Z = _steps(size[0], spacing), _steps(size[1], spacing), _steps(size[2], spacing)
    found = np.empty(((X + 1) * (Y + 1) * (Z + 1) - (X - 1) * (Y - 1) * (Z - 1), 3))
    cdef double[:, ::1] points = found
    for i in range(X + 1):
        for j in range(Y + 1):
            for k in range(Z + 1):
                if not (0 < i < X and 0 < j < Y and 0 < k < Z):
                    points[row, 0] = i * (size[0] / X) - size[0] / 2 if i < X else size[0] / 2
                    points[row, 1] = j * (size[1] / Y) - size[1] / 2 if j < Y else size[1] / 2
                    points[row, 2] = k * (size[2] / Z) - size[2] / 2 if k < Z else size[2] / 2
                    row += 1
    return found


def revolved_points(const double[:, ::1] profile, double spacing):
    """Sample the surface of a solid of revolution about z.

    Each point of the surface is within `spacing` [m] of a returned point (M, 3). `profile: (K, 2)` has radius and
    height of K rings [m], from bottom pole to top pole, at most `spacing` apart along the surface.
    """
    cdef Py_ssize_t most = 0, row = 0, r, k, count
    cdef double angle
    _check_spacing(spacing)
    if profile.shape[1] != 2:
        raise InputError("a profile must have two columns")
    for r in range(profile.shape[0]):
        most += _steps(2 * M_PI * profile[r, 0], spacing)
    found = np.empty((most, 3))
    cdef double[:, ::1] points = found
    for r in range(profile.shape[0]):
        count = _steps(2 * M_PI * profile[r, 0], spacing)
        for k in range(count):
            angle = 2 * M_PI * k / count
            points[row, 0], points[row, 1] = profile[r, 0] * cos(angle), profile[r, 0] * sin(angle)
            points[row, 2] = profile[r, 1]
            row += 1
    return found


cdef object _capsule_rings(double radius, double length, double spacing):
    """Return radius and height (K, 2) [m] of the rings of a capsule about z. A capsule of length 0 is a sphere."""
    cdef Py_ssize_t side_steps, cap_steps, sphere_steps, k
    cdef double latitude, height
    if length > 0.0:
        side_steps, cap_steps, sphere_steps = _steps(length, spacing), _steps(M_PI / 2 * radius, spacing), 0
        found = np.empty((2 * cap_steps + side_steps + 1, 2))
    else:
        side_steps, cap_steps, sphere_steps = 0, 0, _steps(M_PI * radius, spacing)
        found = np.empty((sphere_steps + 1, 2))
    cdef double[:, ::1] rings = found
    for k in range(rings.shape[0]):
        # The rings of a capsule are those of the lower hemisphere (`cap_steps` steps), the cylinder (`side_steps`
        # steps) and the upper hemisphere (`cap_steps` steps).
        if length > 0.0:
            latitude = M_PI / 2 * (
                <double> k / cap_steps - 1.0
                if k < cap_steps
                else <double> max(<Py_ssize_t> 0, k - cap_steps - side_steps) / cap_steps
            )
            height = length * (<double> min(max(k - cap_steps, <Py_ssize_t> 0), side_steps) / side_steps - 0.5)
        else:
            latitude, height = M_PI * (<double> k / sphere_steps - 0.5), 0.0
        rings[k, 0] = max(0.0, radius * cos(latitude))
        rings[k, 1] = height + radius * sin(latitude)
    return found


cdef void _write_frame(const double *axis, double length, double (*frame)[3]) noexcept nogil:
    """Compute the smallest rotation (3, 3) that maps z to `axis`; the identity if `length` is 0.

    For the unit axis (x, y, z) the rotation is I + [v]× + [v]×²/(1 + z), v = (−y, x, 0). For z < 0 the sum 1 + z loses
    digits, so it is computed as (x² + y²)/(1 − z).
    """
    cdef Py_ssize_t a, b
    cdef double x, y, z, across, one_plus_z
    for a in range(3):
        for b in range(3):
            frame[a][b] = 1.0 if a == b else 0.0
    if length == 0.0:
        return
    x, y, z = axis[0] / length, axis[1] / length, axis[2] / length
    across = x * x + y * y
    # If x² + y² underflows, the axis is −z, and the rotation is half a turn about x.
    if z < 0.0 and across < 1e-300:
        frame[1][1] = frame[2][2] = -1.0
        return
    one_plus_z = across / (1.0 - z) if z < 0.0 else 1.0 + z
    frame[0][0], frame[0][1], frame[0][2] = 1.0 - x * x / one_plus_z, -x * y / one_plus_z, x
    frame[1][0], frame[1][1], frame[1][2] = frame[0][1], 1.0 - y * y / one_plus_z, y
    frame[2][0], frame[2][1], frame[2][2] = -x, -y, z


cdef double _depth(
    const double *point, const double *start, const double *axis, double squared, double radius
) noexcept nogil:
    """Return the penetration depth [m] of a point in the capsule from `start` to `start + axis`, negative outside.

    `squared` is ‖axis‖².
    """
    cdef double t = 0.0, away = 0.0, step
    cdef Py_ssize_t x
    if squared > 0.0:
        for x in range(3):
            t += (point[x] - start[x]) * axis[x]
        t = min(1.0, max(0.0, t / squared))
    for x in range(3):
        step = point[x] - start[x] - t * axis[x]
        away += step * step
    return radius - sqrt(away)


def capsule_points(
    const double[:, ::1] starts, const double[:, ::1] ends, const double[::1] radii, double spacing
):
    """Sample the surfaces of L capsules. Points deeper than `spacing` inside another capsule are left out.

    `starts` and `ends` (L, 3) are the ends of the capsule axes [m], equal for a sphere; `radii: (L,)` [m]. Each point
    of the surface of the union is within `spacing` [m] of a returned point (M, 3) [m].
    """
    cdef Py_ssize_t L = radii.shape[0], most = 0, kept = 0, i, j, k, r, a, x, count
    cdef double angle, u, v, w
    cdef double frame[3][3]
    cdef bint inside
    cdef const double[:, ::1] rings
    _check_spacing(spacing)
    if starts.shape[0] != L or ends.shape[0] != L or starts.shape[1] != 3 or ends.shape[1] != 3:
        raise InputError(f"starts and ends must have shape ({L}, 3)")
    directions, squares = np.empty((L, 3)), np.zeros(L)
    cdef double[:, ::1] axes = directions
    cdef double[::1] squared = squares
    profiles = []
    for i in range(L):
        for x in range(3):
            axes[i, x] = ends[i, x] - starts[i, x]
            squared[i] += axes[i, x] * axes[i, x]
        rings = profile = _capsule_rings(radii[i], sqrt(squared[i]), spacing)
        profiles.append(profile)
        for r in range(rings.shape[0]):
            most += _steps(2 * M_PI * rings[r, 0], spacing)
    # Each point is written at index `kept`. If it lies deep inside another capsule, the next point overwrites it.
    found = np.empty((most + 1, 3))
    cdef double[:, ::1] points = found
    for i in range(L):
        _write_frame(&axes[i, 0], sqrt(squared[i]), frame)
        rings = profiles[i]
        for r in range(rings.shape[0]):
            count = _steps(2 * M_PI * rings[r, 0], spacing)
            for k in range(count):
                angle = 2 * M_PI * k / count
                u, v, w = rings[r, 0] * cos(angle), rings[r, 0] * sin(angle), rings[r, 1]
                for a in range(3):
                    points[kept, a] = (
                        (starts[i, a] + ends[i, a]) / 2 + frame[a][0] * u + frame[a][1] * v + frame[a][2] * w
                    )
                inside = False
                for j in range(L):
                    if j != i and _depth(&points[kept, 0], &starts[j, 0], &axes[j, 0], squared[j], radii[j]) > spacing:
                        inside = True
                        break
                if not inside:
                    kept += 1
    return found[:kept].copy()
