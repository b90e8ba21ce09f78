"""SAFE_RRT-CONNECT (paper, §4.4): two trees, Q₁ and Q₂, that grow by turns until they meet.

    procedure SAFE_RRT-CONNECT(q_s, q_g)
        for k = 1 to K do
            q_rand ← RANDOM_CONFIG()
            q_old ← argmin over q in Q₁ of ρ(q, q_rand) + α·CDF(q)
            q_new ← EXTEND(q_old, q_rand)
            q̄_old ← argmin over q in Q₂ of ρ(q, q_new) + α·CDF(q)
            if CONNECT(q̄_old, q_new) = Successful then RETURN_PATH(Q₁, Q₂)
            SWAP(Q₁, Q₂)
        return Failure

`Growth._safe_rrt_connect` is that loop; `SafeRRTConnect` says where it differs, and why. It runs without the GIL.
Python is called where a `Growth` asks it: for the clock, for goals, and for what bounds of distances and the package's
own danger field do not decide, such as a user's motion validator or objective. What such a call raises ends the loop.

Trees are structs with room for more nodes. A `Tree` owns one, and shows it to Python.
"""

from cpython.exc cimport PyErr_CheckSignals
from cpython.pycapsule cimport PyCapsule_GetPointer
from cython cimport final
from libc.math cimport INFINITY, M_PI, NAN, cos, fabs, nextafterf, pow, sin, sqrt
from libc.stdint cimport uint32_t, uint64_t
from libc.stdlib cimport free, realloc
from libc.string cimport memcpy

from safe_ompl.collision.proofs cimport DistanceBounds, Outcome, Workspace, prove_edge
from safe_ompl.danger.static cimport PointDanger
from safe_ompl.robot.kinematics cimport (
    Coordinates, EdgeTable, bounded, descend, difference, motion_between, rotate, rotation_between, steer,
)

from enum import IntEnum

import numpy as np

from safe_ompl.collision import ALLOWANCE
from safe_ompl.common import InputError, PlanningError
from safe_ompl.robot import plain

# NumPy's bitgen_t (numpy/random/bitgen.h), up to the function that is called here. Its layout is part of NumPy's public
# C interface. Stated here, it needs no headers: building does without NumPy, whose installation takes seconds.
cdef struct bitgen_t:
    void *state
    uint64_t (*next_uint64)(void *) noexcept nogil
    uint32_t (*next_uint32)(void *) noexcept nogil
    double (*next_double)(void *) noexcept nogil

# The parent of a node that has none.
ROOT = -1

cdef enum:
    _ROOT = -1
    # Nodes in a leaf, cells in a group.
    SIZE = 16
    # Nodes that a scan is through with before a search in the k-d tree is.
    FEW = 400
    # Nodes for which a new tree has room.
    ROOM = 64
    # Steps between two looks at the clock: some ms.
    STEPS = 40
    # Nodes that are refused as too dangerous before the threshold rises.
    REFUSED = 8
    # Where obstacles refuse so many times as many steps as danger does, proofs go first.
    RARE = 4
    # Nodes; easy problems are solved before a tree has more.
    LARGE = 64
    # Turns of a tree that lags before the other has one.
    IN_A_ROW = 8
    # Places of a motion at which its danger is looked at.
    SAMPLES = 8

# To this share of itself a margin falls.
cdef double FALL = 0.6
# Of a whole step; shorter ones are not tried.
cdef double SHORTEST = 0.05
# [rad] by which gaps are taken for less where coordinates wrap: no rounding may hide a node.
cdef double ROUNDING = 1e-9
# More than the relative distance of a number in single precision from the next.
cdef double SINGLE = 1.2e-7
# Of the decay: easy problems are solved before danger loses weight.
cdef double SHARPNESS = 4.0
cdef double _ALLOWANCE = ALLOWANCE

# How a step ends: no new node, one on the way, or one at the target.
cdef enum:
    TRAPPED, ADVANCED, REACHED
# What is known of a motion to a new node.
cdef enum:
    BLOCKED, DANGEROUS, ALLOWED


Extension = IntEnum("Extension", {"TRAPPED": TRAPPED, "ADVANCED": ADVANCED, "REACHED": REACHED}, module=__name__)


class TimeIsUpError(Exception):
    """Ends the loop when its termination condition says so."""


# A k-d tree; see `_nearest`. A cell is divided by a coordinate into two, those of nodes that are not beyond the `cut`
# and of those that are. A cell whose nodes are all at one place is divided by their numbers, as if they were coordinate
# n. `group` and `lane` are where a cell stands; −1 if only cells that it is divided into do.
cdef struct Cell:
    Py_ssize_t less
    Py_ssize_t more
    Py_ssize_t by
    double cut
    Py_ssize_t group
    Py_ssize_t lane


# The cells that one cell is divided into by some cuts. `below` a cell is another group, which divides it further, or
# its leaf k as −1 − k.
cdef struct Group:
    Py_ssize_t size
    Py_ssize_t cells[SIZE]
    Py_ssize_t below[SIZE]


cdef struct Leaf:
    Py_ssize_t size
    Py_ssize_t nodes[SIZE]


# A group that waits to be searched, or a leaf, and a lower bound of what there is in it.
cdef struct Waiting:
    Py_ssize_t below
    double bound


# `boxes: (groups, 2n + 1, SIZE)` are the least and the greatest coordinates in cells, and the least cost; `places:
# (leaves, n + 1, SIZE)` the coordinates and costs of nodes, rounded down. Costs are ∞ until they are known, which those
# of `priced` nodes are. There is one cell less than twice as many as leaves. `depth` is the most groups above a leaf.
cdef struct BoxTree:
    Py_ssize_t count
    Py_ssize_t priced
    Py_ssize_t leaf_count
    Py_ssize_t leaf_room
    Py_ssize_t group_count
    Py_ssize_t group_room
    Py_ssize_t root
    Py_ssize_t depth
    Py_ssize_t waiting_room
    Cell *cells
    Group *groups
    Leaf *leaves
    float *boxes
    float *places
    Waiting *waiting


# A tree of `count` nodes, with `room` for more: configurations, the numbers of parents, costs, which are NaN where they
# are not known, gradients of costs; of which nodes the last step was trapped, and of which gradients are known. Before
# node `priced` all costs are known. Edges are driven from the start, or to it. `boxes` find the nearest node.
cdef struct Nodes:
    Py_ssize_t n
    Py_ssize_t count
    Py_ssize_t room
    Py_ssize_t priced
    bint from_start
    const unsigned char *wraps
    const Py_ssize_t *rotations  # first coordinates
    Py_ssize_t turns
    double *rows                # (room, n)
    Py_ssize_t *parents
    double *costs
    double *gradients           # (room, n)
    unsigned char *narrow
    unsigned char *sloped
    BoxTree boxes


cpdef double danger_share(Py_ssize_t turns, double half_life) noexcept nogil:
    """Return the scale of danger after so many turns."""
    return 1.0 / (1.0 + pow(turns / half_life, SHARPNESS))


cpdef double lowered_margin(double level, double least) noexcept nogil:
    """Return the margin [m] after it was lowered; less than the least is none."""
    return FALL * level if FALL * level >= least else 0.0


# ------------------------------------------------------------------------------------------------- growth by turns


@final
cdef class Growth:
    """Grows two trees by turns until they meet (§4.4), or one by single steps (§4.3).

    Parameters
    ----------
    problem : PlanningProblem
        Says which motions are free, and what configurations cost.
    danger : DangerWeight
        What danger weighs.
    margin : Margin
        What motions keep from obstacles.
    decay : DangerDecay, optional
        How danger and margin lose their weight from turn to turn.

    Attributes
    ----------
    slide : float
        The largest sideways motion of new nodes down the gradient of the danger, as a share of the reach; 0: none.
    rise : float
        The share by which the threshold on danger rises after every eight refusals; 0: there is none.
    """

    cdef object problem, danger, margin, decay
    cdef public double slide, rise
    cdef Coordinates space
    # What is grown, and what is asked while it is.
    cdef bint busy
    cdef object trees, rng, stop, enough_nodes, take_goals
    cdef Tree start
    cdef Tree goal
    cdef bitgen_t *random
    # Proofs: tables and memory; distances that pairs must keep without the margin, and with it; which meet obstacles.
    cdef bint proves
    cdef object required_by, known_bounds, counts
    cdef DistanceBounds bounds
    cdef Workspace work
    cdef EdgeTable limits
    cdef const double[::1] least
    cdef const unsigned char[::1] meets
    cdef double[::1] required
    cdef double most, kept, floor
    # The package's own danger field.
    cdef bint prices, has_danger
    cdef object field
    cdef PointDanger own_danger
    # A step is `reach` long at most [rad], and `share` of that sideways. In a share `ignored` of the choices danger has
    # no weight; in turns that ignore it `scale` is 0.
    cdef double reach, share, ignored, alpha, scale, slope, half_life
    # The margin [m], and how often it was refused; the threshold on danger, and how often it refused.
    cdef double clearance, least_clearance, threshold
    cdef Py_ssize_t too_near, patience, refused
    cdef Py_ssize_t blocked, dangerous
    # Turns in all, and of one tree in a row; steps until the clock is looked at; nodes, and with how many more of them
    # there may be another goal; what is to be counted.
    cdef Py_ssize_t turns, in_a_row, steps, nodes, enough, places, evaluations
    # Room for configurations (n,).
    cdef double[::1] q_rand, straight, moved, downhill, gradient
    # The danger of the node that a step leads to; NaN where it is not known. Its gradient is known with it.
    cdef double cost

    def __init__(self, problem, danger, margin, decay=None):
        self.problem, self.danger, self.margin, self.decay = problem, danger, margin, decay
        self.space = problem.coordinates
        self.q_rand, self.straight, self.moved, self.downhill, self.gradient = np.zeros((5, self.space.n))
        self.required_by = self.field = None
        self.reset()

    def reset(self):
        """Begin anew, with other trees."""
        self.threshold, self.refused, self.blocked, self.dangerous, self.in_a_row = 0.0, 0, 0, 0, 1

    def connect(self, trees, rng, double reach, double ignored, Py_ssize_t iterations, stop, enough_nodes, take_goals):
        """SAFE_RRT-CONNECT: let two trees grow by turns, that of the start first; return a path between them.

        Parameters
        ----------
        trees : Trees
            The trees; both have a root at least.
        rng : numpy.random.Generator
            Draws random numbers. Nobody else may draw meanwhile.
        reach : float
            Largest length of a step [rad].
        ignored : float
            Share of the choices of a node in which danger has no weight.
        iterations : int
            K, after how many turns to give up; 0: never.
        stop : callable
            Says that time is up. It is asked every forty steps, and after every other call of Python.
        enough_nodes : callable
            With how many more nodes than this goals are asked for.
        take_goals : callable
            Takes goals.

        Returns
        -------
        ndarray of shape (N, n) or None
            The path; None if there is none yet.
        """
        cdef bint met = False
        self._begin(trees, reach)
        try:
            self.rng, self.stop, self.enough_nodes, self.take_goals = rng, stop, enough_nodes, take_goals
            self.random = <bitgen_t *> PyCapsule_GetPointer(rng.bit_generator.capsule, "BitGenerator")
            self.ignored, self.steps, self.enough = ignored, 0, enough_nodes()
            with nogil:
                met = self._safe_rrt_connect(iterations)
        except TimeIsUpError:
            pass
        finally:
            self._end()
        # The trees have met where the last node of each is.
        return trees.path(trees.start, len(trees.start) - 1, trees.goal, len(trees.goal) - 1) if met else None

    def extend(self, trees, Tree tree not None, Py_ssize_t old, target, double reach):
        """EXTEND: add a node at most `reach` [rad] from node `old` towards `target: (n,)`; return outcome and node."""
        cdef const double[::1] place = plain(target)
        cdef int outcome
        if not 0 <= old < tree.data.count or place.shape[0] != self.space.n or tree not in (trees.start, trees.goal):
            raise InputError(f"there is no node {old} in these trees, or the target has {place.shape[0]} joints")
        self._begin(trees, reach)
        try:
            self.steps = 1
            with nogil:
                outcome = self._extend(&tree.data, old, &place[0])
        finally:
            self._end()
        return Extension(outcome), old if outcome == TRAPPED else tree.data.count - 1

    def settled(self, rows, double reach, stop, double clearance, Py_ssize_t rounds):
        """Return a path as an elastic band (Quinlan 1994): contracted where that is as safe, and bent away from danger.

        It is contracted between its way points, and in further rounds between these and the middles of its motions,
        too. Then the middle of motions longer than twice `reach` moves along the part of the danger's negative gradient
        that is orthogonal to the motion, where both halves are free; so do the middles of the halves. Every new motion
        is proven.

        Parameters
        ----------
        rows : ndarray, shape (N, n)
            The path; its motions are free.
        reach : float
            In which the motion sideways is measured [rad].
        stop : callable
            Says that time is up; then what is left of the path stays as it is.
        clearance : float
            What new motions keep from obstacles [m].
        rounds : int
            How often it is contracted.
        """
        cdef Py_ssize_t k
        path = np.ascontiguousarray(rows, dtype=np.float64)
        self._begin(None, reach)
        try:
            path = self._contracted(path, stop, clearance)
            for _ in range(1, rounds):
                shorter = self._contracted(self._halved(path), stop, clearance)
                # Where few middles can be left out again the band is as tight as it may be.
                if 2 * len(shorter) > 3 * len(path):
                    break
                path = shorter
            band = [path[0]]
            for k in range(1, len(path)):
                if not stop():
                    self._bend(band, path[k], clearance)
                band.append(path[k])
        finally:
            self._end()
        return np.array(band)

    cdef _contracted(self, path, stop, double clearance):
        """Return those way points of a path (N, n) that are left where straight motions are as safe, and free."""
        cdef Py_ssize_t at = 0
        kept = [0]
        while at < len(path) - 1:
            at = at + 1 if stop() else self._farthest(path, at, clearance)
            kept.append(at)
        return path[kept]

    cdef _halved(self, const double[:, ::1] path):
        """Return a path (N, n) with the middles of its motions."""
        cdef double length
        cdef Py_ssize_t k
        middles = np.empty((path.shape[0] - 1, self.space.n))
        cdef double[:, ::1] middle = middles
        for k in range(path.shape[0] - 1):
            length = motion_between(self.space, &path[k, 0], &path[k + 1, 0], &self.moved[0])
            steer(self.space, &path[k, 0], &path[k + 1, 0], 0.5 * length, &middle[k, 0], &self.moved[0])
        return np.insert(np.asarray(path), np.arange(1, path.shape[0]), middles, axis=0)

    cdef Py_ssize_t _farthest(self, const double[:, ::1] path, Py_ssize_t at, double clearance) except -1:
        """Return the way point to which a straight motion from way point `at`, as safe and free, leads the farthest."""
        cdef Py_ssize_t end = path.shape[0] - 1
        while end > at + 1:
            if self._is_proven(&path[at, 0], &path[end, 0], clearance) and self._is_as_safe(path[at : end + 1]):
                return end
            end = (at + end) // 2
        return at + 1

    cdef bint _is_as_safe(self, const double[:, ::1] path) except -1:
        """Return whether the straight motion between the ends of a path (N, n) adds neither danger nor a higher peak.

        The danger of motions is its integral along them.
        """
        cdef Py_ssize_t last = path.shape[0] - 1, k, row
        cdef double total = 0.0, before = 0.0, step, along, peak = -INFINITY, most = -INFINITY, change = 0.0
        cdef double *direction = &self.downhill[0]
        if not self.alpha * self.scale > 0.0:
            return True
        lengths, places = np.empty(last), np.empty((2 * SAMPLES, self.space.n))
        cdef double[::1] length = lengths
        cdef double[:, ::1] place = places
        for k in range(last):
            length[k] = motion_between(self.space, &path[k, 0], &path[k + 1, 0], direction)
            total += length[k]
        step, k = motion_between(self.space, &path[0, 0], &path[last, 0], direction), 0
        for row in range(SAMPLES):
            along = (row + 0.5) / SAMPLES
            while k < last - 1 and along * total - before > length[k]:
                before += length[k]
                k += 1
            steer(self.space, &path[k, 0], &path[k + 1, 0], along * total - before, &place[row, 0], direction)
            steer(self.space, &path[0, 0], &path[last, 0], along * step, &place[SAMPLES + row, 0], direction)
        cdef const double[::1] danger = self._dangers(places)
        for row in range(SAMPLES):
            most, peak = max(most, danger[row]), max(peak, danger[SAMPLES + row])
            change += step * danger[SAMPLES + row] - total * danger[row]
        return peak <= most and change <= 0.0

    cdef _dangers(self, double[:, ::1] places):
        """Return the danger (B,) at `places: (B, n)`."""
        if not self.prices:
            return self.problem.cost.values(np.asarray(places))
        found = np.empty(places.shape[0])
        cdef double[::1] out = found
        self.evaluations += places.shape[0]
        self.own_danger.write(&places[0, 0], places.shape[0], NULL, &out[0])
        return found

    cdef int _bend(self, list band, end, double clearance) except -1:
        """Append way points between the last one of a band and an end (n,): the middle, moved, and those of halves."""
        cdef const double[::1] start = band[len(band) - 1], target = end
        cdef double length = motion_between(self.space, &start[0], &target[0], &self.moved[0])
        cdef Py_ssize_t i
        if not (self.alpha * self.scale > 0.0 and self.share > 0.0 and length > 2.0 * self.reach):
            return 0
        steer(self.space, &start[0], &target[0], 0.5 * length, &self.straight[0], &self.moved[0])
        if self.prices:
            self._danger(&self.straight[0], &self.gradient[0])
        else:
            self._ask_for_cost(&self.straight[0])
        for i in range(self.space.n):
            self.downhill[i] = self.gradient[i] / self.slope
        if not descend(self.space, &self.straight[0], &self.moved[0], &self.downhill[0], self.share * self.reach):
            return 0
        middle = np.array(self.moved)
        cdef const double[::1] moved = middle
        if self._is_proven(&start[0], &moved[0], clearance) and self._is_proven(&moved[0], &target[0], clearance):
            self._bend(band, middle, clearance)
            band.append(middle)
            self._bend(band, end, clearance)
        return 0

    cdef bint _safe_rrt_connect(self, Py_ssize_t iterations) except -1 nogil:
        """SAFE_RRT-CONNECT: return whether the trees have met, where the last node of each is."""
        cdef Nodes *tree = &self.start.data
        cdef Nodes *other = &self.goal.data
        cdef double *q_rand = &self.q_rand[0]
        cdef const double *q_new
        cdef Py_ssize_t k = 0, old, near
        cdef int outcome
        while iterations == 0 or k < iterations:
            k += 1
            self._offer_goals()
            self._weigh_danger()
            self._random_config(q_rand)
            old = self._best(tree, q_rand)
            outcome = self._extend(tree, old, q_rand)
            if outcome == TRAPPED and self._may_step_shorter(tree, old):
                self._bring_nearer(q_rand, tree.rows + tree.n * old)
                outcome = self._extend(tree, old, q_rand)
            if outcome != TRAPPED:
                q_new = tree.rows + tree.n * (tree.count - 1)
                near = self._best(other, q_new)
                if self._connect(other, near, q_new) == REACHED:
                    return True
            if self._is_the_others_turn(tree, other):
                tree, other = other, tree  # SWAP
        return False

    cdef int _connect(self, Nodes *tree, Py_ssize_t old, const double *target) except -1 nogil:
        """CONNECT: step from node `old` towards a target (n,) until it is reached or a step is trapped."""
        cdef int outcome = self._extend(tree, old, target)
        while outcome == ADVANCED:
            outcome = self._extend(tree, tree.count - 1, target)
        return outcome

    cdef int _extend(self, Nodes *tree, Py_ssize_t old, const double *target) except -1 nogil:
        """EXTEND: add a node at most `reach` from node `old` towards a target (n,).

        On its way a node descends from danger sideways, and keeps to the threshold. Targets within a step are neither
        moved nor held to it: they are configurations that the path needs. Where the motion to the moved place is not
        free, the straight one is tried.
        """
        cdef double *straight = &self.straight[0]
        cdef double *moved = &self.moved[0]
        cdef const double *q_new = straight
        cdef double length, most = INFINITY
        cdef bint is_on_the_way, descends = False, has_threshold = False
        cdef int verdict = BLOCKED
        if self.steps == 0:
            self._look_at_the_clock()
        self.steps -= 1
        length = steer(self.space, tree.rows + tree.n * old, target, self.reach, straight, moved)
        is_on_the_way = length > self.reach
        if is_on_the_way and self.alpha * self.scale > 0.0:
            # The way sideways shrinks as the target comes near, so that every step comes nearer to it.
            descends = self._descend(tree, old, self.share * min(self.reach, length - self.reach))
            has_threshold = self.rise > 0.0
            if has_threshold:
                most = self._most_danger(tree, old)
        if descends:
            q_new = moved
            verdict = self._verdict(tree, old, moved, is_on_the_way, has_threshold, most)
        if verdict == BLOCKED:
            q_new = straight
            verdict = self._verdict(tree, old, straight, is_on_the_way, has_threshold, most)
        if verdict != ALLOWED:
            return TRAPPED
        self._add(tree, old, q_new, has_threshold)
        return ADVANCED if is_on_the_way else REACHED

    # ------------------------------------------------------------------------------------------- what a turn does

    cdef double _draw(self) noexcept nogil:
        """Return a random number in [0, 1)."""
        return self.random.next_double(self.random.state)

    cdef void _weigh_danger(self) noexcept nogil:
        """Draw whether danger has a weight in this turn, or the decay has taken it."""
        if self.half_life > 0.0 and (self.has_danger or self.clearance > 0.0):
            self.scale = 1.0 if self._draw() < danger_share(self.turns, self.half_life) else 0.0
            self.turns += 1

    cdef void _random_config(self, double *q) noexcept nogil:
        """RANDOM_CONFIG: write a random configuration (n,)."""
        cdef Py_ssize_t i
        for i in range(self.space.n):
            q[i] = self.space.lower[i] + (self.space.upper[i] - self.space.lower[i]) * self._draw()
        for i in range(self.space.turns):
            _make_rotation(q + self.space.rotations[i])

    cdef Py_ssize_t _best(self, Nodes *tree, const double *q) except -1 nogil:
        """Return argmin of ρ(node, q) + α·CDF(node); in a share of the choices, by chance, danger has no weight."""
        cdef bint ignores_danger = self.ignored > 0.0 and self._draw() < self.ignored
        cdef double alpha = 0.0 if ignores_danger else self.alpha * self.scale
        if alpha != 0.0:
            self._price(tree)
        return _nearest(tree, q, alpha)

    cdef bint _may_step_shorter(self, Nodes *tree, Py_ssize_t old) noexcept nogil:
        """Return whether a shorter step may be tried from a node where one was trapped.

        It may lead out of a narrow place; elsewhere it would double the checks and make for paths that graze obstacles.
        So while danger has weight, or there is a margin, only nodes whose last step was trapped, too, get one.
        """
        cdef bint narrow = tree.narrow[old]
        tree.narrow[old] = True
        return narrow or not (self.scale > 0.0 and (self.alpha > 0.0 or self.clearance > 0.0))

    cdef void _bring_nearer(self, double *target, const double *q) noexcept nogil:
        """Bring a target (n,) log-uniformly nearer to q than a whole step."""
        cdef double *motion = &self.moved[0]
        cdef double length = motion_between(self.space, q, target, motion), share
        cdef Py_ssize_t i, first
        share = pow(SHORTEST, self._draw()) * min(length, self.reach) / length if length > 0.0 else 0.0
        for i in range(self.space.n):
            if length > 0.0:
                target[i] = q[i] + share * motion[i]
            target[i] = bounded(target[i], self.space.lower[i], self.space.upper[i], self.space.continuous[i])
        for i in range(self.space.turns):
            first = self.space.rotations[i]
            rotate(q + first, motion + first, share, target + first)

    cdef bint _is_the_others_turn(self, const Nodes *tree, const Nodes *other) noexcept nogil:
        """Return whether the other tree has the next turn.

        The larger one leaves some of its turns to the smaller one, which may be enclosed; more nodes let in more goals.
        """
        if other.count > max(LARGE, tree.count) and self.in_a_row < IN_A_ROW:
            self.in_a_row += 1
            return False
        self.in_a_row = 1
        return True

    # ------------------------------------------------------------------------------------------- what a step does

    cdef bint _descend(self, Nodes *tree, Py_ssize_t old, double most) except -1 nogil:
        """Move the place of a new node sideways, down the danger; return whether the place moves.

        The direction is the part of the danger's negative gradient at the old node that is orthogonal to the step. The
        length is at most `most`. The step in `moved` is overwritten by the new place.
        """
        cdef Py_ssize_t i, n = tree.n
        if not most > 0.0:
            return False
        if not tree.sloped[old]:
            self._measure_slope(tree, old)
        for i in range(n):
            self.downhill[i] = tree.gradients[n * old + i] / self.slope
        return descend(self.space, &self.straight[0], &self.moved[0], &self.downhill[0], most)

    cdef double _most_danger(self, Nodes *tree, Py_ssize_t old) except? -1.0 nogil:
        """Return how dangerous a node after an old one may be: as this, or up to the threshold.

        That is at first the danger of the more dangerous end, which no path can avoid.
        """
        cdef double first, last, cost
        self._price(tree)
        if self.threshold == 0.0:
            self._price(&self.start.data)
            self._price(&self.goal.data)
            first, last = _least_root_cost(&self.start.data), _least_root_cost(&self.goal.data)
            self.threshold = last if last > first else first
        cost = tree.costs[old]
        return cost if cost > self.threshold else self.threshold

    cdef int _verdict(
        self, Nodes *tree, Py_ssize_t old, const double *q_new, bint is_on_the_way, bint has_threshold, double most
    ) except -1 nogil:
        """Return whether a new node is ALLOWED, BLOCKED by obstacles or, if there is a threshold, too DANGEROUS.

        A proof costs as much as a danger. The danger comes first, because a motion that is refused for obstacles lowers
        the margin; but where danger refuses few steps, computing it first would be wasted.
        """
        cdef bint proof_first = self.blocked > RARE * self.dangerous
        if proof_first and not self._is_free(tree, old, q_new, is_on_the_way):
            return BLOCKED
        if has_threshold and not self._is_harmless(q_new, most):
            return DANGEROUS
        if not proof_first and not self._is_free(tree, old, q_new, is_on_the_way):
            return BLOCKED
        return ALLOWED

    cdef bint _is_free(self, Nodes *tree, Py_ssize_t old, const double *q_new, bint is_on_the_way) except -1 nogil:
        """Return whether the motion between two nodes is free, and keeps the margin; else lower that at times."""
        cdef const double *q_old = tree.rows + tree.n * old
        cdef const double *start = q_old if tree.from_start else q_new
        cdef const double *end = q_new if tree.from_start else q_old
        if self._is_proven(start, end, self.clearance if self.scale > 0.0 else 0.0):
            return True
        if self.clearance > 0.0 and self.scale > 0.0:
            self.too_near += 1
            if self.too_near % self.patience == 0:
                self.clearance = lowered_margin(self.clearance, self.least_clearance)
        self.blocked += is_on_the_way
        return False

    cdef bint _is_proven(self, const double *start, const double *end, double clearance) except -1 nogil:
        """Return whether a motion, as it is driven, is proven to be free and to keep a margin [m]."""
        cdef Outcome found
        if self.proves:
            self._require(clearance)
            found = prove_edge(
                &self.bounds.pairs, self.work, start, end, self.limits, &self.required[0], self.most, self.floor
            )
            self.places += found.places
            if found.number <= 0:
                return found.number == 0
        return self._ask_for_motion(start, end, clearance)

    cdef void _require(self, double clearance) noexcept nogil:
        """Require a margin [m] of the pairs that meet obstacles."""
        cdef Py_ssize_t p
        cdef double least
        if self.kept == clearance:
            return
        self.most = -INFINITY
        for p in range(self.least.shape[0]):
            least = self.least[p]
            self.required[p] = (max(least, clearance) if self.meets[p] else least) + _ALLOWANCE
            self.most = max(self.most, self.required[p])
        self.kept = clearance

    cdef bint _is_harmless(self, const double *q_new, double most) except -1 nogil:
        """Return whether a new node is no more dangerous than that; else raise the threshold at times."""
        if self.prices:
            self.cost = self._danger(q_new, &self.gradient[0] if self.share > 0.0 else NULL)
        else:
            self._ask_for_cost(q_new)
        if self.cost <= most:
            return True
        self.dangerous += 1
        self.refused += 1
        if self.refused % REFUSED == 0:
            self.threshold *= 1.0 + self.rise
        return False

    cdef int _add(self, Nodes *tree, Py_ssize_t old, const double *q_new, bint has_cost) except -1 nogil:
        """Add a node that a step leads to."""
        cdef Py_ssize_t node = tree.count, n = tree.n
        cdef bint sloped = has_cost and self.share > 0.0
        if tree.count == tree.room:
            self._make_room(tree)
        memcpy(tree.rows + n * node, q_new, n * sizeof(double))
        if sloped:
            memcpy(tree.gradients + n * node, &self.gradient[0], n * sizeof(double))
        tree.parents[node], tree.costs[node] = old, self.cost if has_cost else NAN
        tree.narrow[node], tree.sloped[node], tree.narrow[old] = False, sloped, False
        tree.count = node + 1
        self.nodes += 1
        return 0

    # ------------------------------------------------------------------------------------- the danger of configurations

    cdef double _danger(self, const double *q, double *gradient) except? -1.0 nogil:
        """Return the danger of a configuration (n,), and write its gradient (n,) unless that is NULL."""
        cdef double danger
        self.evaluations += 1
        self.own_danger.write(q, 1, gradient, &danger)
        return danger

    cdef int _price(self, Nodes *tree) except -1 nogil:
        """Compute the costs of nodes that are not known yet, and where steps descend gradients, too.

        A gradient costs little more with its danger, and as much as both later.
        """
        cdef Py_ssize_t node
        if tree.priced == tree.count:
            return 0
        for node in range(tree.priced, tree.count):
            if tree.costs[node] != tree.costs[node]:
                if not self.prices:
                    return self._ask_for_costs(tree)
                tree.costs[node] = self._danger(
                    tree.rows + tree.n * node, tree.gradients + tree.n * node if self.share > 0.0 else NULL
                )
                tree.sloped[node] = self.share > 0.0
        tree.priced = tree.count
        return 0

    cdef int _measure_slope(self, Nodes *tree, Py_ssize_t node) except -1 nogil:
        """Compute the gradient of the danger at a node."""
        cdef double cost
        if not self.prices:
            return self._ask_for_gradient(tree, node)
        cost = self._danger(tree.rows + tree.n * node, tree.gradients + tree.n * node)
        if tree.costs[node] != tree.costs[node]:
            tree.costs[node] = cost
        tree.sloped[node] = True
        return 0

    # --------------------------------------------------------------------- what Python is asked, and what it is told

    cdef int _look_at_the_clock(self) except -1 nogil:
        """Raise KeyboardInterrupt at Ctrl-C, and end the loop when time is up; see what other threads have changed."""
        with gil:
            PyErr_CheckSignals()
            if self.stop():
                raise TimeIsUpError
            self._prepare()
            self.enough = self.enough_nodes()
        self.steps = STEPS
        return 0

    cdef int _offer_goals(self) except -1 nogil:
        """Take goals if there are enough nodes for more."""
        if self.nodes > self.enough:
            with gil:
                self.trees.counts.nodes = self.nodes
                self.take_goals()
                self.enough = self.enough_nodes()
            self.steps = 0
        return 0

    cdef bint _ask_for_motion(self, const double *start, const double *end, double clearance) except -1 nogil:
        """Ask the problem whether a motion is free."""
        cdef bint is_free
        with gil:
            is_free = self.problem.motion_is_free(self._array(start), self._array(end), clearance)
        self.steps = 0
        return is_free

    cdef int _ask_for_cost(self, const double *q) except -1 nogil:
        """Ask the objective what a configuration costs, and for the gradient there."""
        with gil:
            cost = self.problem.cost
            if self.share > 0.0:
                value, gradient = cost.value_and_gradient(self._array(q))
                self.cost, np.asarray(self.gradient)[:] = value, gradient
            else:
                self.cost = cost.values(self._array(q)[None])[0]
        self.steps = 0
        return 0

    cdef int _ask_for_costs(self, Nodes *tree) except -1 nogil:
        """Ask the objective what all nodes cost."""
        with gil:
            _ = self._owner(tree).costs
        self.steps = 0
        return 0

    cdef int _ask_for_gradient(self, Nodes *tree, Py_ssize_t node) except -1 nogil:
        """Ask the objective for the gradient at a node."""
        with gil:
            self._owner(tree).gradient(node)
        self.steps = 0
        return 0

    cdef int _make_room(self, Nodes *tree) except -1 nogil:
        with gil:
            self._owner(tree).make_room()
        return 0

    cdef Tree _owner(self, const Nodes *tree):
        return self.start if tree == &self.start.data else self.goal

    cdef object _array(self, const double *q):
        """Return a configuration (n,) as an array of its own."""
        return np.array(<double[:self.space.n]> <double *> q)

    cdef int _begin(self, trees, double reach) except -1:
        """Take what the parts know; only one can grow trees at a time."""
        if self.busy:
            raise PlanningError("a planner that is planning was asked to plan: make one for each thread")
        self.busy, self.trees = True, trees
        try:
            return self._take_parts(trees, reach)
        except BaseException:
            self.busy, self.trees = False, None
            raise

    cdef int _take_parts(self, trees, double reach) except -1:
        danger, margin, decay = self.danger, self.margin, self.decay
        self.reach = reach
        if trees is not None:
            self.start, self.goal, self.nodes = trees.start, trees.goal, trees.counts.nodes
            if self.start.data.n != self.space.n or self.goal.data.n != self.space.n:
                raise InputError(f"trees must be of {self.space.n} joints")
        self.alpha, self.scale = danger.whole_weight, danger.scale
        self.slope = danger.slope if self.alpha else 0.0
        self.share = self.slide if danger.cost.has_gradients else 0.0
        self.clearance, self.least_clearance = margin.wanted, margin.least
        self.too_near, self.patience = margin.refusals, margin.patience
        self.half_life, self.turns = (0.0, 0) if decay is None else (decay.half_life, decay.turns)
        self.has_danger = danger.alpha > 0.0 and not danger.cost.is_zero
        return self._prepare()

    cdef int _end(self) except -1:
        """Tell the parts what has become of it."""
        margin = self.margin
        self._count()
        self.danger.scale = self.scale
        if self.trees is not None:
            self.trees.counts.nodes = self.nodes
        if margin.wanted:
            margin.level, margin.refusals = self.clearance, self.too_near
        if self.decay is not None:
            self.decay.turns = self.turns
        # Of OMPL's objects some that are kept beyond a call are never freed.
        self.busy = False
        self.trees = self.start = self.goal = self.rng = self.stop = self.enough_nodes = self.take_goals = None
        return 0

    cdef int _prepare(self) except -1:
        """Take obstacles and danger points as they are now: other threads may move them."""
        self._count()
        motion, field = self.problem.motion_prover, self.problem.cost.field
        self.proves = motion is not None and self._take_tables(motion)
        self.prices = field is not None and self._take_field(field.frozen())
        return 0

    cdef bint _take_tables(self, motion) except -1:
        """Take what proofs need; return whether they suffice, and no other thread is moving obstacles."""
        required, changes = motion.required, motion.checker.changes
        done = changes.done
        bounds = required.pairs.bounds
        if self.required_by is not required or self.known_bounds is not bounds:
            self.required_by, self.known_bounds, self.work = None, bounds, None
            self.bounds = bounds
            self.limits = self.problem.limits_of(motion).table
            self.least, self.meets = required.least.copy(), required.pairs.meets_obstacle.view(np.uint8).copy()
            self.required, self.kept, self.floor = np.empty(len(self.least)), -1.0, motion.floor
            pairs, joints = self.bounds.pairs.count, self.bounds.pairs.m
            if (len(self.least), len(self.meets), self.limits.m, self.limits.n) != (pairs, pairs, joints, self.space.n):
                raise InputError(
                    f"proofs must be of {pairs} pairs, {joints} joints of the model and {self.space.n} planned"
                )
            self.work, self.counts, self.required_by = self.bounds.workspace(), motion.checker.counts, required
        return not motion.limits and self.bounds.bounded and changes.begun == done

    cdef bint _take_field(self, field) except -1:
        """Take the danger at points that stay where they are; return whether there are points, of all joints."""
        if self.field is not field:
            self.own_danger, self.field = None, field
            if len(field.points) and field.robot.coupling.trivial:
                self.own_danger = field.point_danger()
                if self.own_danger.skeleton.data.m != self.space.n:
                    raise InputError(f"danger must be that of {self.space.n} joints")
        return self.own_danger is not None

    cdef int _count(self) except -1:
        """Count what proofs and danger took."""
        if self.places:
            self.counts.bound_queries += self.places
        if self.evaluations:
            self.field.count(self.evaluations, len(self.own_danger.points))
        self.places = self.evaluations = 0
        return 0


cdef void _make_rotation(double *q) noexcept nogil:
    """Turn uniform random numbers (4,) in [−1, 1) into a uniform random unit quaternion (Shoemake 1992)."""
    cdef double share = 0.5 * (q[0] + 1.0), first = M_PI * (q[1] + 1.0), second = M_PI * (q[2] + 1.0)
    q[0], q[1] = sqrt(1.0 - share) * sin(first), sqrt(1.0 - share) * cos(first)
    q[2], q[3] = sqrt(share) * sin(second), sqrt(share) * cos(second)


cdef double _least_root_cost(const Nodes *tree) noexcept nogil:
    """Return the cost of the cheapest root; NaN if one is, −∞ if there is none."""
    cdef double least = INFINITY
    cdef Py_ssize_t roots = 0, node
    for node in range(tree.count):
        if tree.parents[node] == _ROOT:
            roots += 1
            if not tree.costs[node] >= least:
                least = tree.costs[node]
            if least != least:
                break
    return least if roots > 0 else -INFINITY


# ------------------------------------------------------------------------------------------------------------ trees


cdef class Tree:
    """Configurations as rows of one array, each with the number of its parent; edges are driven from or to the start.

    Costs are evaluated when they are first asked for, all new nodes in one batch.

    Parameters
    ----------
    bridge : StateBridge
        The bounds of configurations, and which coordinates wrap.
    cost : StateCost
        What configurations cost.
    from_start : bool
        Whether the tree grows from the start.
    """

    cdef Nodes data
    cdef object _cost, _rows, _parents, _costs, _gradients, _narrow, _sloped, _wraps, _rotations

    def __cinit__(self, bridge, cost, *, bint from_start=True):
        cdef Py_ssize_t n = bridge.n
        self._cost, self._wraps = cost, np.array(bridge.circular, dtype=np.uint8)
        self._rotations = np.array(bridge.rotations, dtype=np.intp)
        if any(not 0 <= first <= n - 4 for first in self._rotations):
            raise InputError(f"quaternions must be four of {n} coordinates each")
        self.data.n, self.data.from_start = n, from_start
        if not n or self._wraps.shape != (n,):
            raise InputError("configurations must have a coordinate at least, and each must wrap or not")
        self._rows, self._gradients = np.empty((2, 0, n))
        self._parents, self._costs = np.empty(0, np.intp), np.empty(0)
        self._narrow, self._sloped = np.empty((2, 0), np.uint8)
        self.make_room()

    def __dealloc__(self):
        _forget(&self.data.boxes)

    def __len__(self):
        return self.data.count

    @property
    def from_start(self):
        """Whether the tree grows from the start."""
        return self.data.from_start

    @property
    def configurations(self):
        """The nodes (N, n)."""
        return self._rows[: self.data.count]

    @property
    def parents(self):
        """For each node the number of its parent (N,); -1 for roots."""
        return self._parents[: self.data.count]

    @property
    def roots(self):
        """The nodes (R, n) that have no parent."""
        return self.configurations[self.parents == ROOT]

    @property
    def costs(self):
        """The cost of each node (N,)."""
        cdef Py_ssize_t priced = self.data.priced
        costs = self._costs[: self.data.count]
        if priced < self.data.count:
            new = priced + np.flatnonzero(np.isnan(costs[priced:]))
            if len(new):
                costs[new] = self._cost.values(self._rows[new])
            self.data.priced = len(costs)
        return costs

    def gradient(self, Py_ssize_t node):
        """Return the gradient (n,) of the cost at a node; only for costs with gradients."""
        self._check(node)
        if not self.data.sloped[node]:
            value, self._gradients[node] = self._cost.value_and_gradient(self._rows[node])
            self.data.sloped[node] = True
            if self.data.costs[node] != self.data.costs[node]:
                self.data.costs[node] = value
        return self._gradients[node]

    def add(self, q, Py_ssize_t parent=_ROOT):
        """Append the configuration `q: (n,)` and return its number."""
        cdef Py_ssize_t node = self.data.count
        if parent != _ROOT:
            self._check(parent)
        if node == self.data.room:
            self.make_room()
        self._rows[node] = q
        self.data.parents[node], self.data.costs[node] = parent, NAN
        self.data.narrow[node] = self.data.sloped[node] = False
        if parent != _ROOT:
            self.data.narrow[parent] = False
        self.data.count = node + 1
        return node

    def make_room(self):
        """Make room for as many nodes again. Arrays that were handed out stay as they are."""
        cdef Py_ssize_t room = max(2 * self.data.room, ROOM)
        cdef double[:, ::1] rows
        cdef double[:, ::1] gradients
        cdef double[::1] costs
        cdef Py_ssize_t[::1] parents
        cdef unsigned char[::1] narrow, sloped
        cdef const unsigned char[::1] wraps = self._wraps
        cdef const Py_ssize_t[::1] rotations = self._rotations
        rows = self._rows = _longer(self._rows, room)
        gradients = self._gradients = _longer(self._gradients, room)
        parents, costs = self._parents, self._costs = _longer(self._parents, room), _longer(self._costs, room)
        narrow, sloped = self._narrow, self._sloped = _longer(self._narrow, room), _longer(self._sloped, room)
        self.data.rows, self.data.parents, self.data.costs = &rows[0, 0], &parents[0], &costs[0]
        self.data.gradients, self.data.narrow, self.data.sloped = &gradients[0, 0], &narrow[0], &sloped[0]
        self.data.wraps, self.data.room = &wraps[0], room
        self.data.turns = rotations.shape[0]
        self.data.rotations = &rotations[0] if self.data.turns else NULL

    def add_root(self, q):
        """Add a start or goal configuration (n,)."""
        self.add(q)

    def nodes(self):
        """Return configurations and parents."""
        return self.configurations, self.parents

    def best(self, q, double alpha):
        """Return argmin of ρ(node, q) + α·cost(node), of equal ones the first; the nearest node for α = 0."""
        cdef const double[::1] place = plain(q)
        if place.shape[0] != self.data.n:
            raise InputError(f"a configuration must have {self.data.n} joints, got {place.shape[0]}")
        if alpha:
            _ = self.costs
        return _nearest(&self.data, &place[0], alpha)

    def as_driven(self, near, far):
        """Return the ends of an edge, `near` the root and `far` from it, in the order in which a path drives them."""
        return (near, far) if self.data.from_start else (far, near)

    def branch(self, Py_ssize_t node):
        """Return the configurations (k, n) from the root to a node."""
        self._check(node)
        return self.configurations[branch(self.parents, node)]

    cdef int _check(self, Py_ssize_t node) except -1:
        if not 0 <= node < self.data.count:
            raise InputError(f"there is no node {node}: the tree has {self.data.count}")
        return 0


def _longer(array, room):
    """Return an array with so many rows, the first of which are those of another one."""
    longer = np.empty((room, *array.shape[1:]), array.dtype)
    longer[: len(array)] = array
    return longer


def branch(parents, node):
    """Return the nodes from the root to `node`, where `parents: (N,)` are the numbers of the nodes' parents."""
    nodes = []
    while node != ROOT:
        if len(nodes) == len(parents):
            raise InputError(f"node {node} is its own ancestor")
        nodes.append(node)
        node = int(parents[node])
    return nodes[::-1]


# ----------------------------------------------------------------------------------------------- the nearest of nodes
#
# Few nodes are scanned. Many are divided among leaves by a k-d tree: a full leaf in the middle of the longest side of
# its box. Every cell knows the box of its nodes and their least cost, so that a search leaves out cells that can hold
# no better node. In a large tree a search mostly waits for memory. So the boxes of up to 16 cells stand together in a
# group, as the nodes of a leaf do, coordinate by coordinate, for processors to compute by lanes; and single precision
# bounds what is computed exactly where it counts. Groups are to cells what the nodes of a B-tree are to keys.


cdef Py_ssize_t _nearest(Nodes *tree, const double *q, double alpha) except -1 nogil:
    """Return argmin ρ(node, q) + α·cost(node), of equal ones the first; 0 where there are none.

    The distance ρ is Euclidean, coordinates that wrap going the short way round, and quaternions along the arc. Where α
    is not 0 all costs are known. No box bounds an arc, so that in spaces of rotations all nodes are scanned.
    """
    cdef BoxTree *boxes = &tree.boxes
    cdef Waiting *waiting
    cdef double least = INFINITY, score, bound
    cdef double lanes[SIZE]
    cdef Py_ssize_t best = 0, node, size = 1, at, first, below, lane, filled
    if tree.count <= FEW or tree.turns > 0:
        for node in range(tree.count):
            score = _score(tree, node, q, alpha)
            if score < least:
                best, least = node, score
        return best
    for node in range(boxes.count, tree.count):
        _make_room_for_one(tree)
        _insert(tree, node)
    if alpha != 0.0:
        _take_costs(tree)
    # All groups above a leaf may wait with all of their cells.
    if SIZE * (boxes.depth + 1) > boxes.waiting_room:
        boxes.waiting = <Waiting *> _wider(boxes.waiting, 2 * SIZE * (boxes.depth + 1) * sizeof(Waiting))
        boxes.waiting_room = 2 * SIZE * (boxes.depth + 1)
    waiting = boxes.waiting
    waiting[0] = Waiting(boxes.root, -INFINITY)
    while size > 0:
        size -= 1
        below, bound, first = waiting[size].below, waiting[size].bound, size
        if bound > least:
            continue
        if below >= 0:
            filled = boxes.groups[below].size
            _write_bounds(tree, _boxes_of(tree, below), tree.n, 0.0, q, alpha, (filled + 3) // 4 * 4, lanes)
        else:
            filled = boxes.leaves[-1 - below].size
            _write_bounds(tree, _places_of(tree, -1 - below), 0, SINGLE, q, alpha, (filled + 3) // 4 * 4, lanes)
        for lane in range(filled):
            bound = lanes[lane]
            if not (bound <= least and bound < INFINITY):
                continue
            if below < 0:
                node = boxes.leaves[-1 - below].nodes[lane]
                score = _score(tree, node, q, alpha)
                if score < least or (score == least and node < best):
                    best, least = node, score
                continue
            at, size = size, size + 1
            # What has the least bound is looked at first.
            while at > first and waiting[at - 1].bound < bound:
                waiting[at] = waiting[at - 1]
                at -= 1
            waiting[at] = Waiting(boxes.groups[below].below[lane], bound)
    return best


cdef double _score(const Nodes *tree, Py_ssize_t node, const double *q, double alpha) noexcept nogil:
    """Return ρ from a node to q + α·cost."""
    cdef const double *row = tree.rows + tree.n * node
    cdef double total = 0.0, delta
    cdef double motion[4]
    cdef Py_ssize_t i = 0, k = 0
    while i < tree.n:
        if k < tree.turns and i == tree.rotations[k]:
            rotation_between(row + i, q + i, motion)
            total += motion[0] * motion[0] + motion[1] * motion[1] + motion[2] * motion[2] + motion[3] * motion[3]
            i, k = i + 4, k + 1
        else:
            delta = difference(row[i], q[i], tree.wraps[i])
            total += delta * delta
            i += 1
    return sqrt(total) + alpha * tree.costs[node] if alpha != 0.0 else sqrt(total)


cdef void _write_bounds(
    const Nodes *tree, const float *inner, Py_ssize_t far, double ulp, const double *q, double alpha, Py_ssize_t lanes,
    double *out
) noexcept nogil:
    """Write lower bounds (SIZE,) of ρ + α·cost of what is in some boxes.

    The greatest coordinates are `far` rows after the least ones: n of the boxes of a group; none of the nodes of a
    leaf, which are rounded by a relative `ulp` at most. What is written in lanes that are not filled means nothing.
    """
    cdef Py_ssize_t i, lane
    cdef const float *lows
    cdef const float *highs
    cdef double at, low, high, under, over, gap
    for lane in range(lanes):
        out[lane] = 0.0
    for i in range(tree.n):
        at, lows, highs = q[i], inner + SIZE * i, inner + SIZE * (far + i)
        if tree.wraps[i]:
            for lane in range(lanes):
                low, high = lows[lane], highs[lane]
                high += ulp * fabs(high)
                gap = fabs(difference(0.5 * (low + high), at, True)) - 0.5 * (high - low) - ROUNDING
                gap = gap if gap > 0.0 else 0.0
                out[lane] += gap * gap
        else:
            for lane in range(lanes):
                low, high = lows[lane], highs[lane]
                under, over = low - at, at - (high + ulp * fabs(high))
                gap = under if under > over else over
                gap = gap if gap > 0.0 else 0.0
                out[lane] += gap * gap
    for lane in range(lanes):
        out[lane] = sqrt(out[lane])
    if alpha != 0.0:
        lows = inner + SIZE * (far + tree.n)
        for lane in range(lanes):
            out[lane] += alpha * lows[lane]


cdef float *_boxes_of(const Nodes *tree, Py_ssize_t group) noexcept nogil:
    """Return the boxes (2n + 1, SIZE) of the cells of a group."""
    return tree.boxes.boxes + SIZE * (2 * tree.n + 1) * group


cdef float *_places_of(const Nodes *tree, Py_ssize_t leaf) noexcept nogil:
    """Return the coordinates and costs (n + 1, SIZE) of the nodes of a leaf."""
    return tree.boxes.places + SIZE * (tree.n + 1) * leaf


cdef void _insert(Nodes *tree, Py_ssize_t node) noexcept nogil:
    """Put a node into its leaf, which is divided where it is full; neither half is full."""
    cdef BoxTree *boxes = &tree.boxes
    cdef Py_ssize_t cell = 0, depth = 0, group, lane, below
    while True:
        if cell == 0 and boxes.groups[boxes.root].size == SIZE:
            _enter(tree, 0, boxes.root, boxes.group_count, 0)
            boxes.root = boxes.group_count
            boxes.group_count += 1
            boxes.depth += 1
        group, lane = boxes.cells[cell].group, boxes.cells[cell].lane
        if group < 0:
            cell = _half(tree, node, cell)
            continue
        below = boxes.groups[group].below[lane]
        if below >= 0 and boxes.groups[below].size == SIZE:
            _split(tree, cell)
        elif below < 0 and boxes.leaves[-1 - below].size == SIZE:
            if boxes.groups[group].size < SIZE:
                _divide(tree, cell)
            else:
                # The cell has come into this group as another one was split: now it is this one's turn, from above.
                cell, depth = 0, 0
        else:
            _widen(tree, node, group, lane)
            depth += 1
            if below < 0:
                break
            cell = _half(tree, node, cell)
    _put(tree, node, INFINITY, -1 - below)
    boxes.count, boxes.depth = node + 1, max(boxes.depth, depth)


cdef Py_ssize_t _half(const Nodes *tree, Py_ssize_t node, Py_ssize_t cell) noexcept nogil:
    """Return the half of a cell that a node belongs to, by a coordinate or by its number."""
    cdef const Cell *divided = &tree.boxes.cells[cell]
    cdef double place = tree.rows[tree.n * node + divided.by] if divided.by < tree.n else <double> node
    return divided.more if place > divided.cut else divided.less


cdef float _under(double number) noexcept nogil:
    """Return the greatest number in single precision that is not greater."""
    cdef float single = <float> number
    return single if single <= number else nextafterf(single, -INFINITY)


cdef void _widen(Nodes *tree, Py_ssize_t node, Py_ssize_t group, Py_ssize_t lane) noexcept nogil:
    """Let the box of a cell hold a node."""
    cdef float *lows = _boxes_of(tree, group) + lane
    cdef float *highs = lows + SIZE * tree.n
    cdef const double *row = tree.rows + tree.n * node
    cdef Py_ssize_t i
    for i in range(tree.n):
        lows[SIZE * i] = min(lows[SIZE * i], _under(row[i]))
        highs[SIZE * i] = max(highs[SIZE * i], -_under(-row[i]))


cdef void _put(Nodes *tree, Py_ssize_t node, float cost, Py_ssize_t leaf) noexcept nogil:
    """Put a node with its cost into a leaf that has room."""
    cdef Leaf *known = &tree.boxes.leaves[leaf]
    cdef float *places = _places_of(tree, leaf) + known.size
    cdef Py_ssize_t i
    known.nodes[known.size] = node
    known.size += 1
    for i in range(tree.n):
        places[SIZE * i] = _under(tree.rows[tree.n * node + i])
    places[SIZE * tree.n] = cost


cdef void _divide(Nodes *tree, Py_ssize_t cell) noexcept nogil:
    """Divide a cell whose leaf is full; where its nodes are all at one place, into the earlier and the later."""
    cdef BoxTree *boxes = &tree.boxes
    cdef Cell *divided = &boxes.cells[cell]
    cdef Py_ssize_t n = tree.n, group = divided.group, lane = divided.lane, more = boxes.leaf_count, i, k
    cdef Py_ssize_t leaf = -1 - boxes.groups[group].below[lane]
    cdef Leaf full = boxes.leaves[leaf]
    cdef const float *costs = _places_of(tree, leaf) + SIZE * n
    cdef double widest = 0.0, low, high, place
    divided.by, divided.cut = n, <double> full.nodes[SIZE // 2 - 1]
    for i in range(n):
        low, high = INFINITY, -INFINITY
        for k in range(SIZE):
            place = tree.rows[n * full.nodes[k] + i]
            low, high = min(low, place), max(high, place)
        if high - low > widest:
            widest, divided.by, divided.cut = high - low, i, 0.5 * (low + high)
            # By rounding.
            if divided.cut >= high:
                divided.cut = low
    divided.less, divided.more, divided.group = 2 * more - 1, 2 * more, -1
    boxes.leaves[leaf].size = boxes.leaves[more].size = 0
    boxes.leaf_count = more + 1
    # Those that stay move towards the front, so that none is written over before it is read.
    for k in range(SIZE):
        _put(tree, full.nodes[k], costs[k], leaf if _half(tree, full.nodes[k], cell) == divided.less else more)
    _enter(tree, divided.less, -1 - leaf, group, lane)
    _enter(tree, divided.more, -1 - more, group, boxes.groups[group].size)


cdef void _enter(Nodes *tree, Py_ssize_t cell, Py_ssize_t below, Py_ssize_t group, Py_ssize_t lane) noexcept nogil:
    """Let a cell stand in a lane of a group, with the box of what is below it."""
    cdef BoxTree *boxes = &tree.boxes
    cdef float *lows = _boxes_of(tree, group) + lane
    cdef Py_ssize_t n = tree.n, far = 0, size, i, k
    cdef const float *inner
    cdef float low, high
    cdef double ulp = 0.0
    if below >= 0:
        inner, size, far = _boxes_of(tree, below), boxes.groups[below].size, n
    else:
        inner, size, ulp = _places_of(tree, -1 - below), boxes.leaves[-1 - below].size, SINGLE
    for i in range(n):
        low, high = inner[SIZE * i], inner[SIZE * (far + i)]
        for k in range(1, size):
            low, high = min(low, inner[SIZE * i + k]), max(high, inner[SIZE * (far + i) + k])
        lows[SIZE * i], lows[SIZE * (n + i)] = low, -_under(-high - ulp * fabs(high))
    low = inner[SIZE * (far + n)]
    for k in range(1, size):
        low = min(low, inner[SIZE * (far + n) + k])
    lows[SIZE * 2 * n] = low
    boxes.cells[cell].group, boxes.cells[cell].lane = group, lane
    boxes.groups[group].cells[lane], boxes.groups[group].below[lane] = cell, below
    boxes.groups[group].size = max(boxes.groups[group].size, lane + 1)


cdef void _move(Nodes *tree, Py_ssize_t cell, Py_ssize_t group) noexcept nogil:
    """Let a cell stand in another group; the last one of its group takes its place there."""
    cdef Py_ssize_t old = tree.boxes.cells[cell].group, lane = tree.boxes.cells[cell].lane
    cdef Group *left = &tree.boxes.groups[old]
    cdef Py_ssize_t last = left.size - 1, below = left.below[lane]
    _enter(tree, left.cells[last], left.below[last], old, lane)
    left.size = last
    _enter(tree, cell, below, group, tree.boxes.groups[group].size)


cdef void _split(Nodes *tree, Py_ssize_t cell) noexcept nogil:
    """Split the full group below a cell: the two that the cell is divided into stand in its group instead."""
    cdef BoxTree *boxes = &tree.boxes
    cdef Cell *cells = boxes.cells
    cdef Py_ssize_t group = cells[cell].group, lane = cells[cell].lane, new = boxes.group_count, size = 1, part
    cdef Py_ssize_t full = boxes.groups[group].below[lane], stays = cells[cell].less, goes = cells[cell].more
    cdef Py_ssize_t rest[SIZE]
    # One that stands in the full group itself needs no group of its own.
    if cells[stays].group >= 0:
        stays, goes = goes, stays
    cells[cell].group = -1
    if cells[goes].group >= 0:
        _move(tree, goes, group)
    else:
        rest[0], boxes.group_count = goes, new + 1
        while size > 0:
            size -= 1
            part = rest[size]
            if cells[part].group >= 0:
                _move(tree, part, new)
            else:
                rest[size], rest[size + 1] = cells[part].less, cells[part].more
                size += 2
        _enter(tree, goes, new, group, boxes.groups[group].size)
    _enter(tree, stays, full, group, lane)


cdef void _take_costs(Nodes *tree) noexcept nogil:
    """Let the k-d tree know the costs of nodes that have none in it."""
    cdef BoxTree *boxes = &tree.boxes
    cdef Py_ssize_t node, cell, below, group, lane
    cdef float *least
    cdef float cost
    for node in range(boxes.priced, tree.count):
        # Infinite, too, where it is not a number.
        cost = _under(tree.costs[node]) if tree.costs[node] < INFINITY else INFINITY
        cell = below = 0
        while below >= 0:
            group, lane = boxes.cells[cell].group, boxes.cells[cell].lane
            if group >= 0:
                least = _boxes_of(tree, group) + SIZE * 2 * tree.n + lane
                least[0] = min(least[0], cost)
                below = boxes.groups[group].below[lane]
            if below >= 0:
                cell = _half(tree, node, cell)
        lane = 0
        while boxes.leaves[-1 - below].nodes[lane] != node:
            lane += 1
        least = _places_of(tree, -1 - below) + SIZE * tree.n + lane
        least[0] = cost
    boxes.priced = tree.count


cdef int _make_room_for_one(Nodes *tree) except -1 nogil:
    """Make room in the k-d tree for another node: for as many again where there is none."""
    cdef BoxTree *boxes = &tree.boxes
    cdef Py_ssize_t n = tree.n, room, x
    if boxes.leaf_count == boxes.leaf_room:
        room = 2 * boxes.leaf_room + FEW
        boxes.cells = <Cell *> _wider(boxes.cells, 2 * room * sizeof(Cell))
        boxes.leaves = <Leaf *> _wider(boxes.leaves, room * sizeof(Leaf))
        boxes.places = <float *> _wider(boxes.places, SIZE * (n + 1) * room * sizeof(float))
        boxes.leaf_room = room
    # A node may add a group at every depth.
    if boxes.group_count + 2 * boxes.depth + 2 >= boxes.group_room:
        # They have ten cells each, mostly.
        room = 2 * boxes.group_room + FEW // 4
        boxes.groups = <Group *> _wider(boxes.groups, room * sizeof(Group))
        boxes.boxes = <float *> _wider(boxes.boxes, SIZE * (2 * n + 1) * room * sizeof(float))
        for x in range(boxes.group_room, room):
            boxes.groups[x].size = 0
        boxes.group_room = room
    if boxes.leaf_count == 0:
        boxes.leaf_count = boxes.group_count = boxes.depth = boxes.groups[0].size = 1
        boxes.cells[0].group = boxes.cells[0].lane = boxes.groups[0].cells[0] = boxes.leaves[0].size = 0
        boxes.groups[0].below[0] = -1
        for x in range(n):
            boxes.boxes[SIZE * x], boxes.boxes[SIZE * (n + x)] = INFINITY, -INFINITY
        boxes.boxes[SIZE * 2 * n] = INFINITY
    return 0


cdef void *_wider(void *memory, size_t size) except NULL nogil:
    """Return the memory with another size."""
    cdef void *wider = realloc(memory, size)
    if wider == NULL:
        with gil:
            raise MemoryError
    return wider


cdef void _forget(BoxTree *boxes) noexcept nogil:
    """Free the memory of a k-d tree."""
    free(boxes.cells)
    free(boxes.groups)
    free(boxes.leaves)
    free(boxes.boxes)
    free(boxes.places)
    free(boxes.waiting)
