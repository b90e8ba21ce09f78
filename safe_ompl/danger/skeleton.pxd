"""Skeletons, danger points, and the table of functions through which other modules call `lanes.pyx`.

`lanes.pyx` is compiled twice: for all processors, and as `lanes_v3` for processors with AVX2 and FMA. The package
chooses the build when it is imported, so other modules cannot `cimport` its functions. They share structs with the
build, and call its functions through pointers.
"""

from libc.math cimport sqrt

from safe_ompl.robot.kinematics cimport Joint, KeyPoint


cdef extern from *:
    """
    #define SAFE_OMPL_ZERO 1e-30
    #define SAFE_OMPL_ROUNDING (8 * 2.220446049250313e-16)
    #define SAFE_OMPL_SERIES 0.01
    """
    # Lengths [m] and other divisors are at least this large, so that a division by zero does not give NaN.
    const double ZERO "SAFE_OMPL_ZERO"
    # Quantities below this share of the quantities that they are computed from are rounding errors, and count as zero:
    # eight units of double precision.
    const double ROUNDING "SAFE_OMPL_ROUNDING"
    # If (ℓ/S)² is below this value, κ is computed by a series, because the closed form cancels.
    const double SERIES "SAFE_OMPL_SERIES"


cdef inline double half_square_difference(const double *u, const double *v, double d1, double d2) noexcept nogil:
    """Return (S² − ℓ²)/2 for a point beside a link of length ℓ, without cancellation; 0 if the point is on the link.

    u and v (3,) lead from the ends of the link to the point, and S is the sum of their lengths d1 and d2. So the result
    is d1·d2 + u·v = ‖u × v‖²/(d1·d2 − u·v). If u·v < 0, the sum cancels, and the quotient is used.
    """
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


# The links of a robot as line segments between key points. `SkeletonTable` owns the arrays.
cdef struct Skeleton:
    # The joints (m,) that carry the key points.
    const Joint *joints
    Py_ssize_t m
    const KeyPoint *keys
    # The number of key points.
    Py_ssize_t K
    # Indices (L, 2) of the key points at both ends of each link.
    const Py_ssize_t *links
    Py_ssize_t L
    # Whether the weight of a link is its length. Otherwise all weights are 1.
    bint by_length


# The danger points. `DangerPointTable` owns the arrays.
cdef struct Points:
    # Coordinates (3, M) [m]. Each coordinate is contiguous, so that loops over points fill SIMD registers.
    const double *columns
    # Weights k₁w (M,).
    const double *point_weights
    # The coordinates in single precision, for bounds of the danger: twice as many of them fill a SIMD register.
    const float *single
    # The largest absolute value of `single` [m], by which the rounding errors of these bounds are bounded.
    double reach
    Py_ssize_t M


# The points begin, …, end − 1 of an array of coordinates (3, stride) [m].
cdef struct PointRange:
    const double *columns
    Py_ssize_t stride
    Py_ssize_t begin
    Py_ssize_t end


# The request for all high levels (dangers of single points), not only for the highest level of each configuration.
cdef struct HighLevels:
    # A level counts if it is at least `min_share` of the highest level at its configuration, and at least `min_level`.
    double min_share
    double min_level
    # Output: for each point the highest level that counts at any of the configurations, (M,), or 0 if none counts.
    double *levels


# The functions of the chosen build of `lanes.pyx`.
cdef struct LaneFunctions:
    # Return the bytes of working memory that `fields_at_points` needs for this number of key points.
    Py_ssize_t (*block_size)(Py_ssize_t) noexcept nogil
    # Write the fields at points for one configuration with key points (K, 3) [m]. The fields of the links are written
    # as L rows, which begin `row_stride` numbers apart. If `summed`, their sum is written as one row instead.
    void (*fields_at_points)(
        const double *key_points, const Skeleton *skeleton, const PointRange *points, double *fields,
        Py_ssize_t row_stride, bint summed, void *memory,
    ) noexcept nogil
    # Write the highest level (B,) at `values: (B, m)`. Write its gradients (B, m) and other high levels, too, unless
    # these pointers are NULL. Return −1 if there is not enough memory.
    int (*highest)(
        const Skeleton *skeleton, const double *values, Py_ssize_t B, const Points *points, double *gradients,
        const HighLevels *others, double *out,
    ) noexcept nogil
    # Write the gradients (B, m) of weighted sums of the fields at chosen points (B, J). Return −1 if there is not
    # enough memory.
    int (*gradients)(
        const Skeleton *skeleton, const double *values, Py_ssize_t B, const Points *points, const Py_ssize_t *chosen,
        const double *weights, Py_ssize_t J, double *out,
    ) noexcept nogil
