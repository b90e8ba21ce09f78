"""The danger of a path and of a timed motion, computed from its definition to check the claims of certificates.

A timed motion has KDF = k₁φ + k₂(φ′ + γI)ṡ for each link, with φ = ∫dt/‖ρ‖, φ′ = ∫ρ·x′/‖ρ‖³ dt and I = ∫‖x′‖/‖ρ‖² dt
over its points x, ρ = p − x, x′ by arc length of the curve. In half an interval h, with ‖x′‖ ≤ V and ‖x″‖ ≤ A, every
point of the link stays at least R = D − Vh away from p, where D is the distance in the middle. Then φ ≤ U = φD/R, and
as ‖ρ‖ ≥ R

    |φ″| ≤ B,  |I′| ≤ B,  B = U(2V²/R² + A/R);    φ ≤ φ + h|φ′| + h²B/2,    φ′ + γI ≤ φ′ + γI + (1 + γ)hB

with the values of the middle on the right sides. ‖x′‖ is convex along a link, so it is below its chords over parts of
the link, for which ∫(c₀ + c₁t)/‖ρ‖² dt is elementary. Intervals and parts are halved together until the claim is
proven.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from safe_ompl.certificates.claims import ClaimedDanger, ClaimedMovingDanger, ClaimedStretch
from safe_ompl.certificates.verifier.bodies import Budget, PlainTool, acceleration_bound, joint_lines, joints_below
from safe_ompl.certificates.verifier.motion import RecordedLaw, RecordedPiece
from safe_ompl.common import CertificateError, FloatArray, IntArray, within
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_SUM_ROUNDING = 1e-6
# Intervals in which no key point moves farther are not divided.
_LEAST_POINT_MOTION = 1e-5  # [m]
# Intervals in which no joint moves more are not divided.
_LEAST_STEP = 1e-7  # [rad or m]
_NEGLIGIBLE_LENGTH = 1e-12  # [m]
# Shorter intervals are not divided.
_SHORTEST_INTERVAL = 1e-7  # [rad]
_PARTS, _MOST_PARTS = 4, 256  # of a link
# Shorter links are treated as points.
_POINT_LIKE_LENGTH = 1e-6  # [m]


class PlainDanger:
    """The danger of a robot in a scene, link by link by eq. (4) as 2/ℓ·atanh(ℓ/S), with bounds of its growth.

    If no end of a link moves more than δ, and δ is less than its distance D from a danger point, its field there grows
    at most by the factor D/(D − δ). There is at least one danger point, (M, 3).
    """

    def __init__(self, robot: Robot, scene: Scene, claim: ClaimedDanger, budget: Budget) -> None:
        self._robot, self._claim, self._budget = robot, claim, budget
        self._data = robot.shared.model.createData()
        # This call raises an error if the spacing gives too many points.
        with within("danger"):
            self.points, self.weights, _ = scene.danger_points(claim.spacing)
        if not len(self.points):
            self.points, self.weights = np.full((1, 3), 1e9), np.ones(1)

    def exceeded(self, piece: RecordedPiece, limit: float) -> tuple[float, float] | None:
        """Return the share of a piece at which a danger limit is not proven, and the danger there, or None."""
        steps, tube = piece.steps, piece.width
        waiting = [(0.5, 0.5)]
        while waiting:
            centre, half = waiting.pop()
            value, bound, moved = self._bounded(piece.at(piece.length * centre), half * steps + tube)
            if bound <= limit * (1 + _SUM_ROUNDING):
                continue
            if value > limit * (1 + _SUM_ROUNDING) or moved < _LEAST_POINT_MOTION or half * steps.max() < _LEAST_STEP:
                return centre, value
            waiting += [(centre + half / 2, half / 2), (centre - half / 2, half / 2)]
        return None

    def _bounded(self, q: FloatArray, steps: FloatArray) -> tuple[float, float, float]:
        """Return the danger at `q`, its bound within `steps` of the joints, and the largest motion of key points."""
        self._budget.spend()
        robot, points = self._robot, self.points
        keypoints = robot.keypoints(q)
        moved = self._moved(q, keypoints, steps)
        start, end = (keypoints[robot.segments[:, side], None] for side in (0, 1))  # (L, 1, 3)
        link = end - start
        length = _norm(link)  # (L, 1)
        along = np.clip(
            np.einsum("lmi,lni->lm", points - start, link) / np.maximum(length**2, _NEGLIGIBLE_LENGTH), 0.0, 1.0
        )
        distance = _norm(points - start - along[..., None] * link)  # (L, M)
        ends = np.maximum(_norm(points - start) + _norm(points - end), _NEGLIGIBLE_LENGTH)
        share = np.minimum(length / ends, 1 - 1e-15)
        field = np.where(length > 1e-6, 2 * np.arctanh(share) / np.maximum(length, _NEGLIGIBLE_LENGTH), 2 / ends)
        least = distance - moved[robot.segments].max(axis=1)[:, None]
        grown = np.where(least > 0, field * distance / np.where(least > 0, least, 1.0), np.inf)
        if self._claim.weighting == "length":
            slides = float(robot.coupling.reach(steps)[robot.joint_prismatic].sum())
            field, grown = field * length, grown * (length + slides)
        return self.aggregated(field.sum(axis=0)), self.aggregated(grown.sum(axis=0)), float(moved.max())

    def _moved(self, q: FloatArray, keypoints: FloatArray, steps: FloatArray) -> FloatArray:
        """Return the largest motion [m] of each key point (K,) while the joints move by `steps` from `q`."""
        robot = self._robot
        pin.forwardKinematics(robot.shared.model, self._data, robot.pinocchio_configuration(q))
        axes, origins = joint_lines(robot, self._data)
        across = np.cross(axes, keypoints[:, None] - origins)  # (K, m, 3)
        radii = np.where(robot.joint_prismatic, 1.0, _norm(across)) * robot.joint_keypoint_support
        return np.asarray(radii @ robot.coupling.reach(steps))

    def aggregated(self, fields: FloatArray) -> float:
        """Return the danger for fields of the robot at all danger points, `fields: (M,)`, without k₁ and weights."""
        levels = self._claim.k1 * self.weights * fields
        if self._claim.aggregate == "max":
            return float(levels.max())
        if self._claim.aggregate == "mean":
            return float(levels.mean())
        top, sharpness = float(levels.max()), self._claim.sharpness
        if not np.isfinite(top):
            return top
        return top + float(np.log(np.exp(sharpness * (levels - top)).sum())) / sharpness


def check_danger_and_tool(
    claims: ClaimedStretch, robot: Robot, scene: Scene, pieces: Iterable[RecordedPiece], budget: Budget
) -> None:
    """Raise CertificateError unless the claims about danger and tool hold on all pieces of a motion."""
    danger = None if claims.danger is None else PlainDanger(robot, scene, claims.danger, budget)
    tool = None if claims.tool is None else PlainTool(robot, claims.tool, budget)
    for piece in pieces:
        budget.where = f"danger and tool of {piece.name}"
        if danger is not None and claims.danger is not None:
            high = danger.exceeded(piece, claims.danger.bound)
            if high is not None:
                words = f"danger {high[1]:.4f} near {high[0]:.6f} of it, {claims.danger.bound:.4f} is claimed"
                raise CertificateError(f"{piece.name}: {words}")
        lost = None if tool is None else tool.exceeded(piece)
        if lost is not None:
            words = f"the {lost[1]} of the tool is not as claimed near {lost[0]:.6f} of it"
            raise CertificateError(f"{piece.name}: {words}")


class _MovingInterval(NamedTuple):
    """The motion of key points (K) and links (L) in an interval of a curve: values at its middle, and bounds."""

    half: float
    places: FloatArray
    velocities: FloatArray
    speeds: FloatArray  # (L,) V
    accelerations: FloatArray  # (L,) A
    # Bound of the speed at which a link becomes longer.
    strokes: float


class PlainMovingDanger:
    """The danger of a moving robot in a scene, of the claimed kind."""

    def __init__(self, robot: Robot, scene: Scene, claim: ClaimedMovingDanger, budget: Budget) -> None:
        self._robot, self._claim, self._budget = robot, claim, budget
        self._still = PlainDanger(robot, scene, claim, budget)
        self._model, self._data = robot.shared.model, robot.shared.model.createData()
        self._ends = robot.segments.T
        self._carriers = [int(np.flatnonzero(row).max(initial=-1)) + 1 for row in robot.joint_keypoint_support]
        self._gamma = claim.gamma

    def exceeded(self, law: RecordedLaw) -> float | None:
        """Return the arc length [rad] at which the bound of the danger is not proven, or None."""
        for j, number in enumerate(law.of):
            piece, start = law.pieces[number], law.starts[number]
            cell = float(law.edges[j]) - start, float(law.edges[j + 1]) - start
            waiting = [(*cell, _PARTS, np.arange(len(self._still.points)))]
            while waiting:
                self._budget.spend()
                first, last, parts, points = waiting.pop()
                middle = (first + last) / 2
                rates = law.rates_between(j, start + first, start + last)
                interval = self._interval(piece, middle, (last - first) / 2)
                points = self._above(interval, rates, points, 0)
                if len(points):
                    points = self._above(interval, rates, points, parts)
                if not len(points):
                    continue
                if last - first < _SHORTEST_INTERVAL:
                    return start + middle
                finer = min(2 * parts, _MOST_PARTS)
                waiting += [(first, middle, finer, points), (middle, last, finer, points)]
        return None

    def _above(self, interval: _MovingInterval, rates: tuple[float, float], points: IntArray, parts: int) -> IntArray:
        """Return the danger points for which the bound is not proven. For a sum, all points or none are returned."""
        claim, still = self._claim, self._still
        levels, coefficients = self._bounds(interval, still.points[points], parts)
        limit = claim.bound * (1 + _SUM_ROUNDING)
        # Where a point may be reached, the product is 0·∞. The result NaN is replaced by infinity.
        with np.errstate(invalid="ignore"):
            fields = [claim.k1 * levels + claim.k2 * rate * coefficients for rate in rates]
        fields = [np.where(np.isnan(field), np.inf, field) for field in fields]
        if claim.aggregate == "max":
            return points[still.weights[points] * np.maximum(*fields) > limit]
        above = max(still.aggregated(field) for field in fields) > limit
        return points if above else points[:0]

    def _bounds(self, interval: _MovingInterval, points: FloatArray, parts: int) -> tuple[FloatArray, FloatArray]:
        """Return bounds (M,) of φ and of φ′ + γI in an interval. Without parts, only the distances are used."""
        h, V, A = interval.half, interval.speeds[:, None], interval.accelerations[:, None]
        a, b = (interval.places[side, None] for side in self._ends)
        w = b - a
        length = _norm(w)  # (L, 1)
        u, v = points - a, points - b
        t = np.clip((u * w).sum(axis=2) / np.maximum(length**2, _NEGLIGIBLE_LENGTH**2), 0.0, 1.0)
        away = _norm(u - t[..., None] * w)  # (L, M)
        least = away - V * h
        near = np.where(least > 0, least, np.nan)
        field = most = 1 / near
        swift = (1 + self._gamma) * most * V / near
        if parts:
            phi, rate = _static(u, v, w, length, *(interval.velocities[side] for side in self._ends))
            most = np.minimum(most, phi * away / near)
            curved = most * (2 * V * V / near**2 + A / near)
            field = np.minimum(most, phi + h * np.abs(rate) + h * h * curved / 2)
            spread = self._gamma * self._isotropic(interval, u, w, away, length, parts) if self._gamma else 0.0
            exact = rate + spread + (1 + self._gamma) * h * curved
            swift = np.minimum((1 + self._gamma) * most * V / near, exact)
        if self._claim.weighting == "length":
            longest, shortest = length + interval.strokes * h, np.maximum(length - interval.strokes * h, 0.0)
            field, swift = longest * field, swift * np.where(swift > 0, longest, shortest)
        level, coefficient = field.sum(axis=0), swift.sum(axis=0)
        reached = np.isnan(level)
        return np.where(reached, np.inf, level), np.where(reached, np.inf, coefficient)

    def _isotropic(
        self, interval: _MovingInterval, u: FloatArray, w: FloatArray, away: FloatArray, length: FloatArray, parts: int
    ) -> FloatArray:
        """Return a bound (L, M) of ∫‖x′‖/‖ρ‖² dt, with chords of ‖x′‖ over parts of the links."""
        t = np.linspace(0.0, 1.0, parts + 1)
        va, vb = (interval.velocities[side][:, None] for side in self._ends)
        speeds = _norm((1 - t)[:, None] * va + t[:, None] * vb)[:, None]  # (L, 1, parts+1)
        squared = np.maximum(length**2, _POINT_LIKE_LENGTH**2)
        # The point of the link's line that is nearest to p, and its distance from p, in lengths of the link.
        s = ((u * w).sum(axis=2) / squared)[..., None]
        h = np.maximum(_norm(np.cross(u, w)) / squared, _NEGLIGIBLE_LENGTH)[..., None]
        slope = np.diff(speeds, axis=2) * parts
        at_nearest = speeds[..., :-1] + slope * (s - t[:-1])
        x, y = t[:-1] - s, t[1:] - s
        logs = 0.5 * np.log((y * y + h * h) / (x * x + h * h))
        angles = np.arctan2(h * (y - x), h * h + x * y)
        found: FloatArray = (slope * logs + at_nearest / h * angles).sum(axis=2) / squared
        return np.where(
            length > _POINT_LIKE_LENGTH, found, speeds.max(axis=2) / np.maximum(away, _NEGLIGIBLE_LENGTH) ** 2
        )

    def _interval(self, piece: RecordedPiece, middle: float, half: float) -> _MovingInterval:
        robot, model = self._robot, self._model
        q, coupling = piece.at(middle), robot.coupling
        places = robot.keypoints(q)
        pin.forwardKinematics(model, self._data, robot.pinocchio_configuration(q))
        axes, origins = joint_lines(robot, self._data)
        motions = coupling.motions(piece.at(middle, 1))[:, None] * axes
        turned = np.where(robot.joint_prismatic[:, None], motions, np.cross(motions, places[:, None] - origins))
        velocities, accelerations = np.einsum("km,kmx->kx", robot.joint_keypoint_support, turned), np.zeros(len(places))
        steps = coupling.reach(piece.most(1))
        slid = np.abs(coupling.values(q)) + half * steps
        for k, carrier in enumerate(self._carriers):
            if movers := joints_below(robot, carrier):
                length = float(np.linalg.norm(places[k] - origins[carrier - 1]))
                accelerations[k] = acceleration_bound(robot, movers, length, steps, coupling.reach(piece.most(2)), slid)
        speeds = _norm(velocities) + half * accelerations
        both = [np.maximum(*(of[side] for side in self._ends)) for of in (speeds, accelerations)]
        strokes = float(steps[robot.joint_prismatic].sum())
        return _MovingInterval(half, places, velocities, both[0], both[1], strokes)


def _static(
    u: FloatArray, v: FloatArray, w: FloatArray, length: FloatArray, va: FloatArray, vb: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return φ = 2/ℓ·atanh(ℓ/S) (L, M), and φ′ = ∂φ/∂a·x′_a + ∂φ/∂b·x′_b."""
    d1, d2 = np.maximum(_norm(u), _NEGLIGIBLE_LENGTH), np.maximum(_norm(v), _NEGLIGIBLE_LENGTH)
    along, product, S = (u * v).sum(axis=2), d1 * d2, d1 + d2
    across = _norm(np.cross(u, v)) ** 2 / np.maximum(product - along, _NEGLIGIBLE_LENGTH**2)
    half = np.maximum(np.where(along >= 0, product + along, across), _NEGLIGIBLE_LENGTH**2)  # (S² − ℓ²)/2
    short = length <= _POINT_LIKE_LENGTH
    safe = np.where(short, 1.0, length)
    phi = np.where(short, 2 / S, np.log1p(safe * (S + safe) / half) / safe)
    kappa = np.where(short, 4 / (3 * S**3), (S / half - phi) / safe**2)
    towards = (u * va[:, None]).sum(axis=2) / d1 + (v * vb[:, None]).sum(axis=2) / d2
    return phi, towards / half + kappa * (w[:, 0] * (vb - va)).sum(axis=1)[:, None]


def _norm(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))
