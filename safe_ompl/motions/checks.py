"""Checks: proofs of motions that something else made, what stands in the way of one, and way points timed anew."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import CollisionChecker, MotionProver, MotionVerdict, Separation, ToolLimit, Verdict
from safe_ompl.common import (
    FloatArray,
    InputError,
    PlanningError,
    clock,
    finite_array,
    instance,
    notebook_html,
    number,
    polynomials,
)
from safe_ompl.danger import DangerLimit
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.rates import DISTANCES, Violation, rate_violations, stops_of
from safe_ompl.motions.tube import tube_of
from safe_ompl.paths import Constraints, claims_of
from safe_ompl.robot import Robot
from safe_ompl.scene import People, Scene
from safe_ompl.trajectories import RateLimits, Stops, Trajectory, time_path

TIME = 60.0  # [s] that a check may take by default
_OUT_OF_TIME = "out of time"
_FINEST = 2.0**-7  # of a piece: the shortest stretch that is reported as not proven
_TOUCHING = 1e-6  # [m] A smaller required distance allows for rounding, and is not called a clearance.


class MotionCheck(NamedTuple):
    """What is proven of a motion; true if everything is."""

    motion: Motion  # With its joints in the order of the robot's
    claims: tuple[str, ...]  # What was to be proven: "joint limits", "collision", "min clearance", "velocity", …
    violations: tuple[Violation, ...]  # What is not proven, by time; none: all of it is
    proof: MotionProver  # By which it was to be proven: robot, scene, distances and the tube, danger and tool
    limits: RateLimits | None = None  # Rates that it was to keep
    people: People | None = None  # Beside whom it was to be proven to stop,
    stops: Stops | None = None  # and how: `stops.stop_from(time)`

    @property
    def separation(self) -> Separation:
        """The distances that it is proven to keep, and its tube."""
        return self.proof.separation

    def __bool__(self) -> bool:
        return not self.violations

    def __str__(self) -> str:
        if self:
            tube = self.separation.tube
            within = f" within a tube of {_widths(tube)}" if tube else ""
            return f"proven{within}: {', '.join(self.claims)}"
        return "not proven:\n" + "\n".join(f"  {violation}" for violation in self.violations)

    def _repr_html_(self) -> str:
        return notebook_html(self)


def _widths(tube: tuple[float, ...]) -> str:
    same = max(tube) - min(tube) < 1e-12
    return f"±{tube[0]:.3g} rad" if same else "±[" + ", ".join(f"{w:.3g}" for w in tube) + "]"


def check(
    motion: Any,
    robot: Robot,
    scene: Scene,
    *,
    constraints: Constraints | None = None,
    tube: ArrayLike | Mapping[str, float] | None = None,
    limits: RateLimits | None = None,
    people: People | None = None,
) -> MotionCheck:
    """Prove a motion that something else made, or find what stands in the way.

    Parameters
    ----------
    motion : Motion or what `Motion.of` takes
        Such as a SciPy spline of (n,) values, way points (N, n), or an `og.PathGeometric`.
    robot : Robot
        The robot.
    scene : Scene
        The obstacles.
    constraints : Constraints, optional
        What else must hold: distances, danger, limits of the tool, checks of the user's own.
    tube : float, array_like of shape (n,), or mapping of str to float, optional
        Prove it of every motion whose joints are so near to this one at any time [rad or m].
    limits : RateLimits, optional
        Largest velocities, accelerations and jerks; for a motion in time. Default: these are not looked at.
    people : People, optional
        Who may begin to move at any instant, from where the scene has them: a stop on the motion, from whatever instant
        on, within the accelerations of `limits`, is over before they are nearer than their clearance; or, where contact
        is allowed, the robot is slow enough. The motion must be in time, and end at rest.

    Returns
    -------
    MotionCheck
        True if all is proven; `violations` says what is not. What is not proven free within a minute stays undecided:
        violations of the kind "out of time" say where. `SafeSetup.check` takes another time.

    Raises
    ------
    InputError
        If it is no motion of this robot's joints, or the tube is not ≥ 0. Beside people, if the motion is no function
        of time or does not end at rest; if limits are missing, or limit the jerk; or contact is allowed within a tube.
    UnknownNameError
        If the scene has no obstacle of a name.

    Notes
    -----
    Positions, velocities and accelerations are bounded as polynomials, not sampled. Collision is proven of the curve
    itself (`docs/mathematics.md` §4), and so are stops (§9). Of bare samples with a bound of the speed, it is proven of
    all motions between.
    """
    wanted = Constraints() if constraints is None else instance("constraints", constraints, Constraints)
    if tube is not None:
        wanted = wanted.with_separation(tube=tube_of(tube, robot))
    return check_with(motion, _proof(robot, scene, wanted), limits, people)


def check_with(
    motion: Any, proof: MotionProver, limits: RateLimits | None = None, people: People | None = None, time: float = TIME
) -> MotionCheck:
    """Return the same as `check` with a `MotionProver` that is there already, within a time [s]."""
    end = clock() + number("time", time, above=0.0, kind="number of seconds")
    limits = None if limits is None else instance("limits", limits, RateLimits)
    robot = proof.checker.robot
    motion = Motion.of(motion, space=robot).for_robot(robot)
    stops = None if people is None else stops_of(motion, proof, limits, people)
    found = rate_violations(motion, robot, limits)
    outside = {violation.names[0] for violation in found if violation.kind == "position"}
    stretches: list[Violation] = []
    for piece in piece_proofs(motion, replace(proof, stop=lambda: clock() > end)):
        verdict = piece.verdict()
        joint, what = verdict.pair or ("", "")
        known = what == "its limits" and joint in outside  # pairs and radii hold within the limits only
        if verdict.verdict is not Verdict.FREE and not known:
            stretches += piece.unproven()
    limits = limits if motion.rated else None
    claims = ["joint limits", *(limits.kinds if limits is not None else ()), *claims_of(proof)]
    found += _joined(stretches)
    if stops is not None and people is not None:
        claims += [f"stops{' or slow contact' * people.contact} beside people"]
        found += _joined(list(_late(stops, people)))
    found.sort(key=lambda violation: (violation.at, violation.kind))
    return MotionCheck(motion, tuple(claims), tuple(found), proof, limits, people, stops)


def widest_tube(
    motion: Any,
    robot: Robot,
    scene: Scene,
    *,
    constraints: Constraints | None = None,
    proportions: ArrayLike | None = None,
    tolerance: float = 0.01,
) -> FloatArray:
    """Return the widest tube about a motion that is proven.

    Parameters
    ----------
    motion, robot, scene, constraints
        As `check`.
    proportions : array_like, shape (n,), optional
        The tube is a multiple of these [rad or m]. Default: all joints alike.
    tolerance : float
        Relative: a tube that is wider by this share is not proven.

    Returns
    -------
    ndarray, shape (n,)
        Widths [rad or m]: every motion whose joints are so near to this one is proven. Zeros where the motion itself
        is not.

    InputError as `check`; or if the proportions are not ≥ 0, or all 0, or the tolerance is not in (0, 1).
    """
    shape = np.ones(robot.n) if proportions is None else finite_array(proportions, (robot.n,), "proportions")
    if (shape < 0).any() or not shape.any():
        raise InputError(f"proportions must be >= 0, and not all 0, got {shape.tolist()}")
    if not 0 < tolerance < 1:
        raise InputError(f"tolerance must be between 0 and 1, got {tolerance!r}")
    motion = Motion.of(motion, space=robot).for_robot(robot)
    proof = _proof(robot, scene, Constraints() if constraints is None else constraints)
    order = list(range(motion.pieces))  # the pieces that failed last come first

    def proven(width: float) -> bool:
        tube = tuple((width * shape).tolist())
        within = replace(proof, separation=replace(proof.separation, tube=tube))
        pieces = list(piece_proofs(motion, within))
        for k in order:
            if not pieces[k].proven():
                order.insert(0, order.pop(order.index(k)))
                return False
        return True

    if rate_violations(motion, robot) or not proven(0.0):
        return np.zeros(robot.n)
    low, high = 0.0, 1e-3
    while proven(high):
        low, high = high, 2 * high
        if high > 2 * np.pi:
            break
    while high - low > tolerance * low and high > 1e-9:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if proven(middle) else (low, middle)
    widest: FloatArray = low * shape
    return widest


class PieceProof(NamedTuple):
    """The proof of piece `number` of a motion, and of parts of it: coefficients (d + 1, n), in a time span [s].

    `proof` has the allowance of the piece in its tube.
    """

    number: int
    curve: FloatArray
    span: tuple[float, float]
    proof: MotionProver

    def place(self, u: float) -> FloatArray:
        """Return the joint values (n,) at a fraction of the piece."""
        return np.array(np.polynomial.polynomial.polyval(u, self.curve))

    def proven(self) -> bool:
        """Return whether the whole piece is proven."""
        return self.verdict().verdict is Verdict.FREE

    def time(self, u: float) -> float:
        """Return the time [s] at a fraction of the piece."""
        return self.span[0] + u * (self.span[1] - self.span[0])

    def verdict(self, low: float = 0.0, high: float = 1.0) -> MotionVerdict:
        """Return the verdict on the piece from one fraction to another; its `at` is a fraction of this part."""
        if self.proof.stop():
            return MotionVerdict(Verdict.UNDECIDED, 0.0)
        whole = (low, high) == (0.0, 1.0)
        return self.proof.check_curve(self.curve if whole else polynomials.restricted(self.curve, low, high))

    def unproven(self, low: float = 0.0, high: float = 1.0) -> Iterator[Violation]:
        """Yield short stretches between two fractions of the piece that are not proven, by time."""
        found = self.verdict(low, high)
        if found.verdict is Verdict.FREE:
            return
        if self.proof.stop():
            first, last = self.time(low), self.time(high)
            yield Violation(_OUT_OF_TIME, first, last, first, (), decided=False)
            return
        if high - low > _FINEST:
            middle = 0.5 * (low + high)
            yield from self.unproven(low, middle)
            yield from self.unproven(middle, high)
            return
        u = low + (0.5 if found.at is None else found.at) * (high - low)
        kind, names, value, bound = _values(self.proof, found, self.place(u))
        decided = found.verdict is Verdict.BLOCKED
        yield Violation(kind, self.time(low), self.time(high), self.time(u), names, value, bound, decided)


def piece_proofs(motion: Motion, proof: MotionProver) -> Iterator[PieceProof]:
    """Yield the proofs of the pieces of a motion, its joints in the order of the robot's."""
    separation, allowance = proof.separation, motion.allowance
    if motion.slack is None:  # rounding alone: the same for all pieces
        allowance = np.broadcast_to(allowance.max(axis=0), allowance.shape)
    within: dict[bytes, MotionProver] = {}
    for k, row in enumerate(np.array(separation.tube or np.zeros(motion.n)) + allowance):
        if row.tobytes() not in within:
            within[row.tobytes()] = replace(proof, separation=replace(separation, tube=tuple(row.tolist())))
        span = float(motion.times[k]), float(motion.times[k + 1])
        yield PieceProof(k, motion.coefficients[k], span, within[row.tobytes()])


def _proof(robot: Robot, scene: Scene, wanted: Constraints) -> MotionProver:
    return MotionProver(CollisionChecker(robot, scene), separation=wanted.separation, limits=wanted.limits)


def _joined(stretches: list[Violation]) -> Iterator[Violation]:
    """Yield stretches of one kind that follow each other as one, with what is worst in any of them."""

    def depth(violation: Violation) -> float:
        if violation.value is None or violation.limit is None:
            return -np.inf
        beyond = violation.value - violation.limit
        return -beyond if violation.kind in DISTANCES else beyond

    groups: list[list[Violation]] = []
    for found in stretches:
        if groups and (groups[-1][-1].last, groups[-1][-1].kind) == (found.first, found.kind):
            groups[-1].append(found)
        else:
            groups.append([found])
    for group in groups:
        worst = max([violation for violation in group if violation.decided] or group, key=depth)
        yield replace(worst, first=group[0].first, last=group[-1].last)


def _values(
    proof: MotionProver, found: MotionVerdict, q: FloatArray
) -> tuple[str, tuple[str, ...], float | None, float | None]:
    """Return what kind of violation it is, of what, what is found at `q: (n,)`, and its bound."""
    name = None if found.pair is None else found.pair[0]
    robot = proof.checker.robot
    if name in robot.joint_names and found.pair is not None and found.pair[1] == "its limits":
        return "position", (str(name),), float(q[robot.joint_names.index(str(name))]), None
    for limit in proof.limits:
        if getattr(limit, "name", type(limit).__name__) == name:
            if isinstance(limit, DangerLimit):
                return "danger", (), limit.danger(q), limit.limit
            if isinstance(limit, ToolLimit):
                return limit.name, (), limit.excess(q), 0.0
            return str(name), (), None, None
    checker, required = proof.checker, proof.required
    distances = checker.pair_distances(q)  # of the pairs that may touch, the first of those required
    if not len(distances):
        return "collision", (), None, None
    least = required.least[: len(distances)]
    worst = int((distances - least).argmin())
    distance, bound = float(distances[worst]), float(least[worst])
    kind = "clearance" if distance > 0.0 and bound > _TOUCHING else "collision"
    return kind, checker.pair_names[worst], distance, bound if kind == "clearance" else 0.0


def _late(stops: Stops, people: People) -> Iterator[Violation]:
    """Yield where stops that begin there may be too late, by time."""
    edges = stops.cells.edges.tolist()
    for j in np.flatnonzero(stops.left < 0).tolist():
        link, (person, limb), room = stops.met(j)
        names = link, f"{person} ({limb})" if limb else person
        decided = bool(stops.left[j] + stops.loss[j] < 0)
        value = people.clearance + room
        yield Violation("separation", edges[j], edges[j + 1], edges[j], names, value, people.clearance, decided)


# ---------------------------------------------------------------------------------------- way points, timed


def retime(
    motion: Any,
    robot: Robot,
    scene: Scene,
    limits: RateLimits | None = None,
    *,
    constraints: Constraints | None = None,
    tube: ArrayLike | None = None,
    **options: Any,
) -> Trajectory:
    """Return the fastest trajectory along way points that something else made; times that they have are thrown away.

    The straight motions between them are proven first, and blends that round the corners are, too.

    Parameters
    ----------
    motion, robot, scene, constraints, tube
        As for `check`: way points (N, n), or what `read_motion` returns; of curved pieces only the ends count.
    limits : RateLimits, optional
        Of the joints; default: `RateLimits.of(robot)`.
    **options
        Those of `time_path`: `people`, beside whom it is no faster than what is proven to stop in time, `tolerance` of
        blends, `tool_speed`, `link_speed`, `danger` and `max_danger`.

    Errors as `check` and `time_path`, and a PlanningError if a way point, or the straight motion to the next one, is
    not proven: says which, counted from 0.
    """
    found = check(way_of(motion, robot), robot, scene, constraints=constraints, tube=tube)
    if not found:
        raise PlanningError(objection(found))
    return time_path(found.motion.knots, robot, limits, motion=found.proof, **options)


def way_of(motion: Any, robot: Robot) -> Motion:
    """Return the straight lines through the way points of a motion, without times."""
    given = Motion.of(motion, space=robot).for_robot(robot)
    return Motion.through(given.knots, names=robot.joint_names)


def objection(found: MotionCheck) -> str:
    """Return which way point of a way that is not proven is at fault, or between which two it is, and why."""
    proof = found.proof
    for k, q in enumerate(found.motion.knots):
        beyond = proof.checker.robot.beyond_limits(q)
        if beyond is not None:
            return f"way point {k}: {beyond}"
        verdict = proof.check(q, q)
        if verdict.verdict is not Verdict.FREE:
            return f"way point {k} is not proven to be free: {' – '.join(verdict.pair or ())}".rstrip(": ")
    first = found.violations[0]
    value, limit = first.quantities
    begin = min(int(first.at), found.motion.pieces - 1)
    said = ", ".join(part for part in (" – ".join(first.names), value, limit and f"limit {limit}") if part)
    return f"between way points {begin} and {begin + 1}, at {first.at:.3f}: {first.kind}: {said}"
