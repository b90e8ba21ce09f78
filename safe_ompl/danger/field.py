"""Danger of a configuration: the danger field of the robot, evaluated at the danger points."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import (
    BoolArray,
    Counts,
    FloatArray,
    InputError,
    IntArray,
    Section,
    configuration,
    configurations,
    documents,
    finite_array,
    key,
    number,
)
from safe_ompl.danger import link_field, static
from safe_ompl.danger.link_field import DangerPoints
from safe_ompl.robot import Robot, plain
from safe_ompl.scene import Scene

Aggregate: TypeAlias = Literal["max", "mean", "softmax"]
AGGREGATES: tuple[Aggregate, ...] = ("max", "mean", "softmax")
# Default of k₂/k₁, from the code of the authors of the field.
_LEAD = 0.25  # [s]


@dataclass(frozen=True)
class DangerKind(Section):
    """Options of `DangerField` that define the kind of danger."""

    aggregate: Aggregate = key(documents.one_of, default="max", known=AGGREGATES)
    weighting: link_field.Weighting = key(documents.one_of, default="unit", known=link_field.WEIGHTINGS)
    k1: float = key(number, default=1.0, above=0.0)
    sharpness: float = key(number, default=10.0, above=0.0)
    k2: float | None = key(number, default=None, at_least=0.0)
    gamma: float = key(number, default=1.0, at_least=0.0)


class DangerField:
    """Cumulative danger field of a robot at danger points, CDF(q) = aggregate_m w_m CDF(p_m; q) (paper §3).

    The field of the robot at a point is the sum over its links of k₁ ∫ dt/‖p − r_t‖, eq. (5)–(7). The danger of a
    configuration is the maximum of the field over the danger points, as in the paper, or a mean.

    Parameters
    ----------
    robot : Robot
        Provides the key points and segments of the skeleton.
    points : array_like, shape (M, 3)
        Danger points in the world frame [m]. Without points the danger is zero everywhere.
    weights : array_like, shape (M,), optional
        Weight w > 0 of each point, the danger weight of its obstacle. Default: 1.
    counts : Counts, optional
        Counters of the evaluations.
    aggregate : {"max", "mean", "softmax"}
        With x_m = w_m CDF(p_m): the maximum; the mean; or the smooth (1/β) log Σ_m exp(β x_m), which exceeds the
        maximum by at most log(M)/β.
    weighting : {"unit", "length"}
        Every link has the same weight (eq. 4), or a weight in proportion to its length (eq. 1).
    k1 : float
        k₁ > 0 of the elementary field (6). The danger is in k₁/m with unit weighting, else in k₁. Default: 1.
    sharpness : float
        β > 0 of the softmax, in units of 1/danger. Large values approach the maximum. Default: 10.
    k2, gamma : float, optional
        k₂ ≥ 0 and γ ≥ 0 of the kinetostatic field of the robot in motion, see `KinetostaticField`.
        Default: k₁ · 0.25 s, and 1.

    Attributes
    ----------
    revision : int
        Number of moves of the danger points so far. Results of another revision belong to another scene.

    Raises
    ------
    InputError
        If the robot has no links, or a value is out of range, of the wrong shape, not finite or unknown.

    Notes
    -----
    Gradients are computed with fixed danger points. With "max" the gradient is that of the most dangerous point, which
    is a subgradient where two points tie. The maximum is exact: bounds in single precision only exclude points that
    cannot be the maximum.

    Queries from several threads are safe, also while one thread moves the field. The threads share the `counts`, which
    may then miss some evaluations.

    Examples
    --------
    >>> robot = Robot.from_example("ur5")
    >>> field = DangerField(robot, [[0.8, 0.0, 0.5]])
    >>> far, near = field.value([3.14, -1.2, 1.4, -1.8, -1.57, 0.0]), field.value([0.0, -1.2, 1.4, -1.8, -1.57, 0.0])
    >>> bool(far < near)
    True
    """

    def __init__(
        self,
        robot: Robot,
        points: ArrayLike,
        weights: ArrayLike | None = None,
        *,
        counts: Counts | None = None,
        **kind: Any,
    ) -> None:
        chosen = DangerKind(**kind)
        if not len(robot.segments) and np.size(points):
            raise InputError(
                f"{robot.name!r} has no link with a length, so it has no danger field; give a tip beyond its joints"
            )
        self.robot = robot
        self.aggregate, self.weighting, self.sharpness = chosen.aggregate, chosen.weighting, chosen.sharpness
        self.k1, self.gamma = chosen.k1, chosen.gamma
        self.k2 = _LEAD * self.k1 if chosen.k2 is None else chosen.k2
        self.counts = Counts() if counts is None else counts
        self.revision = 0
        self.links: IntArray = np.array(robot.segments, dtype=np.intp, order="C")
        tree, self._measure = robot.kinematics, (AGGREGATES.index(self.aggregate), self.sharpness)
        by_length = self.weighting == "length"
        self._skeleton = static.SkeletonTable(tree.link_end_table, tree.skeleton[1], by_length)
        self._scene: tuple[Scene, float | None] | None = None
        self._minimum: float | None = None
        self._take(DangerPoints(points, weights, self.k1))

    @classmethod
    def of_scene(cls, robot: Robot, scene: Scene, spacing: float | None = None, **options: Any) -> DangerField:
        """Return the field at the danger points of a scene (`Scene.danger_points`). `move` can move its points.

        `spacing` [m] is as for `Scene.danger_points`. The options are those of the class.
        """
        field = cls(robot, *scene.danger_points(spacing)[:2], **options)
        field._scene = scene, spacing
        field._take(field._points)
        return field

    @classmethod
    def of_options(
        cls, robot: Robot, scene: Scene, options: Mapping[str, Any], counts: Counts | None = None
    ) -> DangerField:
        """Return the field of a scene with a user's options, as `danger` of `SafeSetup`; InputError if one is bad."""
        if not isinstance(options, Mapping):
            raise InputError(f"danger must be a mapping of options, or None for no danger field, got {options!r}")
        with documents.within("danger"):
            documents.check_keys(options, ("spacing", *DangerKind.__dataclass_fields__))
        return cls.of_scene(robot, scene, counts=counts, **options)

    def move(self, scene: Scene) -> None:
        """Use the danger points of another scene, such as `Scene.moved`. The danger then equals that of a new field.

        Raises InputError if the field was not made by `of_scene`.
        """
        if self._scene is None:
            raise InputError("this field was made of points; only a field of DangerField.of_scene can follow a scene")
        before, spacing = self._scene
        dangerous = [[obstacle for obstacle in one if obstacle.weight > 0] for one in (before, scene)]
        self._scene = scene, spacing
        if dangerous[0] != dangerous[1] or scene.spacing != before.spacing:
            self._take(DangerPoints(*scene.danger_points(spacing)[:2], self.k1))
            self.revision += 1

    def _take(self, points: DangerPoints) -> None:
        """Set the danger points and derived data. Other threads see the old field or the new one."""
        self._points = points
        self._frozen = None if self._scene is None else self._at(points)

    def _at(self, points: DangerPoints) -> DangerField:
        """Return the field at other danger points, which never move."""
        other = copy.copy(self)
        other._points, other._scene, other._frozen = points, None, None
        other._minimum = None
        return other

    def frozen(self) -> DangerField:
        """Return the field at the present danger points, which do not change when this field moves.

        If several queries must use the same danger points, use the frozen field, because another thread may move this
        one.
        """
        return self if self._frozen is None else self._frozen

    def __repr__(self) -> str:
        return (
            f"DangerField({self.robot!r}, <{len(self.points)} points>, aggregate={self.aggregate!r}, "
            f"weighting={self.weighting!r}, k1={self.k1:g}, sharpness={self.sharpness:g})"
        )

    @property
    def points(self) -> FloatArray:
        """The danger points (M, 3) [m], read-only."""
        return self._points.points

    @property
    def weights(self) -> FloatArray | None:
        """The weights (M,) of the danger points, read-only; None if all are 1."""
        return self._points.weights

    @cached_property
    def factors(self) -> FloatArray | None:
        """Factors (L,) of the links' unit fields: 1, or the link length [m]; None if link lengths may change."""
        if self.weighting == "unit":
            return np.ones(len(self.links))
        if self.robot.joint_prismatic.any():
            return None
        start, end = self.robot.keypoints(np.zeros(self.robot.n))[self.links.T]
        lengths: FloatArray = np.linalg.norm(end - start, axis=-1)
        return lengths

    def point_danger(self, chosen: BoolArray | None = None) -> static.PointDanger:
        """Return the present danger as an object for compiled code. Without points the danger is zero.

        It includes all danger points, or those with `chosen: (M,)`. Its values and gradients use the joints of
        Pinocchio's model. The caller counts the evaluations.
        """
        table = self._points.table
        return static.PointDanger(self._skeleton, table if chosen is None else table.some(chosen), *self._measure)

    def count(self, configurations: int, points: int) -> None:
        """Count an evaluation of `points` danger points at each of `configurations` configurations."""
        self.counts.field_configurations += configurations
        self.counts.field_points += configurations * points

    def value(self, q: ArrayLike) -> float:
        """Return the danger CDF(q) at `q: (n,)`; +inf if a segment passes through a danger point.

        Raises InputError if `q` has the wrong shape or is not finite.
        """
        return float(self.values(self._single(q))[0])

    def values(self, Q: ArrayLike) -> FloatArray:
        """Return the danger (B,) at a batch of configurations `Q: (B, n)`; see `value`."""
        danger, values = self._asked(configurations(Q, self.robot.n))
        dangers: FloatArray = danger.values(values)
        return dangers

    def mean(self, start: ArrayLike, end: ArrayLike, tolerance: float = 0.01) -> float:
        """Return the mean danger ∫ CDF dt on the straight motion q(t) between two configurations (n,), 0 ≤ t ≤ 1.

        The mean is computed by Simpson's rule on pieces of at most 1 rad. The pieces are halved, at most six times,
        until the trapezoidal rule differs by less than the relative `tolerance` > 0. Errors as `value`.
        """
        number("tolerance", tolerance, above=0.0)
        ends, danger = np.concatenate([self._single(start), self._single(end)]), self.point_danger()
        if not len(danger.points):
            return 0.0
        delta = ends[1] - ends[0]
        panels = 1 + int(math.sqrt(delta.dot(delta)))
        mean: float
        mean, evaluations = danger.mean(plain(self.robot.coupling.values(ends)), panels, tolerance)
        self.count(evaluations, len(danger.points))
        return mean

    def gradient(self, q: ArrayLike) -> FloatArray:
        """Return ∇CDF(q), (n,), at `q: (n,)` [danger/rad or danger/m]; see the Notes of the class.

        Errors as `value`.
        """
        gradient: FloatArray = self.gradients(self._single(q))[0]
        return gradient

    def gradients(self, Q: ArrayLike) -> FloatArray:
        """Return the gradients (B, n) at a batch of configurations `Q: (B, n)`; see `gradient`."""
        return self.values_and_gradients(Q)[1]

    def values_and_gradients(self, Q: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the danger (B,) and its gradients (B, n) at `Q: (B, n)`. The values come at no extra cost."""
        danger, values = self._asked(configurations(Q, self.robot.n))
        dangers, gradients = danger.values_and_gradients(values)
        return dangers, self.robot.coupling.columns(gradients)

    @property
    def minimum(self) -> float:
        """A proven lower bound of the danger at any configuration: every link is as far away as it can get.

        The bound is zero without danger points, or if prismatic joints change the lengths of links (eq. 1).
        """
        field = self.frozen()
        if field._minimum is None:
            field._minimum = field._least()
        return field._minimum

    def _least(self) -> float:
        if not len(self.points) or self.factors is None:
            return 0.0
        # No point of a segment is farther away than the farther one of its ends, (L, M).
        farthest = self.robot.bounds.keypoint_reaches(self.points)[self.links].max(axis=1)
        return float(self.aggregated(self.k1 * (self.factors @ (1.0 / farthest))[None])[0])

    def link_fields(self, keypoints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the field (B, L, M) of every link at the danger points, and their distances (B, L, M) [m].

        `keypoints: (B, K, 3)` are those of the skeleton at B configurations [m]. The fields are φ_l(p_m) with unit
        weighting (4), unweighted; +inf on a segment.
        """
        points = self.points
        self.count(len(keypoints), len(points))
        fields = self.k1 * link_field.segment_fields(keypoints, self.links, points)
        return fields, link_field.segment_distances(keypoints, self.links, points)

    def aggregated(self, fields: FloatArray) -> FloatArray:
        """Return the danger (B,) for fields of the robot at the danger points, `fields: (B, M)`, without weights."""
        if not fields.shape[1]:
            return np.zeros(len(fields))
        levels = fields if self.weights is None else fields * self.weights
        dangers: FloatArray = static.aggregates(plain(levels), *self._measure)
        return dangers

    def shares(self, fields: FloatArray) -> FloatArray:
        """Return the derivatives (B, M) of `aggregated` with respect to the fields (B, M)."""
        levels = fields if self.weights is None else fields * self.weights
        shares: FloatArray = static.shares(plain(levels), *self._measure)
        return shares if self.weights is None else shares * self.weights

    @property
    def groups(self) -> link_field.Groups:
        """The danger points, at least one, in groups of neighbours."""
        return self._points.groups

    def high_points(self, Q: ArrayLike, share: float) -> BoolArray:
        """Return which danger points (M,) matter near the configurations `Q: (B, n)`; errors as `value`.

        A point matters if its w_m CDF(p_m) reaches the given share of the maximum at a configuration or more. If the
        danger is a mean, all points matter.
        """
        Q = configurations(Q, self.robot.n)
        if self.aggregate != "max":
            return np.ones(len(self.points), dtype=bool)
        danger, values = self._asked(Q)
        high: BoolArray = danger.high(values, share) > 0.0
        return high

    def with_points(self, points: FloatArray, weights: FloatArray | None) -> DangerField:
        """Return the field at other danger points (M, 3) with weights (M,)."""
        return self._at(DangerPoints(points, weights, self.k1))

    def push(self, q: ArrayLike) -> FloatArray:
        """Return the joint motion (n,) along the field's vectors at `q: (n,)`, Σ_m Σ_l J_lᵀ w_m CDF(p_m).

        J_l is the Jacobian of the distal end of link l. The sum is over all danger points (paper, §4.3). It is not
        finite if a segment passes through a danger point.
        """
        Q, points = self._single(q), self._points
        keypoints = self.robot.keypoints_batch(Q)
        self.count(1, len(points))
        vectors = self.k1 * link_field.vectors(keypoints, self.links, points.points, self.weighting)[0]
        total = vectors.sum(axis=0) if points.weights is None else points.weights @ vectors
        vectors_at_ends = np.zeros(keypoints.shape)
        np.add.at(vectors_at_ends[0], self.links[:, 1], total)
        motion: FloatArray = self.robot.jacobian_transpose_product(Q, vectors_at_ends)[0]
        return motion

    def field(self, q: ArrayLike, points: ArrayLike) -> FloatArray:
        """Return the field CDF(p), (M,), of the robot at `q: (n,)` at any `points: (M, 3)` [m], without weights.

        Raises InputError if `q` or `points` has the wrong shape or is not finite.
        """
        keypoints = self.robot.keypoints_batch(self._single(q))
        places = finite_array(points, (None, 3), "points")
        self.count(1, len(places))
        values: FloatArray = self.k1 * link_field.field(keypoints, self.links, places, self.weighting)[0]
        return values

    def _single(self, q: ArrayLike) -> FloatArray:
        return configuration(q, self.robot.n)[None]

    def _asked(self, Q: FloatArray) -> tuple[static.PointDanger, FloatArray]:
        """Count an evaluation at `Q: (B, n)`; return the present danger and Pinocchio's joint values (B, m)."""
        danger = self.point_danger()
        self.count(len(Q), len(danger.points))
        return danger, plain(self.robot.coupling.values(Q))
