"""Skeletons and points for compiled modules, and what the two builds of `lanes.pyx` offer.

`lanes.pyx` is compiled for all processors, and once more, as `lanes_v3`, for those with AVX2. The package chooses one
of them when it is imported. So other modules share structs with it, and call its functions by pointers.
"""

from libc.math cimport sqrt

from safe_ompl.robot.kinematics cimport Joint, KeyPoint


cdef extern from *:
    """
    #define SAFE_OMPL_ZERO 1e-30
    #define SAFE_OMPL_ROUNDING (8 * 2.220446049250313e-16)
    #define SAFE_OMPL_SERIES 0.01
    """
    # Stands for a length of zero [m].
    const double ZERO "SAFE_OMPL_ZERO"
    # Relative size of what is as good as zero: eight units of rounding.
    const double ROUNDING "SAFE_OMPL_ROUNDING"
    # (ℓ/S)² below which κ is summed as a series.
    const double SERIES "SAFE_OMPL_SERIES"


cdef inline double half_gap(const double *u, const double *v, double d1, double d2) noexcept nogil:
    """Return (S² − ℓ²)/2 = ‖u‖‖v‖ + u·v = ‖u × v‖²/(‖u‖‖v‖ − u·v), without cancellation; zero on the segment."""
    cdef double along, product, x, y, z, area
    if min(d1, d2) <= ROUNDING * max(d1, d2):
        return 0.0
    along, product = u[0] * v[0] + u[1] * v[1] + u[2] * v[2], d1 * d2
    if not along < 0:
        return product + along
    x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    area = sqrt(x * x + y * y + z * z)
    if area <= ROUNDING * product:
        return 0.0
    return area * area / (product - along)


# A robot's joints (m,), key points (K,) and links between these, (L, 2); whether links weigh by their length.
cdef struct Skeleton:
    const Joint *joints
    Py_ssize_t m
    const KeyPoint *keys
    Py_ssize_t K
    const Py_ssize_t *links
    Py_ssize_t L
    bint by_length


# Danger points as columns (3, M) [m], their weights k₁w (M,), the columns in single precision, and the largest number.
cdef struct Points:
    const double *columns
    const double *point_weights
    const float *single
    double reach
    Py_ssize_t M


# Points begin, …, end − 1 of columns (3, stride) [m].
cdef struct PointRange:
    const double *columns
    Py_ssize_t stride
    Py_ssize_t begin
    Py_ssize_t end


# Which levels of danger are wanted beside the highest one, and where they are written.
cdef struct HighLevels:
    # Only levels of at least this share of the highest one at a configuration, and of at least `least`, count.
    double share
    double least
    # The highest level that counts of each point, (M,); 0 where there is none.
    double *levels


cdef struct LaneFunctions:
    # Bytes of working memory of `potentials`, for so many key points.
    Py_ssize_t (*block_size)(Py_ssize_t) noexcept nogil
    # Write the field at points: of each link into levels (L, `room`), or their sum into one row.
    void (*potentials)(
        const double *places, const Skeleton *skeleton, const PointRange *points, double *levels, Py_ssize_t room,
        bint summed, void *memory,
    ) noexcept nogil
    # Write the highest level (B,) at `values: (B, m)`, its gradients (B, m) unless NULL, and other high levels unless
    # NULL. −1: no memory.
    int (*highest)(
        const Skeleton *skeleton, const double *values, Py_ssize_t B, const Points *points, double *gradients,
        const HighLevels *others, double *out,
    ) noexcept nogil
    # Write the gradients (B, m) of weighted sums of the fields at chosen points (B, J). −1: no memory.
    int (*gradients)(
        const Skeleton *skeleton, const double *values, Py_ssize_t B, const Points *points, const Py_ssize_t *chosen,
        const double *weights, Py_ssize_t J, double *out,
    ) noexcept nogil
