"""The danger of a configuration: the field of the robot at the danger points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import Counts, FloatArray, InputError, IntArray, UnknownNameError, documents, number, positive
from safe_ompl.danger.kernels import PointDanger
from safe_ompl.danger.kernels.groups import Points
from safe_ompl.danger.kinetostatic import LEAD, KinetostaticField
from safe_ompl.danger.link_field import RobotField, Weighting, segment_distances, segment_fields
from safe_ompl.danger.points import AGGREGATES, Aggregate, DangerousObstacles, DangerPoints, Evaluation, PointSource
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_OPTIONS = ("spacing", "aggregate", "weighting", "k1", "k2", "gamma", "sharpness")
_MANY = 5000  # points from which on a maximum is sought by groups, and not by a bound for each point


class DangerField(RobotField):
    """Cumulative danger field of a robot at danger points, CDF(q) = aggregate_m w_m CDF(p_m; q) (paper §3).

    The field of the robot at a point is the sum over its links of k₁ ∫ dt/‖p − r_t‖, eq. (5)–(7). The danger
    of a configuration is its maximum over the danger points, as in the paper, or a mean.

    Parameters
    ----------
    robot : Robot
        Gives the key points and segments of the skeleton.
    points : array_like, shape (M, 3), or callable
        Danger points in the world frame [m]. A callable maps a configuration (n,) to its danger points,
        always equally many, such as the nearest point of each obstacle (see Notes). Without any point the danger
        is zero everywhere.
    weights : array_like, shape (M,), optional
        w > 0 for each point, the danger weight of its obstacle; 1 by default.
    aggregate : {"max", "mean", "softmax"}
        With levels x_m = w_m CDF(p_m): the largest; their mean; or the smooth (1/β) log Σ_m exp(β x_m), which
        exceeds the largest by no more than log(M)/β.
    weighting : {"unit", "length"}
        Every link weighs the same (eq. 4), or in proportion to its length (eq. 1).
    k1 : float
        k₁ > 0 of the elementary field (6). The danger is in k₁/m with unit weighting, else in k₁.
    sharpness : float
        β > 0 of the softmax, in units of 1/danger. Large values approach the maximum.
    tolerance : float
        Relative error, from 0 to 0.1, that a mean or a softmax over more than 400 fixed points may have; 0: none but
        rounding. See Notes.
    k2, gamma : float, optional
        k₂ ≥ 0 and γ ≥ 0 of the kinetostatic field of the robot in motion, see `KinetostaticField`.
        Default: k₁ · 0.25 s, and 1.
    counts : Counts, optional
        Where evaluations are counted.

    Attributes
    ----------
    revision : int
        How often obstacles have moved. What was computed at another revision is of another scene.

    Raises
    ------
    InputError
        If the robot has no links, or a value is out of range, of the wrong shape, not finite or unknown.

    Notes
    -----
    Gradients hold the danger points where they are. For points that a callable moves with the configuration
    this leaves out (∂CDF/∂p)·(dp/dq). It vanishes where a point stays (on a corner, say) and where it is the
    point of its obstacle at which the field is greatest (envelope theorem). The point *nearest* to the robot
    is close to that one but not the same: there the gradient is an approximation, the better the smaller the
    obstacle. With "max" the gradient is that of the most dangerous point: one of the subgradients where two points tie.

    A maximum is exact. Points that cannot have it are left out: by bounds in single precision, of 5000 fixed points and
    more by groups of neighbours. More than 400 fixed points of a mean or a softmax are kept in such groups, too: far
    groups count by their centre, as many as have proven errors that together stay within `tolerance`
    (`safe_ompl.danger.kernels.groups`). The danger is within that of the exact one, and may jump by as much where a
    group begins or ceases to count so; its gradient is that of the field at those centres. All else, above all what is
    proven (`CertifiedDanger`), looks at every point.

    Any number of threads may ask at the same time, also while one of them moves the field; they share the `counts`,
    which may then lose some.
    """

    def __init__(
        self,
        robot: Robot,
        points: ArrayLike | PointSource,
        weights: ArrayLike | None = None,
        *,
        aggregate: Aggregate = "max",
        weighting: Weighting = "unit",
        k1: float = 1.0,
        sharpness: float = 10.0,
        tolerance: float = 0.01,
        k2: float | None = None,
        gamma: float = 1.0,
        counts: Counts | None = None,
    ) -> None:
        if aggregate not in AGGREGATES:
            raise UnknownNameError("aggregate", aggregate, AGGREGATES)
        super().__init__(robot, weighting, k1, counts)
        self.aggregate = aggregate
        self.sharpness = positive(sharpness, "sharpness")
        self.k2 = LEAD * self.k1 if k2 is None else number("k2", k2, at_least=0.0)
        self.gamma = number("gamma", gamma, at_least=0.0)
        self.tolerance = number("tolerance", tolerance, at_least=0.0, at_most=0.1)
        measure = aggregate, self.sharpness, self.tolerance
        self._evaluation = Evaluation(robot, self.segments, self._by_length, measure)
        self._obstacles: DangerousObstacles | None = None
        self._frozen: DangerField | None = None
        self.revision = 0
        self._danger_points = DangerPoints(points, weights, self.k1)

    @classmethod
    def of_scene(cls, robot: Robot, scene: Scene, spacing: float | None = None, **options: Any) -> DangerField:
        """Return the field at the danger points of a scene (`Scene.danger_points`); it can `move` with them.

        `spacing` is the distance between danger points [m], by default the scene's own; options are those of the class.
        """
        obstacles = DangerousObstacles(scene, spacing)
        field = cls(robot, *obstacles.points, **options)
        field._obstacles = obstacles
        field._take_points(field._danger_points)
        return field

    @classmethod
    def of_options(
        cls, robot: Robot, scene: Scene, options: Mapping[str, Any], counts: Counts | None = None
    ) -> DangerField:
        """Return the field of a scene with options that a user gives, as `danger` of `SafeSetup`; InputError if bad."""
        if not isinstance(options, Mapping):
            raise InputError(f"danger must be a mapping of options, or None for none, got {options!r}")
        with documents.within("danger"):
            documents.check_keys(options, _OPTIONS)
        options = dict(options)
        return cls.of_scene(robot, scene, options.pop("spacing", None), counts=counts, **options)

    def move(self, scene: Scene) -> None:
        """Take the danger points of a scene in which nothing but places of obstacles differs, such as `Scene.moved`.

        From here on the danger is that of a field made anew for that scene. Raises InputError if anything else differs,
        or the field was not made by `of_scene`. Then it stays as it was.
        """
        self._follow(self._of_known_scene.move(scene))

    def stand_in(self, scene: Scene) -> None:
        """Take the danger points of any other scene; errors as `move`."""
        self._follow(self._of_known_scene.replace(scene))

    @property
    def _of_known_scene(self) -> DangerousObstacles:
        if self._obstacles is None:
            raise InputError("this field knows points, not a scene; DangerField.of_scene makes one that can move")
        return self._obstacles

    def _follow(self, moved: bool) -> None:
        if moved:
            self._take_points(DangerPoints(*self._of_known_scene.points, self.k1))
            self.revision += 1

    def _take_points(self, points: DangerPoints) -> None:
        """Take danger points and what follows from them, at once, as other threads may ask."""
        frozen = self._at(points)
        self._danger_points = points
        self._frozen = frozen

    def _at(self, points: DangerPoints) -> DangerField:
        """Return the field at other danger points, which stay where they are."""
        other = object.__new__(DangerField)
        vars(other).update(vars(self), _danger_points=points, _obstacles=None, _frozen=None)
        for followed in ("moving", "_minimum"):
            vars(other).pop(followed, None)
        return other

    def frozen(self) -> DangerField:
        """Return the field at the present danger points, which stay where they are if this field moves.

        Several queries about the same danger points go to this one, as another thread may move them.
        """
        return self if self._frozen is None else self._frozen

    def __repr__(self) -> str:
        points = repr(self._danger_points.source) if self.points is None else f"<{len(self.points)} points>"
        return (
            f"DangerField({self.robot!r}, {points}, aggregate={self.aggregate!r}, "
            f"weighting={self.weighting!r}, k1={self.k1:g}, sharpness={self.sharpness:g})"
        )

    @property
    def points(self) -> FloatArray | None:
        """The danger points (M, 3) [m], read-only; None where a callable gives them."""
        return self._danger_points.fixed

    def for_kernels(self) -> PointDanger | None:
        """Return what `safe_ompl.danger.kernels.dangers` needs for the danger at present; None where points are moved.

        The joints of its values and gradients are those of Pinocchio's model. Whoever calls it counts the evaluations.
        """
        field = self.frozen()
        if field.points is None or not len(field.points):
            return None
        points = field._choice(field._danger_points.prepared(field.points[:0]))
        return PointDanger(field._evaluation.tables, points, field._evaluation.aggregate)

    @property
    def weights(self) -> FloatArray | None:
        """The weights (M,) of the danger points, read-only; None where all are 1."""
        return self._danger_points.weights

    @cached_property
    def moving(self) -> KinetostaticField:
        """The danger of the robot in motion, at (q, q̇), with the same danger points."""
        return KinetostaticField(self)

    def value(self, q: ArrayLike) -> float:
        """Return the danger CDF(q) at `q: (n,)`; +inf where a segment passes through a danger point.

        Raises InputError if `q` has the wrong shape or is not finite.
        """
        return float(self._danger(self._single(q))[0])

    def values(self, Q: ArrayLike) -> FloatArray:
        """Return the danger (B,) at a batch of configurations `Q: (B, n)`; see `value`."""
        return self._danger(self._batch(Q))

    def mean(self, start: ArrayLike, end: ArrayLike, tolerance: float = 0.01) -> float:
        """Return the mean danger ∫ CDF dt on the straight way q(t) between two configurations (n,), 0 ≤ t ≤ 1.

        By Simpson's rule on pieces of at most 1 rad, which are halved, six times at most, until the trapezoidal rule is
        within the relative `tolerance` > 0 of the mean from it. Errors as `value`; also if the points are a callable's.
        """
        positive(tolerance, "tolerance")
        ends, field = np.concatenate([self._single(start), self._single(end)]), self.frozen()
        if field.points is None:
            raise InputError("the danger points depend on the configuration; a mean needs fixed ones")
        if not len(field.points):
            return 0.0
        delta = ends[1] - ends[0]
        panels = 1 + int(math.sqrt(delta.dot(delta)))
        mean, evaluations = self._evaluation.mean(ends, field._points_for(ends[:0]), panels, tolerance)
        self.counts.field_configurations += evaluations
        self.counts.field_points += evaluations * len(field.points)
        return mean

    def gradient(self, q: ArrayLike) -> FloatArray:
        """Return ∇CDF(q), (n,), at `q: (n,)` [danger/rad or danger/m]; see the Notes of the class. Errors: `value`."""
        gradient: FloatArray = self.gradients(self._single(q))[0]
        return gradient

    def gradients(self, Q: ArrayLike) -> FloatArray:
        """Return the gradients (B, n) at a batch of configurations `Q: (B, n)`; see `gradient`."""
        return self.values_and_gradients(Q)[1]

    def values_and_gradients(self, Q: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the danger (B,) and its gradients (B, n) at `Q: (B, n)` at the cost of the gradients."""
        Q = self._batch(Q)
        points = self.frozen()._points_for(Q)
        if not points.columns.size:
            return np.zeros(len(Q)), np.zeros(Q.shape)
        return self._evaluation.values_and_gradients(Q, points)

    def terms_above(self, Q: ArrayLike, level: float) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return rows (C,), values (C,) and gradients (C, n) of the terms of the danger above a level at `Q: (B, n)`.

        Where the danger is the maximum over danger points, its terms are w_m CDF(p_m); else it is its own only term.
        Gradients are in danger/rad or danger/m, errors as `value`.
        """
        Q = self._batch(Q)
        if self.aggregate != "max":
            values, gradients = self.values_and_gradients(Q)
            above = np.flatnonzero(values > level)
            return above, values[above], gradients[above]
        least = math.nextafter(level, math.inf)
        rows, _, levels, slopes = self._evaluation.high_levels(Q, self._every_point(Q), least, sloped=True)
        return rows, levels, slopes

    def most_dangerous_point(self, q: ArrayLike) -> int:
        """Return the index of the danger point with the largest w_m CDF(p_m) at `q: (n,)`.

        Errors as `value`; also if there are no danger points.
        """
        Q = self._single(q)
        highest = self._evaluation.high_levels(Q, self._every_point(Q), share=1.0)[1]
        if not len(highest):
            raise InputError("there are no danger points; give an obstacle a weight > 0")
        return int(highest[0])

    @property
    def minimum(self) -> float:
        """A proven lower bound of the danger at any configuration: every link as far away as it can get.

        Zero where there are no danger points, a callable gives them, or prismatic joints make the links' lengths
        change (eq. 1).
        """
        return self.frozen()._minimum

    @cached_property
    def _minimum(self) -> float:
        if self.points is None or not len(self.points):
            return 0.0
        if self.weighting == "length" and self.segments.lengths is None:
            return 0.0
        ends = self.robot.bounds.keypoint_reaches(self.points)[self.robot.segments]
        farthest = ends.max(axis=1)  # (L, M): no point of a segment is farther away than both of its ends
        lengths = self.segments.lengths if self.weighting == "length" else None
        charges = np.ones(len(farthest)) if lengths is None else lengths
        return float(self.aggregated(self.k1 * (charges @ (1.0 / farthest))[None])[0])

    def link_fields(self, keypoints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the field of every link at the danger points, and their distances from the links [m], (B, L, M) each.

        `keypoints: (B, K, 3)` are those of the skeleton at B configurations [m]. The fields are φ_l(p_m) with unit
        weighting (4), unweighted; +inf on a segment. Raises InputError if a callable gives the danger points.
        """
        points = self.points
        if points is None:
            raise InputError("the danger points depend on the configuration; fields of links need fixed ones")
        self.count(keypoints, points)
        if not len(points):
            nothing = np.zeros((len(keypoints), len(self.segments.pairs), 0))
            return nothing, nothing
        fields = self.k1 * segment_fields(keypoints, self.segments, points)
        return fields, segment_distances(keypoints, self.segments, points)

    def aggregated(self, fields: FloatArray) -> FloatArray:
        """Return the danger (B,) where the robot's field at the danger points is `fields: (B, M)`, unweighted."""
        return self._evaluation.aggregated(fields if self.weights is None else fields * self.weights)

    def active(self, Q: ArrayLike, share: float) -> DangerField:
        """Return the field of those danger points that matter near the configurations `Q: (B, n)`; errors as `value`.

        These are the points whose w_m CDF(p_m) reaches the given share of the maximum at one of them, at least. Where
        the danger is a mean, or a callable gives the points, all of them matter, and the field itself is returned.
        """
        field = self.frozen()
        points, weights = field.points, field.weights
        if points is None or not len(points) or self.aggregate != "max":
            return self
        Q = self._batch(Q)
        near = np.zeros(len(points), dtype=bool)
        near[self._evaluation.high_levels(Q, field._every_point(Q), share=share)[1]] = True
        if near.all():
            return self
        return self.with_points(points[near], None if weights is None else weights[near])

    def with_points(self, points: FloatArray, weights: FloatArray | None) -> DangerField:
        """Return the field at other danger points (M, 3) with weights (M,)."""
        return self._at(DangerPoints(points, weights, self.k1))

    def push(self, q: ArrayLike) -> FloatArray:
        """Return the joint motion (n,) that the field's vectors ask for at `q: (n,)`, Σ_m Σ_l J_lᵀ w_m CDF(p_m).

        J_l is the Jacobian of the distal end of link l; the sum goes over all danger points (paper, §4.3). It is not
        finite where a segment passes through a danger point.
        """
        Q, field = self._single(q), self.frozen()
        keypoints, points = self._scene(Q[0], field.points_at(Q).reshape(-1, 3))
        vectors = self._vector(keypoints, points)
        total = vectors.sum(axis=0) if field.weights is None else field.weights @ vectors
        pushes = np.zeros(keypoints.shape)
        np.add.at(pushes[0], self.robot.segments[:, 1], total)
        motion: FloatArray = self.robot.pull_back(Q, pushes)[0]
        return motion

    def points_at(self, Q: FloatArray) -> FloatArray:
        """Return the danger points, (M, 3) or, where they depend on the configuration, (B, M, 3)."""
        return self._danger_points.at(Q)

    def contributions(self, levels: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the points that matter, (B, m, 3) or (M, 3), and ∂CDF/∂CDF(p) for each, (B, m)."""
        if self.aggregate == "max":
            return self._danger_points.chosen(points, np.arange(len(levels)), levels.argmax(axis=1))
        shares: FloatArray = self._evaluation.shares(levels)
        return points, shares if self.weights is None else shares * self.weights

    def _danger(self, Q: FloatArray) -> FloatArray:
        points = self.frozen()._points_for(Q)
        return self._evaluation.values(Q, points) if points.columns.size else np.zeros(len(Q))

    @property
    def groups(self) -> Points | None:
        """The danger points in groups, where there are many of which a maximum is sought; else None."""
        return self._danger_points.groups if self.aggregate == "max" else None

    def _every_point(self, Q: FloatArray) -> Points:
        """Return the danger points for kernels, without groups, and count an evaluation."""
        points = self._danger_points.prepared(Q)
        self.count(Q, points.columns.transpose(0, 2, 1))
        return points

    def _points_for(self, Q: FloatArray) -> Points:
        """Return the same, in groups where not all of them need be looked at, and count an evaluation."""
        return self._choice(self._every_point(Q))

    def _choice(self, points: Points) -> Points:
        """Return points, or groups of them where not all need be looked at."""
        if self.aggregate == "max":
            return points if points.charges.shape[1] < _MANY else self.groups or points
        groups = self._danger_points.groups if self.tolerance > 0.0 else None
        return points if groups is None else groups
