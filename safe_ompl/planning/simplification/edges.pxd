"""The class that proves the edges of paths, for the modules that `cimport` it."""


cdef class EdgeProofs:
    # `MotionProver`s without and with the margin that new edges must keep, and the function that says when to stop.
    cdef object _free, _clear, _stop
    # Keys of the edges that are accepted, and of the parts of accepted edges, which are proven without the margin.
    cdef set _proven, _inherited
    cdef int _prove(self, motion, bint surely, const double[:, ::1] path, list keys, list edges) except -1
    cdef list _left_by_bounds(self, motion, const double[:, ::1] path, list keys, list edges)
