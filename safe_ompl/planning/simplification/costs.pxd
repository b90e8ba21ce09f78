"""Costs of paths and their descent: the classes and functions that other compiled modules `cimport`.

The classes are documented in `costs.pyx`. Public members are for Python; members that begin with an underscore are the
same arrays as memory views or pointers, which loops without the GIL need.
"""

from safe_ompl.collision.proofs cimport HingeTerms
from safe_ompl.danger.static cimport PointDanger
from safe_ompl.robot.kinematics cimport JointTable


cdef class DangerTerms:
    cdef readonly PointDanger danger
    cdef readonly double weight
    cdef readonly object matrix, shift
    cdef const double[:, ::1] _matrix
    cdef const double[::1] _shift
    # Numbers of the model's joints and of the planned joints.
    cdef Py_ssize_t m, n
    cdef int write(self, const double *Q, Py_ssize_t B, double *values, double *slopes, double *danger) except -1 nogil
    cdef void write_by_planned_joints(self, const double *slopes, Py_ssize_t C, double *out) noexcept nogil
    cdef double cost_along(self, const double[:, ::1] path, double step, Py_ssize_t *samples) except? -1


cdef class PricedPath:
    cdef readonly double value, near
    cdef readonly object path, gradient, danger, slopes
    cdef public object blocks, beside
    cdef public double cost
    # Numbers of way points, planned joints and the model's joints.
    cdef Py_ssize_t N, n, m
    cdef double *_path
    cdef double *_gradient
    cdef double *_danger
    cdef double *_slopes
    # Working memory, allocated once for each path, because a descent evaluates the cost hundreds of times. All pointers
    # lead into the one block that begins at `_nodes`.
    # The Gauss points (B, n).
    cdef double *_nodes
    # The values of the model's joints at the Gauss points (B, m).
    cdef double *_values
    # The derivatives of the obstacle costs by the model's joints (B, m).
    cdef double *_obstacle_slopes
    # The obstacle costs (B,).
    cdef double *_nears
    # The lengths of the segments (N − 1,) [rad].
    cdef double *_lengths
    # The frames of the joints at one Gauss point (15 m,).
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
    # The smallest number of configurations that a path must have so that every near pair belongs to one of them.
    cdef Py_ssize_t _rows
    cdef int check(self, Py_ssize_t n, Py_ssize_t rows) except -1
    cdef void add_near(
        self, const double *values, double *frames, double *costs, double *gradients, double *vectors
    ) noexcept nogil
    cdef int price(self, PricedPath at, bint known, double *vectors) except -1 nogil
    cdef PricedPath priced(self, const double[:, ::1] path, PricedPath known)


cdef class Walk:
    # Limits of the planned joints (n,) [rad or m].
    cdef const double[::1] _lower, _upper
    # The model of the cost. It is None before `restart`, and after a restart that raised an error.
    cdef Densities _densities
    # The present path, and the path after the step that is tried. An accepted step swaps the two.
    cdef PricedPath _here, _next
    # The Cholesky factor of the first Hessian (N·n, 2n), see `factored`, and the search direction (N, n).
    cdef double[:, ::1] _band, _direction
    # The last `MEMORY` steps and changes of the gradient (MEMORY, N, n) of L-BFGS, and their scalar products.
    cdef double[:, :, ::1] _steps, _changes
    cdef double _products[6]
    # 1 for each way point (N,) that may move, 0 for the others.
    cdef const unsigned char[::1] _moving
    # The last accepted step as a share of its search direction.
    cdef double _size
    # The number of steps that were remembered since the last reset, of which the last `MEMORY` are kept, and the number
    # of steps in a row that saved little.
    cdef Py_ssize_t _remembered, _idle
    cdef readonly Py_ssize_t evaluations
    cdef PricedPath _place(self)
    cdef int _take_steps(self, Py_ssize_t most, double largest, double idle) except -1 nogil
    cdef void _go(self, double size) noexcept nogil
    cdef void _accept(self) noexcept nogil
    cdef double _write_direction(self, double *largest) noexcept nogil


cdef double length_of(const double[:, ::1] path) noexcept nogil

cdef double distance(const double[:, ::1] path, Py_ssize_t a, Py_ssize_t b) noexcept nogil
