"""Prove that the tip stays within a tolerance of a tool path at all times (`docs/how-it-works.md` §10)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, IntArray, Section, documents, key, number, polynomials
from safe_ompl.motions import Motion
from safe_ompl.robot import Robot, Tip
from safe_ompl.tasks.tool_path import ToolPath

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
# The proof stops if an interval is shorter than this share of the shortest polynomial piece of the motion.
_LEAST_INTERVAL = 1e-6
# The margin for rounding errors of the forward kinematics.
_KINEMATICS_ROUNDING = 1e-9  # [m and rad]
# The proof stops if more intervals than this are undecided.
_MOST_INTERVALS = 200_000


@dataclass(frozen=True)
class Corridor(Section):
    """Tolerances of the tip's pose about a tool path, at all times.

    Parameters
    ----------
    position : float
        Largest distance of the tip from the curve point with the same parameter [m].
    angle : float
        Largest rotation angle between the frames of tip and curve [rad]. With a free axis: the angle between the axes.
    free_axis : {"x", "y", "z"}, optional
        Axis of the tip's frame about which the tip may turn freely.

    Raises
    ------
    InputError
        If a tolerance is not positive, the angle is above π, or the axis is not "x", "y" or "z".

    Examples
    --------
    >>> Corridor(position=0.001, angle=0.01, free_axis="z").free_axis
    'z'
    """

    position: float = key(number, default=0.001, above=0.0)
    angle: float = key(number, default=0.01, above=0.0, at_most=np.pi)
    free_axis: str | None = key(documents.one_of, default=None, known=_AXES)

    @property
    def axis(self) -> FloatArray | None:
        """The free axis (3,) in the frame of the tip."""
        return None if self.free_axis is None else np.array(_AXES[self.free_axis])


@dataclass(frozen=True)
class CorridorProof:
    """Result of `prove_corridor`.

    Attributes
    ----------
    proven : bool
        The tip is in the corridor at all times.
    position, angle : float
        If proven: upper bounds of the deviations [m, rad]. Else: the largest deviations at the ends of the intervals
        that were checked last, with the margins for errors.
    at : float or None
        Curve parameter [m] at which the tip is outside or the proof failed; None if proven.
    outside : bool
        Whether the tip is outside the corridor at `at`.
    """

    proven: bool
    position: float
    angle: float
    at: float | None = None
    outside: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Return the proof as a dict of plain values."""
        return {key: getattr(self, key) for key in ("proven", "position", "angle", "at", "outside")}


def prove_corridor(motion: Motion, robot: Robot, path: ToolPath, corridor: Corridor) -> CorridorProof:
    """Prove that the tip stays in a corridor about a curve at all times of a motion.

    p(s) is the tip's position and c(s) the curve. R_i is the largest distance of the tip from the axis of joint i if
    the joint is revolute, and 1 if it is prismatic. On an interval of length h of a polynomial motion
    ‖p″‖ ≤ A = Σ R_i |q″_i| + Σ R_ij |q′_i||q′_j|. R_ij is R of the more distal joint of i and j, or 0 if the more
    proximal joint is prismatic. The error of linear interpolation of p − c is at most (A + ‖c″‖) h²/8. The norm of the
    interpolant is convex, so its maximum is at an end of the interval.

    For orientations, each parameter is at most h/2 from the nearer end of the interval. So the angle is at most its
    value at this end, plus h/2 times its rate there, plus h²/8 times a bound of the derivative of the rate. With the
    angular velocities ω of the tip and ω_c of the curve, this bound is Σ |q″_i| + Σ |q′_i||q′_j| + ‖ω_c′‖. The sums are
    over the revolute joints and over the pairs of revolute joints. With a free axis, the rate is the norm of the part
    of ω − ω_c perpendicular to the axis. The axis rotates with ω, which adds Σ |q′_i| (Σ |q′_i| + ‖ω_c‖) to the bound.

    Parameters
    ----------
    motion : Motion
        Motion of the robot's joints, in the robot's order. `motion.times` are parameters of the curve [m].
    robot : Robot
    path : ToolPath
        The tool path to follow.
    corridor : Corridor
        Tolerances.
    """
    return _Proof(motion, Tip(robot, corridor.axis), path, corridor).result()


class _Proof:
    """The proof for one motion.

    Intervals are given by their begins and their ends, arrays `begins` and `ends` (I,) of curve parameters [m].
    """

    def __init__(self, motion: Motion, tip: Tip, path: ToolPath, corridor: Corridor) -> None:
        self._motion, self._tip, self._path, self._corridor = motion, tip, path, corridor
        # Indices of the joints that move the tip, from the base to the tip.
        tip_joints, robot = tip.order, tip.robot
        self._tip_joints, self._robot = tip_joints, robot
        radii, slides = robot.bounds.tip_radii[tip_joints], robot.joint_prismatic[tip_joints]
        distal = np.maximum(np.arange(len(tip_joints))[:, None], np.arange(len(tip_joints)))
        proximal = np.minimum(np.arange(len(tip_joints))[:, None], np.arange(len(tip_joints)))
        self._radii, self._revolute = radii, ~slides
        self._pair_radii = np.where(slides[proximal], 0.0, radii[distal])
        both = self._revolute[:, None] & self._revolute
        # The bound of the angular acceleration needs each pair of revolute joints once, but the sum over i and j has
        # each pair twice.
        self._revolute_pairs = 0.5 * (both & ~np.eye(len(tip_joints), dtype=bool))
        # `coupling.reach` converts bounds of the planned joints to bounds of all joints of the model.
        allowance = robot.coupling.reach(motion.allowance)[:, tip_joints]
        self._slack = allowance @ radii + _KINEMATICS_ROUNDING, allowance @ self._revolute + _KINEMATICS_ROUNDING
        self._derivatives = motion.derivative_coefficients(1), motion.derivative_coefficients(2)

    def result(self) -> CorridorProof:
        motion, path = self._motion, self._path
        cuts = np.union1d(motion.times, path.knots)
        cuts = cuts[(cuts >= motion.times[0]) & (cuts <= motion.times[-1])]
        begins, ends = cuts[:-1], cuts[1:]
        wide = ends - begins > 1e-12
        begins, ends = begins[wide], ends[wide]
        floor = _LEAST_INTERVAL * float(np.diff(motion.times).min())
        position = angle = 0.0
        while len(begins):
            end_deviations, rates = self._end_deviations(begins, ends)
            worst = np.maximum(end_deviations[0] - self._corridor.position, end_deviations[1] - self._corridor.angle)
            if (worst > 0).any():
                k = np.unravel_index(worst.argmax(), worst.shape)
                at = float((begins, ends)[k[0]][k[1]])
                return CorridorProof(
                    False, float(end_deviations[0].max()), float(end_deviations[1].max()), at, outside=True
                )
            apart, turned = self._bounds(begins, ends, end_deviations, rates)
            # The comparisons are negated so that an interval with NaN remains undecided.
            open_ = ~((apart <= self._corridor.position) & (turned <= self._corridor.angle))
            position = max(position, float(apart[~open_].max(initial=0.0)))
            angle = max(angle, float(turned[~open_].max(initial=0.0)))
            begins, ends = begins[open_], ends[open_]
            if len(begins) and ((ends - begins).min() < floor or len(begins) > _MOST_INTERVALS):
                at = float(begins[(ends - begins).argmin()])
                return CorridorProof(False, float(end_deviations[0].max()), float(end_deviations[1].max()), at)
            middle = (begins + ends) / 2
            begins, ends = np.concatenate([begins, middle]), np.concatenate([middle, ends])
        return CorridorProof(True, position, angle)

    def _pieces(self, begins: FloatArray, ends: FloatArray) -> IntArray:
        middle = (begins + ends) / 2
        return np.clip(np.searchsorted(self._motion.times, middle) - 1, 0, self._motion.pieces - 1)

    def _end_deviations(self, begins: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return deviations and bounds of the rate of the angle at the ends of the intervals.

        Deviations (2, 2, I): axis 0 is position or angle, axis 1 is begin or end of the interval, axis 2 is the
        interval. Rates (2, I): axis 0 is begin or end.
        """
        piece = self._pieces(begins, ends)
        times, spans = self._motion.times, np.diff(self._motion.times)
        deviations, rates = np.empty((2, 2, len(begins))), np.empty((2, len(begins)))
        # The curve is evaluated slightly inside the interval, so that at a corner the segment inside the
        # interval is used.
        inside = (ends - begins) * 1e-9
        for k, s in enumerate((begins, ends)):
            u = ((s - times[piece]) / spans[piece])[:, None]
            Q, Qd = (polynomials.values(held[piece], u) for held in (self._motion.coefficients, self._derivatives[0]))
            state = self._tip.at(Q)
            frames = self._path.at(s + inside if k == 0 else s - inside)
            errors = self._tip.errors(state, frames)
            deviations[0, k] = np.linalg.norm(errors[:, :3], axis=1) + inside * np.linalg.norm(
                frames.velocities, axis=1
            )
            deviations[1, k] = np.linalg.norm(errors[:, 3:], axis=1) + inside * np.linalg.norm(frames.spins, axis=1)
            drift = np.einsum("bxn,bn->bx", state.jacobians[:, 3:], Qd) - frames.spins
            if self._tip.free_axis is not None:
                axis = state.rotations @ self._tip.free_axis
                drift -= axis * np.einsum("bx,bx->b", axis, drift)[:, None]
            rates[k] = np.linalg.norm(drift, axis=1)
        deviations[0] += self._slack[0][piece]
        deviations[1] = np.minimum(np.pi, deviations[1] + self._slack[1][piece])
        return deviations, rates

    def _bounds(
        self, begins: FloatArray, ends: FloatArray, end_deviations: FloatArray, rates: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return upper bounds (I,) of the deviations of position [m] and angle [rad] on intervals."""
        piece, h = self._pieces(begins, ends), ends - begins
        times, spans = self._motion.times, np.diff(self._motion.times)
        u = (begins - times[piece]) / spans[piece], (ends - times[piece]) / spans[piece]
        # The factor and the summand cover rounding errors of the Bernstein coefficients.
        speed, joint_acceleration = (
            np.abs(polynomials.bernstein(polynomials.restricted(held[piece], *u))).max(axis=1) * (1 + 1e-9) + 1e-12
            for held in self._derivatives
        )
        bounds_of_model_joints = self._robot.coupling.reach
        speed = bounds_of_model_joints(speed)[:, self._tip_joints]
        joint_acceleration = bounds_of_model_joints(joint_acceleration)[:, self._tip_joints]
        curvature, curve_angular_acceleration = self._path.second_derivative_bounds(begins, ends)
        acceleration = joint_acceleration @ self._radii + np.einsum("bi,ij,bj->b", speed, self._pair_radii, speed)
        apart = end_deviations[0].max(axis=0) + (acceleration + curvature) * h**2 / 8
        angular_speed = speed @ self._revolute
        angular_acceleration_bound = joint_acceleration @ self._revolute + np.einsum(
            "bi,ij,bj->b", speed, self._revolute_pairs, speed
        )
        angular_acceleration_bound += curve_angular_acceleration
        if self._tip.free_axis is not None:
            curve_angular_speed = (
                np.maximum(*(np.linalg.norm(self._path.at(s).spins, axis=1) for s in (begins, ends)))
                + curve_angular_acceleration * h
            )
            angular_acceleration_bound += angular_speed * (angular_speed + curve_angular_speed)
        turned = (end_deviations[1] + h / 2 * rates).max(axis=0) + angular_acceleration_bound * h**2 / 8
        return apart, np.minimum(np.pi, turned)
