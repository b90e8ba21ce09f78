"""Proofs of motions: the structs, classes and functions that other compiled modules `cimport`."""

from safe_ompl.geometry.convex cimport Bodies, Pose, Search, ShapeTable
from safe_ompl.robot.kinematics cimport EdgeTable, Joint, JointTable

# The balls about the obstacles of groups are compared in blocks of LANES, which fill the SIMD registers.
cdef enum:
    LANES = 8


# Consecutive pairs of one of the robot's bodies, which are left out together if their obstacles are far away. Its
# members are those of `GROUP` in `proofs.pyx`, which explains them.
cdef struct Group:
    Py_ssize_t begin
    Py_ssize_t end
    Py_ssize_t body
    double centre[3]
    double radius
    Py_ssize_t lane
    Py_ssize_t run_from_here
    Py_ssize_t run_to_here
    double run_centre[3]
    double run_radius


# The tables of P pairs of bodies, which do not change after a `DistanceBounds` has made them. Threads share them.
cdef struct Pairs:
    # P.
    Py_ssize_t count
    # The number of the robot's bodies, which come first.
    Py_ssize_t own
    # The number of joints of Pinocchio's model.
    Py_ssize_t m
    # The number G of all bodies.
    Py_ssize_t shape_count
    const Joint *joints
    # Indices of the two bodies (P, 2). The first one is the robot's.
    const size_t (*bodies)[2]
    # Motion bounds of the pairs (m, P), and of the bodies (m, G). All pairs of one joint are contiguous, so that sums
    # over joints are loops over contiguous numbers.
    const double *radii
    const double *reaches
    # A pair is certainly too near if its distance is this far below the required one, (P,) [m]. It is infinite if a
    # body is only contained in its convex shape, because the bodies may then be farther apart than the shapes.
    const double *certain
    const Group *groups
    Py_ssize_t group_count
    # Centres and radii of the balls about the obstacles, (4, lanes) [m]; see `_grouped`.
    const double *balls
    Py_ssize_t lanes


# Working memory of one proof, which `DistanceBounds.workspace` reuses. Here G is the number of the robot's bodies. The
# letters W, V and K are those of the formulas in `proofs.pyx`.
cdef struct Memory:
    # The frames of the joints at the present place of the motion: (m, 3, 3), (m, 3) and (m, 3).
    double *rotations
    double *origins
    double *axes
    # The twists of the base, which is 0, and of the joints, (m + 1, 6).
    double *twists
    # How the joints move at this place: the rows PLACE, SPEED, …, (TAYLOR + degree + 1, m).
    double *moves
    # The largest degree of curves for which `moves` has enough rows.
    Py_ssize_t degree
    # Bounds of the velocities and of the accelerations of points of the bodies, (G,): W, V and K.
    double *W
    double *V
    double *K
    # Bounds W_p of the rates at which pairs approach, (P,).
    double *rates
    # For each pair the rows FROM, UNTIL and AXIS, (5, P).
    double *known
    # The pairs that are not proven for the interval so far.
    Py_ssize_t *listed
    # The pairs that blocked motions last. They are compared first, because they often block the next motion, too.
    Py_ssize_t *suspects
    Py_ssize_t suspect_count
    # The begins and ends of the intervals that are not proven yet, (INTERVALS, 2).
    double *left
    # Start and displacement of an edge, (2, m).
    double *edge
    # For each of these intervals the number of pairs that are listed, or −1 if the pairs must be listed anew.
    Py_ssize_t *counts
    Search search


cdef class Required:
    cdef double[::1] distances
    # The largest of the distances [m]. Groups of pairs that are farther apart than this are left out as a whole.
    cdef double most


cdef class Workspace:
    cdef Bodies bodies
    cdef Memory memory
    cdef int make_room(self, Py_ssize_t m, Py_ssize_t degree) except -1


# The result of `prove_curve` and `prove_edge`.
cdef struct Outcome:
    # The number of intervals that are not proven; −1 if some pair is certainly too near.
    Py_ssize_t number
    # The fraction of the motion at which a pair is or may be too near; −1 if there is none.
    double at
    # The number of configurations at which bounds were computed.
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
    cdef object _result(self, Workspace work, Outcome outcome)


cdef Outcome prove_curve(
    const Pairs *pairs, Workspace work, const double *curve, Py_ssize_t degree, const double *required, double most,
    double floor,
) noexcept nogil

cdef Outcome prove_edge(
    const Pairs *pairs, Workspace work, const double *start, const double *end, EdgeTable limits,
    const double *required, double most, double floor,
) noexcept nogil

# The arrays of the obstacle cost; see `hinge_costs` in `proofs.pyx`.
cdef struct HingeTerms:
    # Pinocchio's numbers of the joints that carry the first bodies of K pairs, (K,).
    const Py_ssize_t *carriers
    # The rows (C, 10) that `DistanceBounds.near` returns, and their number C.
    const double *near
    Py_ssize_t near_count
    # For each hinge the distance D > 0 [m] beyond which obstacles cost nothing, and the weight w, (H, 2); and H.
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
