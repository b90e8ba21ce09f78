"""Descent of way points down the gradient of a path's cost, by quasi-Newton steps, in rounds that are proven."""

cimport cython
from libc.math cimport fabs
from libc.string cimport memcmp, memcpy

from safe_ompl.planning.simplification.costs cimport Densities, DangerTerms, PricedPath, Walk, length_of
from safe_ompl.planning.simplification.edges cimport EdgeProofs

from typing import NamedTuple

import numpy as np

from safe_ompl.common import InputError
from safe_ompl.planning.simplification.cost import STEP
from safe_ompl.planning.simplification.costs import gauss_points, spread
from safe_ompl.planning.simplification.measures import Curve, with_way_points

# All danger points are looked at where configurations are so far apart [rad].
cdef double SCAN = 0.5
# Samples of J are so far apart [rad]: thrice as far as those of a report, a third of the work. Where J differs from
# that of the given path by less than the share, those of a report are taken.
cdef double COARSE = 0.15
cdef double DOUBT = 0.02
cdef double FINE = STEP
# Danger points that reach this share of the greatest danger somewhere matter.
cdef double HIGH = 0.85


cdef class ActiveSetCost:
    """J of a path for the danger points that matter near the path last looked at: others can only add to it.

    `terms` are J alone, a `model` has the obstacle cost, too; `everywhere` is the density of all danger points, and
    `ceiling` J of the first path. Obstacle costs are of the pairs that are near the path that was last anchored.
    """

    cdef readonly object everywhere, robot
    cdef readonly DangerTerms terms
    cdef readonly double ceiling
    cdef object _obstacles, _active, _carriers, _near, _hinges
    cdef Densities _densities

    def __init__(self, danger, obstacles, path):
        cdef Py_ssize_t samples
        self.everywhere, self.robot, self._obstacles = danger, danger.field.robot, obstacles
        self._carriers, self._near = np.zeros(0, np.intp), np.zeros((0, 10))
        self._hinges = np.zeros((0, 2)) if obstacles is None else obstacles.hinges
        self.look_at(path)
        self.ceiling = self.terms.cost_along(path, FINE, &samples)
        self.count(samples)

    cpdef bint look_at(self, path, besides=None) except -1:
        """Take the danger points that matter near a path (N, n), and besides; return whether they are others now."""
        samples = spread(path, SCAN)[0]
        if besides is not None:
            samples = np.concatenate([samples, besides])
        active = self.everywhere.field.high_points(samples, HIGH)
        if self._active is not None and np.array_equal(active, self._active):
            return False
        self._active, self.terms, self._densities = active, self.everywhere.terms(active), None
        return True

    cpdef int count(self, Py_ssize_t configurations) except -1:
        """Count so many evaluations of the danger."""
        self.everywhere.field.count(configurations, len(self.terms.danger.points))
        return 0

    cpdef double of(self, const double[:, ::1] path) except? -1:
        """Return J of an unrolled path (N, n), without obstacle cost; as in its report where that is near `ceiling`."""
        cdef Py_ssize_t samples, finer = 0
        cdef double cost = self.terms.cost_along(path, COARSE, &samples)
        if fabs(cost - self.ceiling) < DOUBT * cost:
            cost = self.terms.cost_along(path, FINE, &finer)
        self.count(samples + finer)
        return cost

    cpdef int anchor(self, path) except -1:
        """From here on take the witnesses of obstacles along a path (N, n)."""
        if self._obstacles is not None:
            near = self._obstacles.near(gauss_points(path))
            self._carriers, self._near, self._densities = near.carriers, near.table, None
        return 0

    cpdef Densities densities(self):
        """Return both costs near the path that was last anchored."""
        if self._densities is None:
            self._densities = Densities(self.terms, self._carriers, self._near, self._hinges)
        return self._densities

    def model(self, path):
        """Return the model of J and obstacle cost near an unrolled path (N, n); see `Densities.model`."""
        return self.priced(path, None)

    cdef PricedPath priced(self, path, PricedPath known):
        """Return what `model` does; the danger at the Gauss points of the path may be known."""
        if known is None:
            self.count(2 * len(path) - 2)
        return self.densities().priced(path, known)


class BestPath:
    """The path that was taken last: none is taken whose J is above that of the given path, as far as J is known.

    When other danger points turn out to matter J is `confirmed` anew, and a path that is dearer is taken back.
    """

    def __init__(self, path, on_better):
        self.path = path
        self.ceiling = np.inf
        self._confirmed = path
        self._on_better = on_better

    @property
    def is_confirmed(self):
        """Whether J of the path is known for the danger points that matter near it."""
        return self.path is self._confirmed

    def take(self, path, cost):
        """Take a proven path (N, n), if its J is not too high; return whether it is taken."""
        if not cost <= self.ceiling:
            return False
        self.path = path
        if self._on_better is not None:
            self._on_better(path, cost)
        return True

    def confirm(self, cost):
        """Say what J of the path is, as is known now; if that is too high, take it back and return False."""
        if cost > self.ceiling:
            self.path = self._confirmed
            return False
        self._confirmed = self.path
        return True


cdef enum:
    ROUNDS = 3
    # Peaks are looked for so often.
    RESOLUTIONS = 2
# Steps between two proofs: more, as long as the proofs succeed.
cdef Py_ssize_t[ROUNDS] STEPS = [4, 10, 16]
# A way point moves no farther than this in one step [rad]; steps below the other are not worth taking.
cdef double LARGEST = 0.4
cdef double SMALLEST = 0.01
# A step that saves less than this share of what a round must save is idle.
cdef double IDLE = 0.05
# A round that fails is tried again with this share of the step.
cdef double CAUTION = 0.5
# When way points have moved so far [rad], other danger points may matter.
cdef double FAR = 1.0
# Way points are at least so far apart [rad]. Peaks are looked for so far from the ends, at samples so close together
# [rad], and are above what the ends force by this share.
cdef double APART = 0.01
cdef double BESIDE = 0.4
cdef double CLOSELY = 0.02
cdef double EXCESS = 0.02


class Terms(NamedTuple):
    """Requirements of a path; `precision` is the share of the cost that a round must save, or it is the last one."""

    proofs: EdgeProofs
    limits: object
    longest: float
    precision: float


cdef class ProvenDescent:
    """Descent of a path (N, n) between two `retreats` that stay; `leads` says whether the best path is one of these."""

    cdef readonly PricedPath here
    cdef public bint leads
    cdef ActiveSetCost _cost
    cdef EdgeProofs _proofs
    cdef object _start, _goal, _limits, _best, _stop
    cdef double _longest, _precision

    def __init__(self, path, retreats, ActiveSetCost cost not None, terms, best, stop):
        cdef const double[:, ::1] given = path
        cdef const double[:, ::1] start
        cdef const double[:, ::1] goal
        start, goal = self._start, self._goal = retreats
        if not start.shape[0] or not goal.shape[0] or not given.shape[0]:
            raise InputError("a path and its retreats must have way points")
        if not 0 < given.shape[1] == start.shape[1] == goal.shape[1]:
            raise InputError(f"retreats must be of {given.shape[1]} joints, got {start.shape[1]} and {goal.shape[1]}")
        self._proofs, self._limits, self._longest, self._precision = terms
        self._cost, self._best, self._stop, self.leads = cost, best, stop, False
        self.here = self._priced(path, cost.of(self._whole(path)), None)

    def run(self):
        """Descend until the cost falls no more, or it is time to stop."""
        for _ in range(1 + RESOLUTIONS):
            if not (self._converge() and self._look_again()):
                break
            if self._stop() or not self._resolve_peaks():
                break
        if self.leads and not self._best.is_confirmed:
            self._look_again()

    cdef bint _converge(self) except -1:
        """Descend until a round gains little; return False if the path turns out to be too dear."""
        cdef ActiveSetCost cost = self._cost
        cdef Walk walk = Walk(*self._limits)
        cdef double largest = LARGEST, gain
        cdef int round_ = 0
        cdef bint settled
        seen, held = self.here.path, None
        walk.restart(cost.densities(), self.here)
        while largest >= SMALLEST:
            settled = walk.descend(self._stop, STEPS[round_], largest, IDLE * self._precision)
            cost.count(walk.evaluations * (2 * self.here.N - 2))
            if self._stop() or not walk.evaluations:
                break
            gain, held = self._take(walk.here)
            if gain == 0.0 or held is not None or gain < self._precision * _total(self.here):
                if gain != 0.0 and settled and held is None:
                    break
                # The witnesses promised more: they hold for smaller steps.
                largest, round_ = CAUTION * largest, 0
                if gain == 0.0:
                    cost.anchor(self.here.path)
                walk.restart(cost.densities(), self.here, held if gain != 0.0 else None)
            else:
                largest, round_ = min(LARGEST, largest / CAUTION), min(round_ + 1, ROUNDS - 1)
                if float(np.abs(self.here.path - seen).max()) > FAR:
                    seen = self.here.path
                    if not self._look_again():
                        return False
                walk.resume(cost.densities(), self.here)
        return True

    cdef tuple _take(self, PricedPath walked):
        """Go on from what is proven of where a walk is, if cheaper; return the gain, and what stays (N,) or None."""
        cdef PricedPath found = self._if_better(walked.path, walked)
        cdef double gain
        held = None
        # A price costs less than a proof.
        if found is not None:
            path, held = self._proofs.held_back(found.path, self.here.path)
            if held is not None:
                found = self._if_better(path, None)
        if found is None:
            return 0.0, held
        gain, self.here = _total(self.here) - _total(found), found
        self.leads = self._best.take(self._whole(found.path), found.cost) or self.leads
        return gain, held

    cdef PricedPath _if_better(self, const double[:, ::1] path, PricedPath known):
        """Return the price of a path, unless it is not lower, or the path is too long; the danger may be known."""
        cdef PricedPath found
        cdef double cost
        whole = self._whole(path)
        if not memcmp(&path[0, 0], self.here._path, path.size * sizeof(double)) or length_of(whole) > self._longest:
            return None
        # More samples than the descent has: it may have got a peak between two of them.
        cost = self._cost.of(whole)
        if not cost < _total(self.here) or (self.leads and not cost <= <double> self._best.ceiling):
            # The price is not lower whatever the obstacle cost adds.
            return None
        found = self._priced(path, cost, known)
        return found if _total(found) < _total(self.here) else None

    cdef PricedPath _priced(self, path, double cost, PricedPath known):
        """Return the price of a path between the retreats, whose J is known; the cost is anchored at it then."""
        self._cost.anchor(path)
        cdef PricedPath found = self._cost.priced(path, known)
        found.cost = cost
        return found

    cdef bint _look_again(self) except -1:
        """Take the danger points that matter now; return whether the path is still no dearer than the given one."""
        whole = self._whole(self.here.path)
        cdef double cost
        if self._cost.look_at(whole):
            cost = self._cost.of(whole)
            self.here = self._cost.priced(self.here.path, None)
            self.here.cost = cost
        return not self.leads or self._best.confirm(self.here.cost)

    @cython.wraparound(True)
    cdef bint _resolve_peaks(self) except -1:
        """Put way points where danger peaks beside the ends, which no node of the cost sees; return whether it does."""
        field = self._cost.everywhere.field
        forced = float(field.values(self._best.path[[0, -1]]).max())
        curve = Curve(field.robot, self.here.path)
        beside = np.arange(0.0, min(BESIDE, 0.5 * curve.length), CLOSELY)
        s = np.concatenate([beside, curve.length - beside[::-1]])
        samples = curve.at(s)
        danger = field.values(samples)
        inner = danger[1:-1]
        peak = (inner > (1.0 + EXCESS) * forced) & (inner >= danger[:-2]) & (inner >= danger[2:])
        path = with_way_points(self.here.path, s[1:-1][peak], APART)
        if len(path) == self.here.N:
            return False
        self._proofs.inherit(path)
        whole = self._whole(path)
        self._cost.look_at(whole, samples[1:-1][peak])
        self.here = self._priced(path, self._cost.of(whole), None)
        return True

    cdef object _whole(self, const double[:, ::1] path):
        """Return `path` with the retreats on both sides."""
        cdef const double[:, ::1] start = self._start
        cdef const double[:, ::1] goal = self._goal
        cdef Py_ssize_t before = start.shape[0] - 1, N = path.shape[0], after = goal.shape[0] - 1, n = path.shape[1]
        found = np.empty((before + N + after, n))
        cdef double[:, ::1] whole = found
        memcpy(&whole[0, 0], &start[0, 0], before * n * sizeof(double))
        memcpy(&whole[before, 0], &path[0, 0], N * n * sizeof(double))
        if after:
            memcpy(&whole[before + N, 0], &goal[1, 0], after * n * sizeof(double))
        return found


cdef inline double _total(PricedPath path):
    """Return J of a path with the obstacle cost of the part that moves."""
    return path.cost + path.near
