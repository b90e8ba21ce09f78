"""Costs of paths for compiled modules."""

from safe_ompl.collision.proofs cimport HingeTerms
from safe_ompl.danger.static cimport PointDanger
from safe_ompl.robot.kinematics cimport JointTable


cdef class DangerTerms:
    cdef readonly PointDanger danger
    cdef readonly double weight
    cdef readonly object matrix, shift
    cdef const double[:, ::1] _matrix
    cdef const double[::1] _shift
    cdef Py_ssize_t m, n
    cdef int write(self, const double *Q, Py_ssize_t B, double *values, double *slopes, double *danger) except -1 nogil
    cdef void write_by_planned_joints(self, const double *slopes, Py_ssize_t C, double *out) noexcept nogil
    cdef double cost_along(self, const double[:, ::1] path, double step, Py_ssize_t *samples) except? -1


cdef class PricedPath:
    cdef readonly double value, near
    cdef readonly object path, gradient, danger, slopes
    cdef public object blocks, beside
    cdef public double cost
    cdef Py_ssize_t N, n, m
    cdef double *_path
    cdef double *_gradient
    cdef double *_danger
    cdef double *_slopes
    # Working memory: nodes (B, n), values of the joints and slopes of the costs of obstacles (B, m), costs of obstacles
    # (B,), lengths of segments (N − 1,), and frames of the joints (15 m,).
    cdef double *_nodes
    cdef double *_values
    cdef double *_obstacle_slopes
    cdef double *_nears
    cdef double *_lengths
    cdef double *_frames


cdef class Densities:
    cdef readonly DangerTerms terms
    cdef readonly object carriers, near, hinges
    cdef JointTable _joints
    cdef const Py_ssize_t[::1] _carriers
    cdef const double[:, ::1] _near
    cdef const double[:, ::1] _hinges
    # Pointers to the three arrays above.
    cdef HingeTerms _obstacle_terms
    cdef Py_ssize_t _rows
    cdef int check(self, Py_ssize_t n, Py_ssize_t rows) except -1
    cdef void add_near(
        self, const double *values, double *frames, double *costs, double *gradients, double *vectors
    ) noexcept nogil
    cdef int price(self, PricedPath at, bint known, double *vectors) except -1 nogil
    cdef PricedPath priced(self, const double[:, ::1] path, PricedPath known)


cdef class Walk:
    cdef const double[::1] _lower, _upper
    cdef Densities _densities
    cdef PricedPath _here, _next
    cdef double[:, ::1] _band, _direction
    cdef double[:, :, ::1] _steps, _changes
    cdef double _products[6]
    cdef const unsigned char[::1] _moving
    cdef double _size
    cdef Py_ssize_t _remembered, _idle
    cdef readonly Py_ssize_t evaluations
    cdef PricedPath _place(self)
    cdef int _take_steps(self, Py_ssize_t most, double largest, double idle) except -1 nogil
    cdef void _go(self, double size) noexcept nogil
    cdef void _accept(self) noexcept nogil
    cdef double _write_direction(self, double *largest) noexcept nogil


cdef double length_of(const double[:, ::1] path) noexcept nogil

cdef double distance(const double[:, ::1] path, Py_ssize_t a, Py_ssize_t b) noexcept nogil
