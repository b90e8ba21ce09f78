"""Proofs of motions for compiled modules."""

from safe_ompl.geometry.convex cimport Bodies, Pose, Search, ShapeTable
from safe_ompl.robot.kinematics cimport EdgeTable, Joint, JointTable

# Balls about groups are compared in blocks of LANES, which fill the SIMD registers.
cdef enum:
    LANES = 8


# A group of pairs, all of one of the robot's bodies; see `grouped` in `proofs.pyx`.
cdef struct Group:
    Py_ssize_t begin
    Py_ssize_t end
    Py_ssize_t body
    double centre[3]
    double radius
    Py_ssize_t lane
    Py_ssize_t on
    Py_ssize_t back
    double around[3]
    double wide


# What is known of the pairs of bodies of a robot and a scene; see `DistanceBounds`.
cdef struct Pairs:
    Py_ssize_t count
    Py_ssize_t own
    Py_ssize_t m
    Py_ssize_t shape_count
    const Joint *joints
    const size_t (*bodies)[2]
    const double *radii
    const double *reaches
    const double *certain
    const Group *groups
    Py_ssize_t group_count
    const double *balls
    Py_ssize_t lanes


# Working memory of proofs: poses of bodies and frames of joints at a place; how joints and bodies move; what is known
# of pairs, and which of them are listed or suspected; intervals that wait.
cdef struct Memory:
    double *rotations
    double *origins
    double *axes
    double *twists
    double *moves
    Py_ssize_t degree
    double *W
    double *V
    double *K
    double *rates
    double *known
    Py_ssize_t *listed
    Py_ssize_t *suspects
    Py_ssize_t suspect_count
    double *left
    double *edge
    Py_ssize_t *counts
    Search search


cdef class Required:
    cdef double[::1] distances
    cdef double most


cdef class Workspace:
    cdef Bodies bodies
    cdef Memory memory
    cdef int make_room(self, Py_ssize_t m, Py_ssize_t degree) except -1


# Intervals that are not proven; where a pair may be too near, or −1; at how many places bounds were computed.
cdef struct Outcome:
    Py_ssize_t number
    double at
    Py_ssize_t places


cdef class DistanceBounds:
    cdef readonly object exact, groups
    cdef object _counts, _coupling, _free, _kept
    cdef readonly ShapeTable shapes
    cdef readonly JointTable joints
    cdef Pairs pairs
    cdef Workspace workspace(self)
    cdef int _run(self, Group[::1] group, Py_ssize_t begin, Py_ssize_t end) except -1
    cdef int _check(self, Required required, Py_ssize_t joints) except -1
    cdef int _check_places(self, const double[:, ::1] values, const size_t[:, ::1] pairs, Py_ssize_t K) except -1
    cdef object _told(self, Workspace work, Outcome outcome)


cdef Outcome prove_curve(
    const Pairs *pairs, Workspace work, const double *curve, Py_ssize_t degree, const double *required, double most,
    double floor,
) noexcept nogil

cdef Outcome prove_edge(
    const Pairs *pairs, Workspace work, const double *start, const double *end, EdgeTable limits,
    const double *required, double most, double floor,
) noexcept nogil

# What a robot near obstacles costs; see `hinge_costs` in `proofs.pyx`.
cdef struct HingeTerms:
    # The number of the joint in Pinocchio that carries the first body of each pair, (K,).
    const Py_ssize_t *carriers
    # Rows of `DistanceBounds.near`, (C, 10), and C.
    const double *near
    Py_ssize_t near_count
    # Distances D > 0 [m] from which on obstacles cost nothing, and weights w, (H, 2); and H.
    const double *hinges
    Py_ssize_t hinge_count


cdef HingeTerms hinge_terms(
    JointTable joints, Py_ssize_t B, const Py_ssize_t[::1] carriers, const double[:, ::1] near,
    const double[:, ::1] hinges,
) except *

cdef void add_hinge_costs(
    const Joint *joints, Py_ssize_t m, const double *values, const HingeTerms *terms, double *frames, double *costs,
    double *gradients, double *vectors,
) noexcept nogil
