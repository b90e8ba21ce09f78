"""The static danger field for compiled modules."""

from safe_ompl.danger.skeleton cimport LaneFunctions, Points, Skeleton
from safe_ompl.robot.kinematics cimport KeyPointTable

# The functions of the build of `lanes.pyx` that was chosen for this processor.
cdef const LaneFunctions *lanes

cdef Skeleton skeleton_of(const Py_ssize_t[:, ::1] links, const double[:, :, ::1] places, bint by_length) except *


# The classes are documented in `static.pyx`. Each has a struct of pointers to its arrays for loops without the GIL.
cdef class SkeletonTable:
    cdef readonly KeyPointTable keys
    cdef readonly object links
    cdef Skeleton data


cdef class DangerPointTable:
    cdef readonly object columns, point_weights, single
    cdef Points data


cdef class PointDanger:
    cdef readonly SkeletonTable skeleton
    cdef readonly DangerPointTable points
    cdef readonly int kind
    cdef readonly double sharpness
    cdef int write(self, const double *values, Py_ssize_t B, double *gradients, double *out) except -1 nogil
