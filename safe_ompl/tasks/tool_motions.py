"""Motions of the tool along a curve, planned with low danger and proven at all times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import CollisionChecker, MotionProver
from safe_ompl.common import FloatArray, InputError, instance, number, polynomials, seed as checked_seed, whole_number
from safe_ompl.danger import DangerField
from safe_ompl.motions import Motion, MotionCheck, RateLimits, check_with, rate_violations
from safe_ompl.robot import Frames, Robot, Tip
from safe_ompl.scene import Scene
from safe_ompl.tasks.corridor import Corridor, CorridorProof, prove_corridor
from safe_ompl.tasks.ladder import PRECISION, Costs, Ladder
from safe_ompl.tasks.tool_path import ToolPath

if TYPE_CHECKING:
    from safe_ompl.planning import SafeSetup

# The largest distance and rotation between rungs.
_RUNG_DISTANCE, _RUNG_ROTATION = 0.03, 0.15  # [m], [rad]
# The least number of rungs from one stop to the next, both included.
_FEWEST = 6
# The nodes are doubled at most this often until the corridor is proven.
_DOUBLINGS = 5
# The number of steps of the descent in the null space.
_DESCENT_STEPS = 12
# The longest step of this descent.
_LONGEST_DESCENT_STEP = 0.4  # [rad or m]
# The weight [1/rad] of ‖dq/dσ‖² against the costs of nodes. σ is the share of the curve.
_SMOOTHNESS_WEIGHT = 1.0
# A guess of the curvature [1/rad] of the costs of nodes, for Newton's method.
_CURVATURE = 20.0
# Configurations nearer to joint limits than this cost more.
_INSIDE = 0.1  # [rad or m]
# Where the ladder ends, the inverse kinematics starts from this many random seeds, and from twice as many at each of
# this many tries.
_SEEDS, _SEED_TRIES = 32, 3
# The search ends after this many joint paths that are not proven.
_MOST_UNPROVEN = 12
# A ramp, or the curve, may use this share of the acceleration limits.
_RAMP_SHARE = 0.45
# This share of each rate limit is used.
_MARGIN = 0.999
# A motion that exceeds a limit is slowed down by this factor more than needed, because of rounding.
_EXTRA_SLOWDOWN = 1.001


@dataclass(frozen=True)
class ToolMotion:
    """Result of planning a tool motion; true if there is a motion, which is then proven at all times.

    Attributes
    ----------
    motion : Motion or None
        The motion in time, from rest to rest.
    path, corridor
        The given curve and corridor.
    along : Motion or None
        The same motion as a function of the curve parameter [m] instead of time; `proof` is about this motion.
    proof : CorridorProof or None
        The proof that the tip stays in the corridor.
    check : MotionCheck or None
        The proof that the whole motion is free of collision and satisfies limits and constraints.
    speed : float
        Speed of the tip between the ramps [m/s]; approximate along a spline.
    danger_mean, danger_max : float
        Mean and maximum of the danger at samples along the curve; NaN without a danger field.
    fraction : float
        Share of the curve that the arm can follow; 1 if a motion is found.
    why : str
        The reason why there is no motion; empty if there is one.
    planning_time : float
        Duration of planning [s].

    Examples
    --------
    >>> down = [0.0, 1.0, 0.0, 0.0]
    >>> path = ToolPath.line(Pose([0.4, -0.1, 0.4], down), Pose([0.4, 0.1, 0.4], down))
    >>> found = tool_motion(path, Robot.from_example("panda"), Scene(), Corridor(position=0.001, angle=0.01), speed=0.1)
    >>> bool(found)
    True
    """

    motion: Motion | None
    path: ToolPath
    corridor: Corridor
    along: Motion | None = None
    proof: CorridorProof | None = None
    check: MotionCheck | None = None
    speed: float = 0.0
    danger_mean: float = float("nan")
    danger_max: float = float("nan")
    fraction: float = 1.0
    why: str = ""
    planning_time: float = 0.0

    def __bool__(self) -> bool:
        return self.motion is not None

    def __str__(self) -> str:
        if self.motion is None or self.proof is None:
            return f"no tool motion: {100 * self.fraction:.0f} % of the curve can be followed; {self.why}"
        turn = np.degrees(self.proof.angle)
        return (
            f"tool motion of {self.path.length:.3g} m in {self.motion.duration:.2f} s at {self.speed:.3g} m/s, proven "
            f"within {1e3 * self.proof.position:.2g} mm and {turn:.2g}° of its curve; danger {self.danger_mean:.2f} on "
            f"average, {self.danger_max:.2f} at most"
        )


def tool_motion(
    path: Any,
    robot: Robot,
    scene: Scene,
    corridor: Corridor | None = None,
    *,
    start: ArrayLike | None = None,
    speed: float | None = None,
    limits: RateLimits | None = None,
) -> ToolMotion:
    """Plan a joint motion with low danger whose tip follows a curve, and prove it at all times.

    Parameters
    ----------
    path : ToolPath, or a sequence of poses
        The curve of the tip in the world frame; two poses are a line, more poses a spline.
    robot, scene
        Robot and obstacles; obstacles with a weight are dangerous.
    corridor : Corridor, optional
        Tolerances of the tip; default: 1 mm and 0.01 rad.
    start : array_like, shape (n,), optional
        Start configuration [rad or m], whose tip must be at the beginning of the curve. Default: the planner chooses.
    speed : float, optional
        Speed of the tip [m/s], reduced if a joint limit requires it. Default: the largest possible speed.
    limits : RateLimits, optional
        Limits of the joints' rates; default: `RateLimits.of(robot)`.

    Returns
    -------
    ToolMotion
        If no motion is found, `motion` is None, and `why` and `fraction` give the reason and the place.

    Raises
    ------
    InputError
        If an argument is invalid.

    Notes
    -----
    Solutions of the inverse kinematics along the curve form a ladder graph, which is searched by dynamic programming.
    Then motions in the null space of the task reduce the danger (§4.3 of the paper). Cubic splines join the nodes.
    """
    checker = CollisionChecker(robot, scene)
    field = DangerField.of_scene(robot, scene) if any(obstacle.weight > 0 for obstacle in scene) else None
    return ToolPlanner(MotionProver(checker), field).plan(path, corridor, start=start, speed=speed, limits=limits)


def plan_tool(
    setup: SafeSetup,
    path: Any,
    corridor: Corridor | None = None,
    *,
    start: ArrayLike | None = None,
    speed: float | None = None,
    limits: RateLimits | None = None,
    seed: int = 0,
) -> ToolMotion:
    """Plan a motion of the tool along a curve under the constraints of a setup; see `tool_motion`.

    The same seed gives the same motion.
    """
    planner = ToolPlanner(setup.motion_prover, setup.field, seed=seed)
    return planner.plan(path, corridor, start=start, speed=speed, limits=limits)


class ToolPlanner:
    """Plans tool motions that a `MotionProver` proves, with low danger if a danger field is given.

    Parameters
    ----------
    prover : MotionProver
        The prover, with robot, scene and constraints.
    field : DangerField, optional
        The danger field.
    seed : int
        Seed of the random configurations from which the inverse kinematics begins. The same seed gives the same motion.
    effort : int
        Factor of the number of random configurations that are tried before the planner stops.
    """

    def __init__(self, prover: MotionProver, field: DangerField | None = None, *, seed: int = 0, effort: int = 1):
        self.prover, self.field = prover, field
        self._seed, self._effort = checked_seed(seed), whole_number("effort", effort, at_least=1)

    def plan(
        self,
        path: Any,
        corridor: Corridor | None = None,
        *,
        start: ArrayLike | None = None,
        speed: float | None = None,
        limits: RateLimits | None = None,
    ) -> ToolMotion:
        """Plan a motion along a curve; arguments, result and errors as `tool_motion`."""
        begin, robot = perf_counter(), self.prover.checker.robot
        rates = RateLimits.of(robot) if limits is None else limits
        wanted = None if speed is None else number("speed", speed, above=0.0)
        begins = None if start is None else robot.clipped_start(start)
        if begins is not None and (beyond := robot.beyond_limits(begins)) is not None:
            raise InputError(beyond, "start")
        search = _LadderSearch(
            ToolPath.of(path), self.prover, self.field, instance("corridor", corridor or Corridor(), Corridor)
        )
        found = search.run(begins, np.random.default_rng(self._seed), self._effort)
        if found.along is not None:
            motion, reached = in_time(found.along, search.path, robot, rates, wanted)
            found = replace(found, motion=motion, speed=reached)
        return replace(found, planning_time=perf_counter() - begin)


class _LadderSearch:
    """The search of a joint motion for one curve."""

    def __init__(self, path: ToolPath, prover: MotionProver, field: DangerField | None, corridor: Corridor) -> None:
        self.path, self._prover, self._field, self._corridor = path, prover, field, corridor
        self._robot, self._tip = prover.checker.robot, Tip(prover.checker.robot, corridor.axis)
        self._stops = np.concatenate([[0.0], path.corners, [path.length]])
        self._costs = Costs(prover.checker, field)

    def run(self, start: FloatArray | None, rng: np.random.Generator, effort: int) -> ToolMotion:
        """Add strands to the ladder and try to prove its cheapest path, until one is proven or no strand is found."""
        rungs = self._rungs()
        ladder = Ladder(self._tip, self._prover.checker, self._costs, rungs, self.path.at(rungs))
        if start is not None:
            self._check_start(start, ladder.frames)
            ladder.begin(start)
        refused: list[ToolMotion] = []
        tries = np.zeros(len(rungs), dtype=int)
        while len(refused) < _MOST_UNPROVEN * effort:
            path = ladder.cheapest()
            if path.nodes is None or path.strands is None:
                gap = path.reached
                if tries[gap] == _SEED_TRIES or (gap == 0 and start is not None):
                    break
                ladder.grow(rng, gap, effort * _SEEDS * 2 ** tries[gap])
                tries[gap] += 1
                continue
            made = self._proven(path.nodes, rungs, start)
            if made.along is not None:
                return made
            refused.append(made)
            at = int(np.abs(rungs - _where(made)).argmin())
            ladder.remove(at, path.strands[at])
        ends = ladder.ends
        share = 1.0 if refused else ends.reached / self.path.length
        where = f"at {1e3 * ends.reached:.0f} mm of {1e3 * self.path.length:.0f} mm {ends.why}"
        return ToolMotion(None, self.path, self._corridor, fraction=share, why=refused[-1].why if refused else where)

    def _rungs(self) -> FloatArray:
        """Return the curve parameters of the rungs (R,) [m], including all stops."""
        found = []
        for first, last in pairwise(self._stops):
            spins = np.linalg.norm(self.path.at(np.linspace(first, last, 20)[1:-1]).spins, axis=1).max()
            step = min(_RUNG_DISTANCE, _RUNG_ROTATION / max(spins, 1e-9))
            found.append(np.linspace(first, last, max(_FEWEST, int(np.ceil((last - first) / step)) + 1)))
        return np.unique(np.concatenate(found))

    def _check_start(self, start: FloatArray, frames: Frames) -> None:
        """Raise InputError if the tip at the start is farther from the curve's beginning than the corridor allows."""
        first = Frames(*(part[:1] for part in frames))
        errors = self._tip.errors(self._tip.at(start[None]), first)[0]
        far, turned = np.linalg.norm(errors[:3]), np.linalg.norm(errors[3:])
        if far > self._corridor.position or turned > self._corridor.angle:
            raise InputError(
                f"its tip is {1e3 * far:.3g} mm and {np.degrees(turned):.3g}° from the beginning of the curve", "start"
            )

    def _proven(self, nodes: FloatArray, rungs: FloatArray, start: FloatArray | None) -> ToolMotion:
        """Return the proven motion through the refined nodes, or else through the nodes; if neither, with a reason."""
        nodes = self._robot.unrolled(nodes)
        refined = self._refined(nodes, rungs, fixed=start is not None)
        made = self._made(refined, rungs)
        return made if made.along is not None or refined is nodes else self._made(nodes, rungs)

    def _made(self, nodes: FloatArray, s: FloatArray) -> ToolMotion:
        made = ToolMotion(None, self.path, self._corridor)
        for _ in range(_DOUBLINGS + 1):
            motion = self._spline(nodes, s)
            proof = prove_corridor(motion, self._robot, self.path, self._corridor)
            made = replace(made, proof=proof)
            if proof.proven:
                break
            s = np.sort(np.concatenate([s, (s[:-1] + s[1:]) / 2]))
            nodes, arrived = self._tip.solved(motion.at(s), self.path.at(s), PRECISION, 6)
            nodes[::2] = motion.knots
            if not arrived.all():
                break
        if not proof.proven:
            at = 1e3 * float(proof.at or 0.0)
            return replace(made, why=f"the arm leaves the corridor at {at:.0f} mm, near a limit or a singularity")
        check = check_with(motion, self._prover)
        if not check:
            worst = check.violations[0]
            return replace(made, check=check, why=worst.in_words(f"{1e3 * worst.at:.0f} mm"))
        samples = motion.at(np.linspace(0.0, self.path.length, 101))
        dangers = np.full(1, np.nan) if self._field is None else self._field.values(samples)
        return replace(
            made, along=motion, check=check, danger_mean=float(dangers.mean()), danger_max=float(dangers.max())
        )

    def _refined(self, nodes: FloatArray, s: FloatArray, *, fixed: bool) -> FloatArray:
        """Move the nodes (R, n) in the null space of the task to reduce the danger and to smooth the path."""
        frames, rungs = self.path.at(s), len(s)
        _, jacobians = self._tip.task(self._tip.at(nodes), frames)
        if self._robot.n <= np.linalg.matrix_rank(jacobians[rungs // 2], tol=1e-4):
            return nodes
        steps = np.diff(np.eye(rungs), axis=0)
        smooth = _SMOOTHNESS_WEIGHT * rungs * steps.T @ steps
        weights = np.gradient(s) / self.path.length
        hessian = 2 * smooth + np.diag(_CURVATURE * weights)
        if fixed:
            hessian[0] = hessian[:, 0] = np.eye(rungs)[0]

        def cost(nodes: FloatArray) -> float:
            inside = np.minimum(nodes - self._tip.limits[0], self._tip.limits[1] - nodes)
            cramped = _CURVATURE * weights @ (np.maximum(0, 1 - inside / _INSIDE) ** 2).sum(axis=1)
            return float(np.sum(nodes * (smooth @ nodes)) + weights @ self._costs.of(nodes) + cramped)

        best, least, step = nodes, cost(nodes), 1.0
        for _ in range(_DESCENT_STEPS):
            descent = -2 * smooth @ best
            if self._field is not None:
                descent -= self._costs.weight * weights[:, None] * self._field.gradients(best)
            if fixed:
                descent[0] = 0.0
            newton = np.asarray(np.linalg.solve(hessian, descent), dtype=np.float64)
            wanted = self._tip.null_motion(jacobians, newton)
            size = np.abs(wanted).max()
            if size < 1e-3:
                break
            moved = np.clip(best + wanted * min(step, _LONGEST_DESCENT_STEP / size), *self._tip.limits)
            moved, arrived = self._tip.solved(moved, frames, PRECISION, 4)
            if fixed:
                moved[0] = best[0]
            new = cost(moved) if arrived.all() else np.inf
            if new < least:
                best, least, step = moved, new, min(2.0, step * 1.5)
                _, jacobians = self._tip.task(self._tip.at(best), frames)
            else:
                step = min(step, _LONGEST_DESCENT_STEP / size) / 3
                if step * size < 1e-3:
                    break
        return best

    def _spline(self, nodes: FloatArray, s: FloatArray) -> Motion:
        """Return the motion of cubic splines through nodes (R, n) at s (R,), one spline from stop to stop."""
        pieces = []
        for first, last in pairwise(np.searchsorted(s, self._stops)):
            at, own = s[first : last + 1], nodes[first : last + 1]
            inside = np.array([at[0] + 1e-9 * (at[1] - at[0]), at[-1] - 1e-9 * (at[-1] - at[-2])])
            state, frames = self._tip.at(own[[0, -1]]), self.path.at(inside)
            _, jacobians = self._tip.task(state, frames)
            along = np.array([(own[1] - own[0]) / (at[1] - at[0]), (own[-1] - own[-2]) / (at[-1] - at[-2])])
            ends = self._tip.following(state, frames, jacobians, along)
            pieces.append(polynomials.cubic_spline(at, own, *ends))
        coefficients = np.concatenate(pieces)
        powers = np.diff(s)[:, None, None] ** np.arange(4)[:, None]
        return Motion(s, coefficients * powers, self._robot.joint_names, timed=False)


def _where(made: ToolMotion) -> float:
    """Return the parameter of the curve [m] at which a motion could not be proven."""
    if made.check is not None:
        return made.check.violations[0].at
    return 0.0 if made.proof is None or made.proof.at is None else made.proof.at


def in_time(
    along: Motion, path: ToolPath, robot: Robot, limits: RateLimits, speed: float | None
) -> tuple[Motion, float]:
    """Return the motion along a curve as a function of time, and the speed [m/s] between its ramps.

    Between stops s has a constant speed within the joints' limits, with smooth ramps s = v T (τ³ − τ⁴/2) at both ends.
    Cubic pieces in s become polynomials of degree 12 in time. The ramps do not consider limits of the jerk: if a limit
    is exceeded, the whole motion is slowed down.
    """
    rate, curvature = (np.abs(along.derivative_coefficients(order)).sum(axis=1).max(axis=0) for order in (1, 2))
    with np.errstate(divide="ignore"):
        fastest = min((limits.velocity / rate).min(), np.sqrt(_RAMP_SHARE * limits.acceleration / curvature).min())
        acceleration = float((_RAMP_SHARE * limits.acceleration / rate).min())
    v = float(min(fastest * _MARGIN, np.inf if speed is None else speed))
    times, coefficients = [0.0], []
    stops = np.concatenate([[0.0], path.corners, [path.length]])
    for first, last in pairwise(stops):
        own = min(v, np.sqrt(acceleration * (last - first) / 1.5))
        for span, piece in _composed(along, first, last, own, 1.5 * own / acceleration):
            times.append(times[-1] + span)
            coefficients.append(piece)
    size = max(len(piece) for piece in coefficients)
    filled = np.array([np.vstack([piece, np.zeros((size - len(piece), along.n))]) for piece in coefficients])
    rounding = 64 * np.finfo(np.float64).eps * np.abs(filled).sum(axis=1)
    motion, slower = Motion(np.array(times), filled, along.joint_names, rounding=rounding), 1.0
    orders = {kind: order for order, kind in enumerate(limits.kinds, start=1)}
    # A motion that takes x times as long has derivatives of order k that are divided by x^k.
    while factors := [
        (abs(found.value or 0.0) / found.limit) ** (1 / orders[found.kind])
        for found in rate_violations(motion, robot, limits)
        if found.kind in orders and found.limit
    ]:
        slower *= max(factors) * _EXTRA_SLOWDOWN
        motion = replace(motion, times=motion.times * max(factors) * _EXTRA_SLOWDOWN)
    return motion, v / slower


def _composed(along: Motion, first: float, last: float, v: float, ramp: float) -> Iterator[tuple[float, FloatArray]]:
    """Yield durations [s] and coefficients (d + 1, n) of the pieces of q(s(t)) between two stops of the curve."""
    length = last - first
    up = v * ramp / 2  # [m] of a ramp
    laws = [
        (first, ramp, np.array([0.0, 0.0, 0.0, v * ramp, -v * ramp / 2])),
        (first + up, (length - 2 * up) / v, np.array([0.0, length - 2 * up])),
        (last - up, ramp, np.array([0.0, v * ramp, 0.0, -v * ramp, v * ramp / 2])),
    ]
    for begin, duration, law in laws:
        if duration <= 1e-9:
            continue
        knots = along.times[(along.times > begin + 1e-9) & (along.times < begin + law.sum() - 1e-9)]
        cuts = [0.0, *(_time_of(law, float(s) - begin) for s in knots), 1.0]
        for a, b in pairwise(cuts):
            middle = begin + np.polynomial.polynomial.polyval((a + b) / 2, law)
            j = int(np.clip(np.searchsorted(along.times, middle) - 1, 0, along.pieces - 1))
            # The time law on [a, b] as a polynomial in u, relative to the knot before and scaled by the knot spacing.
            local = polynomials.restricted(law[:, None], a, b)[:, 0]
            local[0] += begin - along.times[j]
            local /= along.times[j + 1] - along.times[j]
            power, piece = np.ones(1), np.zeros((3 * (len(local) - 1) + 1, along.n))
            for c in along.coefficients[j]:
                piece[: len(power)] += power[:, None] * c
                power = np.convolve(power, local)
            yield (b - a) * duration, piece


def _time_of(law: FloatArray, s: float) -> float:
    """Return τ in [0, 1] with law(τ) = s for an increasing law, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        if np.polynomial.polynomial.polyval(middle, law) < s:
            low = middle
        else:
            high = middle
    return (low + high) / 2
