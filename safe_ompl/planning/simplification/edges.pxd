"""Proofs of edges for compiled modules."""


cdef class EdgeProofs:
    cdef object _free, _clear, _stop
    cdef set _proven, _inherited
    cdef int _prove(self, motion, bint surely, const double[:, ::1] path, list keys, list edges) except -1
    cdef list _left_by_bounds(self, motion, const double[:, ::1] path, list keys, list edges)
