"""The cost functional of a path: length, and densities such as danger along it; with the exact gradient."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.danger.field import DangerField
from safe_ompl.inputs import number
from safe_ompl.paths.curve import Curve
from safe_ompl.robot.robot import Robot

STEP = 0.05  # [rad] between the samples of the cost of a path, as in its report
WEIGHT = 5.0  # of danger against length
_REFERENCE_SAMPLES = 64

_TINY = 1e-12  # [rad]
_SHORT = 0.1  # shorter segments than this share of the mean count as such a share
_OFFSET = 0.5 / np.sqrt(3.0)
_NODES = np.array([0.5 - _OFFSET, 0.5 + _OFFSET])  # Gauss' rule on each segment: exact to the third order


class Density(Protocol):
    """Cost of a radian of path at a configuration."""

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the density (B,) at `Q: (B, n)`."""

    def values_and_gradients(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the density (B,) and its gradients (B, n) at `Q: (B, n)`."""

    def bends(self, Q: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return rows (C,) of `Q: (B, n)` and vectors v (C, n): the density bends there like Σ vvᵀ, or more."""


class DangerDensity:
    """λ·CDF(q)ᵖ with λ = weight/reference(CDF)ᵖ, so that one weight serves all robots and scenes.

    Parameters
    ----------
    field : DangerField
        The danger.
    reference : float
        The danger at which a radian of path costs `weight` radians of length.
    weight : float
        Of danger against length, ≥ 0.
    exponent : float
        p ≥ 1. Larger ones punish peaks.

    Raises
    ------
    InputError
        If a number is out of range.
    """

    def __init__(
        self, field: DangerField, reference: float, weight: float = WEIGHT, exponent: float = 1.0
    ) -> None:
        self.field = field
        self.reference = number("reference", reference, above=0.0)
        self.weight = number("weight", weight, at_least=0.0)
        self.exponent = number("exponent", exponent, at_least=1.0)
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def __repr__(self) -> str:
        return (
            f"DangerDensity({self.field!r}, {self.reference:g}, weight={self.weight:g}, "
            f"exponent={self.exponent:g})"
        )

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the density (B,) at `Q: (B, n)`."""
        return self._of(self.field.values(Q) / self.reference)

    def values_and_gradients(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the density (B,) and its gradients (B, n) at `Q: (B, n)`."""
        danger, slopes = self._evaluated(Q)
        relative = danger / self.reference
        rates = self.weight * self.exponent * relative ** (self.exponent - 1) / self.reference
        return self._of(relative), rates[:, None] * slopes

    def bends(self, Q: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return rows (C,) of `Q: (B, n)` and vectors v (C, n): the density bends there like Σ vvᵀ."""
        if self.exponent == 1:
            return np.zeros(0, dtype=np.intp), np.zeros((0, Q.shape[1]))
        danger, slopes = self._evaluated(Q)
        relative = danger / self.reference
        bend = self.weight * self.exponent * (self.exponent - 1) * relative ** (self.exponent - 2)
        return np.arange(len(Q)), np.sqrt(bend)[:, None] * slopes / self.reference

    def restricted(self, field: DangerField) -> DangerDensity:
        """Return the same density of another field, such as one of fewer danger points."""
        return DangerDensity(field, self.reference, self.weight, self.exponent)

    def _evaluated(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return danger and gradients at `Q: (B, n)`; asked for the same again, it remembers."""
        if self._last is None or not np.array_equal(self._last[0], Q):
            self._last = Q.copy(), *self.field.values_and_gradients(Q)
        return self._last[1:]

    def _of(self, relative: FloatArray) -> FloatArray:
        density: FloatArray = self.weight * relative**self.exponent
        return density


def reference_danger(field: DangerField, checker: CollisionChecker) -> float:
    """Return the median danger over valid configurations, the scale of robot and scene; 1 if nothing is dangerous."""
    samples = _configurations(checker.robot)
    valid = samples[[not checker.in_collision(q) for q in samples]]
    return float(np.median(field.values(valid if len(valid) else samples))) or 1.0


def _configurations(robot: Robot) -> FloatArray:
    rng = np.random.default_rng(0)  # always the same: the scale belongs to robot and scene
    return rng.uniform(robot.lower, robot.upper, (_REFERENCE_SAMPLES, robot.n))


class PathCost:
    """J = ∫ (1 + Σ density(q(s))) ds over a path's arc length in joint space.

    Parameters
    ----------
    robot : Robot
        Whose joints move.
    densities : sequence of Density
        What a radian of path costs besides its length.
    """

    def __init__(self, robot: Robot, densities: Sequence[Density]) -> None:
        self.robot = robot
        self.densities = tuple(densities)

    def __repr__(self) -> str:
        return f"PathCost({self.robot!r}, {list(self.densities)!r})"

    def of(self, path: FloatArray, step: float = STEP) -> float:
        """Return J of a path (N, n), by the trapezoidal rule on samples at most `step` apart [rad]."""
        curve = Curve(self.robot, path)
        s = np.linspace(0.0, curve.length, 2 + int(curve.length / step))
        return float(np.trapezoid(self._total(curve.at(s)), s))

    def of_edges(self, starts: FloatArray, ends: FloatArray, samples: IntArray) -> FloatArray:
        """Return J (E,) of motions from `starts` to `ends: (E, n)`, by the midpoint rule on `samples: (E,)` each."""
        deltas = self.robot.difference(starts, ends)
        edge = np.repeat(np.arange(len(samples)), samples)
        first = np.concatenate([[0], np.cumsum(samples)[:-1]])
        t = (np.arange(len(edge)) - first[edge] + 0.5) / samples[edge]
        total = self._total(starts[edge] + t[:, None] * deltas[edge])
        costs: FloatArray = np.add.reduceat(total, first) / samples * np.linalg.norm(deltas, axis=1)
        return costs

    def value_and_gradient(self, path: FloatArray) -> tuple[float, FloatArray]:
        """Return J with two Gauss points on each segment of an unrolled path (N, n), and its exact gradient (N, n).

        Of a segment Δ from x of length ℓ = ‖Δ‖ with nodes t_j it is ℓ·mean_j f(x + t_jΔ); the gradients are
        mean f·Δ/ℓ + ℓ·mean_j t_j∇f with respect to its end, −mean f·Δ/ℓ + ℓ·mean_j (1−t_j)∇f to its start.
        """
        deltas = path[1:] - path[:-1]
        lengths = np.sqrt(np.einsum("ij,ij->i", deltas, deltas))
        values, slopes = self._total_and_gradients(self.nodes(path))
        means = values.reshape(-1, 2).mean(axis=1)
        slopes = slopes.reshape(len(deltas), 2, -1)
        slopes *= 0.5 * lengths[:, None, None]
        pull = (means / np.maximum(lengths, _TINY))[:, None] * deltas
        gradient = np.zeros_like(path)
        gradient[1:] += pull + slopes[:, 0] * _NODES[0] + slopes[:, 1] * _NODES[1]
        gradient[:-1] += slopes[:, 0] * _NODES[1] + slopes[:, 1] * _NODES[0] - pull
        return float(lengths @ means), gradient

    def curvature(self, path: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return about the Hessian of `value_and_gradient`'s J: blocks (N, n, n), and (N − 1, n, n) beside them.

        Length resists bending like springs, Σ f/2ℓ·‖x_{k+1} − x_k‖² with the path's mean density f. What the
        densities add is their Gauss-Newton part; so the whole is positive.
        """
        count, n = path.shape
        lengths = np.linalg.norm(path[1:] - path[:-1], axis=1)
        mean = self.value_and_gradient(path)[0] / max(lengths.sum(), _TINY)
        stiffness = mean / np.maximum(lengths, max(_SHORT * lengths.mean(), _TINY))
        blocks, beside = np.zeros((count, n, n)), np.zeros((count - 1, n, n))
        joint = np.arange(n)
        blocks[:-1, joint, joint] += stiffness[:, None]
        blocks[1:, joint, joint] += stiffness[:, None]
        beside[:, joint, joint] -= stiffness[:, None]
        Q = self.nodes(path)
        for density in self.densities:
            rows, vectors = density.bends(Q)
            segment, t = rows // 2, _NODES[rows % 2][:, None, None]
            squares = 0.5 * lengths[segment, None, None] * vectors[:, :, None] * vectors[:, None, :]
            np.add.at(blocks, segment, (1 - t) ** 2 * squares)
            np.add.at(blocks, segment + 1, t**2 * squares)
            np.add.at(beside, segment, t * (1 - t) * squares)
        return blocks, beside

    def nodes(self, path: FloatArray) -> FloatArray:
        """Return the Gauss points (2N − 2, n) of the segments of a path (N, n)."""
        Q: FloatArray = path[:-1, None] + _NODES[:, None] * (path[1:] - path[:-1])[:, None]
        return Q.reshape(-1, path.shape[1])

    def _total(self, Q: FloatArray) -> FloatArray:
        total = np.ones(len(Q))
        for density in self.densities:
            total += density.values(Q)
        return total

    def _total_and_gradients(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        total, slopes = np.ones(len(Q)), np.zeros(Q.shape)
        for density in self.densities:
            values, gradients = density.values_and_gradients(Q)
            total += values
            slopes += gradients
        return total, slopes
