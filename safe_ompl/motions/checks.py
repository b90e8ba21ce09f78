"""Check motions from other planners, explain why a motion is not proven, and time way points anew."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import CollisionChecker, MotionProver, Separation, Verdict
from safe_ompl.common import (
    BoolArray,
    FloatArray,
    InputError,
    PlanningError,
    documents as document,
    finite_array,
    in_order,
    instance,
    notebook_html,
    number,
)
from safe_ompl.motions.constraints import Constraints, claims_of
from safe_ompl.motions.limits import RateLimits
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.pieces import PieceProofs
from safe_ompl.motions.rates import DISTANCES, Violation, rate_violations, stops_of
from safe_ompl.motions.stops import Stops
from safe_ompl.motions.timing import time_path
from safe_ompl.motions.trajectory import Trajectory
from safe_ompl.motions.tube import tube_of
from safe_ompl.robot import Robot
from safe_ompl.scene import People, Scene

# Each worker process checks this many motions per task.
_MOTIONS_PER_TASK = 8
# Default time limit of a check.
TIME = 60.0  # [s]


class MotionCheck(NamedTuple):
    """The result of a check. It is true if all claims about the motion are proven."""

    # The motion, with its joints in the robot's order.
    motion: Motion
    # What was to be proven: "joint limits", "collision", "min clearance", "velocity", …
    claims: tuple[str, ...]
    # What is not proven, in the order of time. An empty tuple means that all claims are proven.
    violations: tuple[Violation, ...]
    # The prover with the robot, the scene, the distances to keep, the tube, and limits of danger and tool.
    proof: MotionProver
    # The limits of velocity, acceleration and jerk, if they were checked.
    limits: RateLimits | None = None
    # The people beside whom stops were checked, and the stops: `stops.stop_from(time)`.
    people: People | None = None
    stops: Stops | None = None

    @property
    def separation(self) -> Separation:
        """The distances that the motion is proven to keep, and its tube."""
        return self.proof.separation

    def __bool__(self) -> bool:
        return not self.violations

    @property
    def long_turns(self) -> tuple[str, ...]:
        """Descriptions of pieces on which a continuous joint turns by more than π, so not the shortest way."""
        motion, robot = self.motion, self.proof.checker.robot
        turns = np.diff(motion.knots, axis=0) * robot.continuous
        return tuple(
            f"joint {robot.joint_names[i]!r} turns by {turns[k, i]:.4g} rad from {motion.times[k]:.4g} to "
            f"{motion.times[k + 1]:.4g}{' s' if motion.timed else ''}, as its numbers stand"
            for k, i in np.argwhere(np.abs(turns) > np.pi)
        )

    def __str__(self) -> str:
        turns = [f"  {turn}" for turn in self.long_turns]
        if self:
            tube = self.separation.tube
            within = f" within a tube of {_widths(tube)}" if tube else ""
            return "\n".join([f"proven{within}: {', '.join(self.claims)}", *turns])
        return "\n".join(["not proven:", *(f"  {violation}" for violation in self.violations), *turns])

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
    """Prove that a motion from another planner is safe, or find where it is not.

    Parameters
    ----------
    motion : Motion or what `Motion.of` takes
        Such as a SciPy spline of (n,) values, way points (N, n), or an `og.PathGeometric`.
    robot : Robot
        The robot.
    scene : Scene
        The obstacles.
    constraints : Constraints, optional
        Further requirements: distances, danger, limits of the tool, checks of the user.
    tube : float, array_like of shape (n,), or mapping of str to float, optional
        Prove the claims for every motion whose joint values differ by at most this from the motion at any time [rad or
        m].
    limits : RateLimits, optional
        Largest velocities, accelerations and jerks of a timed motion. Default: they are not checked.
    people : People, optional
        People who may begin to move at any instant from their positions in the scene. From any instant on, a stop on
        the motion within the accelerations of `limits` must end before a person is nearer than the clearance. Where
        contact is allowed, the robot may instead be slow enough. The motion must be timed, and end at rest.

    Returns
    -------
    MotionCheck
        True if all claims are proven; `violations` lists the others. Stretches that are not proven free within a minute
        stay undecided: they are violations of the kind "out of time". `SafeSetup.check` has an option for the time.

    Raises
    ------
    InputError
        If the motion does not fit the robot's joints, or the tube is negative. With people: if the motion is not timed
        or does not end at rest; if limits are missing, or limit the jerk; or if contact is allowed within a tube.
    UnknownNameError
        If the constraints name an obstacle that the scene does not have.

    Notes
    -----
    Positions, velocities and accelerations are bounded as polynomials, not sampled. Freedom of collision is proven for
    the curve itself (`docs/how-it-works.md` §4), and so are stops (§9). For samples with a bound of the velocity, the
    proof covers every motion through the samples that keeps the bound.
    """
    return check_with(motion, prover_of(robot, scene, constraints, tube), limits, people)


# The results of a check that worker processes send back. They are kept small to keep the transfer fast.
_CheckParts = tuple[Motion, tuple[str, ...], tuple[Violation, ...], RateLimits | None]


def check_many(
    motions: Iterable[Any],
    robot: Robot,
    scene: Scene,
    *,
    limits: RateLimits | None = None,
    people: People | None = None,
    workers: int = 1,
    **wanted: Any,
) -> list[MotionCheck]:
    """Check several motions as `check` does and return the results in order, without their `stops`.

    The models of robot and scene are built once. With `workers` > 1, as many processes run. Raises InputError if
    `workers` is less than 1. The other arguments, `constraints` and `tube`, and the errors are those of `check`. An
    error names the motion by its index, counted from 0.
    """
    proof, given = prover_of(robot, scene, **wanted), list(motions)

    def found(some: range) -> list[_CheckParts]:
        checks = list[_CheckParts]()
        for k in some:
            with document.within(f"motion {k}", ": "):
                check = check_with(given[k], proof, limits, people)
            checks.append((check.motion, check.claims, check.violations, check.limits))
        return checks

    def lost(some: range, words: str) -> list[_CheckParts]:
        raise PlanningError(f"the check of motions {some.start} to {some.stop - 1} was lost: {words}")

    parts = [range(k, min(k + _MOTIONS_PER_TASK, len(given))) for k in range(0, len(given), _MOTIONS_PER_TASK)]
    return [
        MotionCheck(motion, claims, violations, proof, rates, people)
        for checks in in_order(found, parts, workers, lost)
        for motion, claims, violations, rates in checks
    ]


def prove_many(
    starts: ArrayLike,
    ends: ArrayLike,
    robot: Robot,
    scene: Scene,
    *,
    constraints: Constraints | None = None,
    workers: int = 1,
) -> BoolArray:
    """Return which of the straight motions from `starts` to `ends: (B, n)` are proven free, (B,).

    The result equals that of `MotionProver.is_free` for each motion, with the constraints. The motions are divided
    among `workers` threads. For frequent queries, build the prover once and call `MotionProver.are_free`. Errors are
    those of `are_free` and `check`.
    """
    free = prover_of(robot, scene, constraints).are_free(starts, ends, workers=workers)
    robot.check_turns(np.asarray(starts), np.asarray(ends), "motions")
    return free


def check_with(
    motion: Any, proof: MotionProver, limits: RateLimits | None = None, people: People | None = None, time: float = TIME
) -> MotionCheck:
    """Check a motion as `check` does, with an existing `MotionProver`, within a time [s]."""
    end = perf_counter() + number("time", time, above=0.0, kind="number of seconds")
    robot = proof.checker.robot
    pieces = PieceProofs(Motion.of(motion, space=robot).for_robot(robot), proof)
    undecided = pieces.undecided()
    if undecided:
        pieces = PieceProofs(pieces.motion, replace(proof, stop=lambda: perf_counter() > end))
    return check_of(pieces, undecided, proof, limits, people)


def check_of(
    pieces: PieceProofs, undecided: list[int], proof: MotionProver, limits: RateLimits | None, people: People | None
) -> MotionCheck:
    """Return the check of a motion all of whose pieces are proven but the undecided ones, which are proven now."""
    motion, robot = pieces.motion, proof.checker.robot
    limits = None if limits is None else instance("limits", limits, RateLimits)
    stops = None if people is None else stops_of(motion, proof, limits, people)
    found = rate_violations(motion, robot, limits)
    outside = {violation.names[0] for violation in found if violation.kind == "position"}
    stretches: list[Violation] = []
    for piece in map(pieces.__getitem__, undecided):
        verdict = piece.verdict()
        joint, what = verdict.pair or ("", "")
        # Beyond the joint limits the pairs and motion bounds do not hold, so only the violated limit is known.
        known = what == "its limits" and joint in outside
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
    """Return the widest proven tube about a motion.

    Parameters
    ----------
    motion, robot, scene, constraints
        As `check`.
    proportions : array_like, shape (n,), optional
        The tube is a multiple of these widths [rad or m]. Default: equal widths for all joints.
    tolerance : float
        Relative tolerance: a tube that is wider by this share is not proven.

    Returns
    -------
    ndarray, shape (n,)
        Widths [rad or m]: every motion whose joint values differ by at most these widths is proven. Zeros if the motion
        itself is not proven.

    Raises
    ------
    InputError
        As `check`, if the proportions are negative or all 0, or if the tolerance is not in (0, 1).
    """
    shape = np.ones(robot.n) if proportions is None else finite_array(proportions, (robot.n,), "proportions")
    if (shape < 0).any() or not shape.any():
        raise InputError(f"proportions must be >= 0, and not all 0, got {shape.tolist()}")
    if not 0 < tolerance < 1:
        raise InputError(f"tolerance must be between 0 and 1, got {tolerance!r}")
    motion = Motion.of(motion, space=robot).for_robot(robot)
    proof = prover_of(robot, scene, constraints)
    # Pieces that failed in the last attempt are checked first, because they probably fail again.
    order = list(range(motion.pieces))

    def proven(width: float) -> bool:
        tube = tuple((width * shape).tolist())
        within = replace(proof, separation=replace(proof.separation, tube=tube))
        pieces = PieceProofs(motion, within)
        for k in order:
            if not pieces[k].proven():
                order.insert(0, order.pop(order.index(k)))
                return False
        return True

    if rate_violations(motion, robot) or not proven(0.0):
        return np.zeros(robot.n)
    low, high = 0.0, 1e-3
    while high <= 2 * np.pi and proven(high):
        low, high = high, 2 * high
    while high - low > tolerance * low and high > 1e-9:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if proven(middle) else (low, middle)
    return low * shape


def prover_of(
    robot: Robot,
    scene: Scene,
    constraints: Constraints | None = None,
    tube: ArrayLike | Mapping[str, float] | None = None,
) -> MotionProver:
    """Return the prover of a robot in a scene, with the distances, limits and tube that `check` takes."""
    wanted = Constraints() if constraints is None else instance("constraints", constraints, Constraints)
    if tube is not None:
        wanted = wanted.with_separation(tube=tube_of(tube, robot))
    return MotionProver(CollisionChecker(robot, scene), separation=wanted.separation, limits=wanted.limits)


def _joined(stretches: list[Violation]) -> Iterator[Violation]:
    """Merge consecutive stretches of the same kind into one violation, with the worst value of all."""

    def depth(violation: Violation) -> float:
        if violation.value is None:
            return -np.inf
        beyond = violation.value - (violation.limit or 0.0)
        return violation.nearer - beyond if violation.kind in DISTANCES else beyond

    groups: list[list[Violation]] = []
    for found in stretches:
        if groups and (groups[-1][-1].last, groups[-1][-1].kind) == (found.first, found.kind):
            groups[-1].append(found)
        else:
            groups.append([found])
    for group in groups:
        worst = max([violation for violation in group if violation.decided] or group, key=depth)
        yield replace(worst, first=group[0].first, last=group[-1].last)


def _late(stops: Stops, people: People) -> Iterator[Violation]:
    """Yield the time intervals in which a stop that begins there may end too late."""
    edges = stops.cells.edges.tolist()
    for j in np.flatnonzero(stops.left < 0).tolist():
        link, (person, limb), room = stops.met(j)
        names = link, f"{person} ({limb})" if limb else person
        decided = bool(stops.left[j] + stops.loss[j] < 0)
        value = people.clearance + room
        yield Violation("separation", edges[j], edges[j + 1], edges[j], names, value, people.clearance, decided)


def retime(motion: Any, robot: Robot, scene: Scene, limits: RateLimits | None = None, **options: Any) -> Trajectory:
    """Return the fastest trajectory along the way points of a given motion. Its own times are ignored.

    First the straight motions between the way points and the blends at corners are proven.

    Parameters
    ----------
    motion, robot, scene
        As for `check`: way points (N, n), or what `read_motion` returns. Of curved pieces only the ends are used.
    limits : RateLimits, optional
        Limits of the joints. Default: `RateLimits.of(robot)`.
    **options
        Those of `time_path`: `people` limits the speed so that the robot is proven to stop in time; also `tolerance` of
        blends, `tool_speed`, `link_speed`, `danger` and `max_danger`.

    Raises
    ------
    PlanningError
        With the index (from 0) of a way point, if the way point or the straight motion to the next one is not proven.
    SafeOmplError
        As `check` and `time_path`.
    """
    found = check(way_of(motion, robot), robot, scene)
    if not found:
        raise PlanningError(why_unproven(found))
    return time_path(found.motion.knots, robot, limits, motion=found.proof, **options)


def way_of(motion: Any, robot: Robot) -> Motion:
    """Return the straight lines through the way points of a motion, without times."""
    given = Motion.of(motion, space=robot).for_robot(robot)
    return Motion.through(given.knots, names=robot.joint_names)


def why_unproven(found: MotionCheck) -> str:
    """Describe why a path is not proven: the way point, or the pair of way points, and the reason."""
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
    details = ", ".join(part for part in (" – ".join(first.names), value, limit and f"limit {limit}") if part)
    return f"between way points {begin} and {begin + 1}, at {first.at:.3f}: {first.kind}: {details}"
