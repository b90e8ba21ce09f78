"""SafeJTRRT: a tree that grows towards a place of the tip along the arm's Jacobian."""

from __future__ import annotations

import logging
from itertools import count
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.danger.field import DangerField
from safe_ompl.inputs import flag, fraction, number
from safe_ompl.planners.parts.approach import Approach
from safe_ompl.planners.parts.goal_step import GoalStep
from safe_ompl.planners.parts.growing import Extension, SafeStep
from safe_ompl.planners.parts.margin import AdaptiveMargin
from safe_ompl.planners.parts.selection import SafeSelection
from safe_ompl.planners.parts.threshold import AdaptiveThreshold, FixedThreshold
from safe_ompl.planners.parts.trees import Trees
from safe_ompl.planners.weighing import WeighingPlanner
from safe_ompl.plugins.goals import WorkspaceGoal
from safe_ompl.robot.inverse_kinematics import Place

_log = logging.getLogger(__name__)

_LEAST_MARGIN = 0.01  # [m]; how narrow it is at the goal is not known: little is tried before the margin ends
_STALLED = 0.995  # a step that leaves more than this share of the distance makes no progress
_SAME_SLOPE = 4  # steps for which the gradient of the danger, the dearest part of a step, is kept


class SafeJTRRT(WeighingPlanner):
    """One tree from the start that grows towards a place of the tip, a goal in the workspace (SAFE_JT-RRT).

    Some extensions go towards a random configuration, as in SafeRRTConnect. The others start from a safe node
    near the goal and follow the pseudoinverse of the arm's Jacobian, which brings the tip straight there;
    what freedom that leaves to the arm, its null space, turns the links away from danger. The goal must be a
    `WorkspaceGoal`; no inverse kinematics is needed.

    Parameters
    ----------
    si : ob.SpaceInformation
        Its space must have the robot's joints as coordinates (see `joint_space`).
    name : str
        Name in logs and benchmarks.
    range, alpha, nearest_fraction, slide, threshold_rise
        Of the random extensions, as for `SafeRRTConnect`. α also weighs the danger in the choice of the node
        from which to go to the goal; there the distance is the tip's, and a radian counts as many metres as
        it typically moves the tip (`Place.lever`).
    step : float
        Largest length ‖Δq‖ of one step towards the goal [rad]. It takes the place of the paper's gain k₂: far
        from the goal all steps are this long, near it they are the pseudoinverse's own.
    goal_bias : float
        p_g: share of the extensions that go towards the goal. More is faster, less is safer.
    null_space_gain : float
        k₁: length of the posture motion Δq₀ in terms of the motion that the tip's way needs. It goes down the
        gradient of the danger, Δq₀ ∝ −∇CDF: the paper's Σ Jᵀ CDF, with the share of every link in the field.
        It needs an objective with gradients (`DangerObjective`).
    danger_threshold : float
        CDF_Threshold: nodes as dangerous as this, in the field's units, are not added, unless they are safer
        than the node that they grow from (a start may be in danger). Infinite by default.
    transpose : bool
        Take Jᵀ in place of J† and leave the null space alone. With α = 0 this is the classical JT-RRT [2].
    patience : float
        After so many turns half of them ignore danger, after three times as many nearly all: where danger keeps the
        planner out of a narrow place, it yields, and costs no more than about that many turns. 0: it never does.
    clearance : float
        Motions keep a margin [m] from obstacles, dangerous or not: at first this one, but no more than 80 % of what
        the start keeps; after every twelve trapped steps it falls to 60 %, and it ends below 10 mm. It is in force
        where danger is, and needs a `CertifiedMotionValidator`. 0 for none.
    raw_alpha : bool
        Take α as it is, in length per danger, instead of relative; the tip's metres and the joints' radians are
        weighed alike.
    raw_gains : bool
        Take k₁ and k₂ as they are: Δq = k₂ [J†Δx + (I − J†J)Δq₀] with Δq₀ = k₁ Σ Jᵀ CDF over all danger points and
        the ends of all links, evaluated at every step. The more danger points, the smaller k₁ must be: a thousandth
        serves the paper's scenes. `step` remains the largest length of a step.
    gain : float
        k₂, where the gains are raw.
    random_starts : float
        Share of the extensions towards the goal that begin at any node not chosen before, instead of the best.
    strict_threshold : bool
        Let CDF_Threshold act on extensions towards the goal only, and refuse nodes that are safer than their parents,
        too.

    Notes
    -----
    The planner as it is printed in [1] is called `PaperSafeJTRRT`, and the classical one `PaperJTRRT`, k₂JᵀΔx. Where
    the print leaves something open or misleads it is read so: Jᵀ in the step is J†; the loop `while 1` ends without
    progress; steps are bounded and kept within the joint limits; a node from which a step was tried counts as chosen
    before, and where all are, an extension is random; the vectors CDF carry the weights of their danger points. What
    is ours, and what it buys:

    * k₁ and k₂ are relative (`raw_gains`): the same gains for all robots, without oscillation;
    * Δq₀ goes down the gradient of the greatest danger, with the share of every link (`raw_gains`): the danger of the
      configuration falls, which a sum over all points does not ensure;
    * that gradient is kept for a few steps (`raw_gains`): fewer evaluations of the field;
    * joints at their limits stop, and the others take over (`raw_gains`): the tip gets there all the same;
    * some extensions begin elsewhere (`random_starts`), and some choices ignore danger (`nearest_fraction`): out of
      dead ends;
    * random steps slide and keep to thresholds (`slide`, `threshold_rise`, `strict_threshold`): lower danger;
    * nodes safer than their parents are always welcome (`strict_threshold`): a start in danger can be left;
    * motions keep a margin, as long as they can (`clearance`): what is not dangerous is not grazed, either;
    * danger yields where no path is found (`patience`): no solution is lost for its sake;
    * α is relative (`raw_alpha`): one default for all robots.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.3.
    .. [2] M. Vande Weghe, D. Ferguson, S. Srinivasa: Randomized path planning for redundant manipulators
       without inverse kinematics. Humanoids 2007.
    """

    plans_to = WorkspaceGoal

    def __init__(
        self,
        si: Any,
        name: str = "SafeJTRRT",
        *,
        range: float = 0.0,
        alpha: float = 1.0,
        nearest_fraction: float = 0.1,
        slide: float = 0.8,
        threshold_rise: float = 0.05,
        step: float = 0.1,
        goal_bias: float = 0.05,
        null_space_gain: float = 1.0,
        danger_threshold: float = np.inf,
        transpose: bool = False,
        raw_alpha: bool = False,
        patience: float = 100,
        raw_gains: bool = False,
        gain: float = 0.1,
        random_starts: float = 0.3,
        strict_threshold: bool = False,
        clearance: float = 0.05,
    ) -> None:
        super().__init__(si, name)
        self._selection = SafeSelection(self._danger)
        self._threshold = AdaptiveThreshold(self._danger)
        self._margin: AdaptiveMargin = AdaptiveMargin(self._task, self._danger, _LEAST_MARGIN)
        self._fixed_threshold = FixedThreshold(self._task, self._margin.motion_is_free)
        self._random_step = SafeStep(
            self._bridge,
            self._danger,
            self._slide,
            self._threshold,
            self._fixed_threshold.random_motion_is_free,
        )
        self._step = GoalStep(self._task)
        self._goal: Any = None
        self._place: Place
        self._forget()
        self.setRange(range)
        self.setAlpha(alpha)
        self.setNearestFraction(nearest_fraction)
        self.setSlide(slide)
        self.setThresholdRise(threshold_rise)
        self.setStep(step)
        self.setGoalBias(goal_bias)
        self.setNullSpaceGain(null_space_gain)
        self.setDangerThreshold(danger_threshold)
        self.setTranspose(transpose)
        self.setRawAlpha(raw_alpha)
        self.setPatience(patience)
        self.setRawGains(raw_gains)
        self.setGain(gain)
        self.setRandomStarts(random_starts)
        self.setStrictThreshold(strict_threshold)
        self.setClearance(clearance)

    def setNearestFraction(self, epsilon: float) -> None:
        """Set the share ε in [0, 1] of selections by distance alone."""
        self._selection.nearest_fraction = fraction("nearest_fraction", epsilon)

    def getNearestFraction(self) -> float:
        """Return the share ε of selections by distance alone."""
        return self._selection.nearest_fraction

    def setThresholdRise(self, share: float) -> None:
        """Set by what share the adaptive threshold on danger rises after eight refusals; 0 for no threshold."""
        self._threshold.rise = number("threshold_rise", share, at_least=0)

    def getThresholdRise(self) -> float:
        """Return by what share the adaptive threshold on danger rises."""
        return self._threshold.rise

    def setRawAlpha(self, raw: bool) -> None:
        """Set whether α is taken as it is, in length per danger."""
        self._danger.is_raw = flag("raw_alpha", raw)

    def getRawAlpha(self) -> bool:
        """Return whether α is taken as it is."""
        return self._danger.is_raw

    def setStep(self, step: float) -> None:
        """Set the largest length of one step towards the goal [rad]."""
        self._step.largest = number("step", step, above=0)

    def getStep(self) -> float:
        """Return the largest length of one step towards the goal [rad]."""
        return self._step.largest

    def setGoalBias(self, share: float) -> None:
        """Set the share p_g in [0, 1] of extensions towards the goal."""
        self._goal_bias = fraction("goal_bias", share)

    def getGoalBias(self) -> float:
        """Return the share p_g of extensions towards the goal."""
        return self._goal_bias

    def setNullSpaceGain(self, k1: float) -> None:
        """Set the gain k₁ of the posture motion; 0 leaves the posture alone."""
        self._step.null_space_gain = number("null_space_gain", k1, at_least=0)

    def getNullSpaceGain(self) -> float:
        """Return the gain k₁ of the posture motion."""
        return self._step.null_space_gain

    def setDangerThreshold(self, danger: float) -> None:
        """Set the danger from which on no node is added; `math.inf` for none."""
        unlimited = isinstance(danger, float) and danger == np.inf
        self._fixed_threshold.level = danger if unlimited else number("danger_threshold", danger, above=0)

    def getDangerThreshold(self) -> float:
        """Return the danger from which on no node is added."""
        return self._fixed_threshold.level

    def setTranspose(self, transpose: bool) -> None:
        """Set whether to take Jᵀ in place of J†, without posture motion."""
        self._step.transpose = flag("transpose", transpose)

    def getTranspose(self) -> bool:
        """Return whether Jᵀ takes the place of J†."""
        return self._step.transpose

    def setRawGains(self, raw: bool) -> None:
        """Set whether k₁ and k₂ are taken as they are."""
        self._step.has_raw_gains = flag("raw_gains", raw)

    def getRawGains(self) -> bool:
        """Return whether k₁ and k₂ are taken as they are."""
        return self._step.has_raw_gains

    def setGain(self, k2: float) -> None:
        """Set the gain k₂ of a step; it acts where the gains are raw."""
        self._step.gain = number("gain", k2, above=0)

    def getGain(self) -> float:
        """Return the gain k₂ of a step."""
        return self._step.gain

    def setRandomStarts(self, share: float) -> None:
        """Set the share in [0, 1] of extensions towards the goal that begin at any node."""
        self._random_starts = fraction("random_starts", share)

    def getRandomStarts(self) -> float:
        """Return the share of extensions towards the goal that begin at any node."""
        return self._random_starts

    def setStrictThreshold(self, strict: bool) -> None:
        """Set whether CDF_Threshold acts on extensions towards the goal only, and without exception."""
        self._fixed_threshold.is_strict = flag("strict_threshold", strict)

    def getStrictThreshold(self) -> bool:
        """Return whether CDF_Threshold acts on extensions towards the goal only, and without exception."""
        return self._fixed_threshold.is_strict

    # ------------------------------------------------------------------------------- the paper's pseudocode

    def _search(self, ptc: Any) -> FloatArray | None:
        """SAFE_JT-RRT."""
        while self._approach.arrived is None and not ptc():  # WS_DISTANCE(Q, x_g) ≥ D_Threshold
            self._patience.turn(self._rng)
            self._margin.begin(self._trees)
            if self._rng.random() < self._goal_bias:
                self._extend_towards_goal(ptc)
            else:
                self._extend_randomly()
        return None if self._approach.arrived is None else self._trees.start.branch(self._approach.arrived)

    def _extend_towards_goal(self, ptc: Any) -> None:
        """EXTEND_TOWARDS_GOAL: from the best node not chosen before, step by step as long as it goes well."""
        old = self._best_for_goal()
        if old is None:
            self._extend_randomly()
            return
        tree = self._trees.start
        for k in count():
            if k % _SAME_SLOPE == 0 and not self._step.has_raw_gains:
                downhill = self._step.downhill(tree, old)
            q_old, distance = tree.configurations[old], self._approach.distances[old]
            if self._step.has_raw_gains:
                step = self._step.printed(q_old, self._field)
            else:
                step = self._step.at(q_old, distance, downhill)
            q_new = self._bridge.inside(q_old + step)
            if self._place.distance(q_new) > _STALLED * distance:
                return
            # COLLISION_FREE, and ‖CDF(q_new)‖ < CDF_Threshold
            if not self._fixed_threshold.motion_is_free(q_old, q_new):
                return
            old = self._trees.add(tree, q_new, old)
            self._approach.measure(tree)
            if self._approach.arrived is not None or ptc():
                return

    def _extend_randomly(self) -> None:
        """EXTEND_RANDOMLY: one step towards a random configuration from the node with the least ρ + α·CDF."""
        q_rand = self._task.random_configuration(self._rng)
        tree = self._trees.start
        old = self._selection.best(tree, q_rand, self._rng)
        outcome, new = self._random_step.extend(self._trees, tree, old, q_rand, self.getRange())
        if outcome is not Extension.TRAPPED:
            self._approach.measure(tree)
            self._approach.untried.append(new)

    def _best_for_goal(self) -> int | None:
        """Return argmin of WS_DISTANCE + α·CDF over the nodes not chosen before; None if there is none."""
        weight = self._danger.weight * (1.0 if self._danger.is_raw else self._place.lever)
        return self._approach.best(self._trees.start, weight, self._random_starts, self._rng)

    # ---------------------------------------------------------------------------------------- tree and goal

    @property
    def _field(self) -> DangerField | None:
        field = getattr(self.getProblemDefinition().getOptimizationObjective(), "field", None)
        return field if isinstance(field, DangerField) else None

    def _take_goals(self, ptc: Any) -> None:
        """Take the place from the problem; no goal configurations are drawn."""
        goal = self.getProblemDefinition().getGoal()
        if goal is not self._goal:
            self._aim(goal)
        self._approach.take_new(self._trees.start)

    def _aim(self, goal: WorkspaceGoal) -> None:
        """Turn to another goal; the tree stays, and all of its nodes may be tried for it."""
        self._goal, self._place = goal, goal.place
        self._step.aim(goal.place)
        self._approach = Approach(self._goal)
        if not self._place.redundancy and not self._step.transpose:
            _log.info(
                "%s: the goal takes all %d joints and leaves no null space: on the way to it the posture "
                "cannot turn from danger",
                self.getName(),
                self._place.robot.n,
            )

    @property
    def _grown(self) -> Trees:
        return self._trees

    def _forget(self) -> None:
        self._trees = Trees(self._bridge, self._task.cost, self.counts)
        self._threshold.reset()
        self._margin.reset()
        self._patience.reset()
        self._approach = Approach(self._goal)

    def _graph(self) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
        vertices, edges, starts, _ = super()._graph()
        arrived = self._approach.arrived
        return vertices, edges, starts, np.array([] if arrived is None else [arrived], dtype=np.intp)

    def _has_goals(self) -> bool:
        return self._goal is not None
