"""SafeJTRRT: a tree that grows towards a place of the tip along the arm's Jacobian."""

from __future__ import annotations

import logging
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.planning.ompl import WorkspaceGoal
from safe_ompl.planning.planners.base import SafePlanner
from safe_ompl.planning.planners.parameters import FormerNames, Parameter
from safe_ompl.planning.planners.parts.clearance import AdaptiveMargin
from safe_ompl.planning.planners.parts.danger import (
    AdaptiveThreshold,
    DangerDecay,
    DangerWeight,
    FixedThreshold,
    SafeSelection,
)
from safe_ompl.planning.planners.parts.extend import Extension, SafeStep, TangentialDescent
from safe_ompl.planning.planners.parts.goal_step import STALLED, Approach, GoalStep
from safe_ompl.planning.planners.parts.tree import Trees
from safe_ompl.planning.planners.rrt_connect import SafeRRTConnect
from safe_ompl.robot import Place

_log = logging.getLogger(__name__)

_LEAST_MARGIN = 0.01  # [m]; the clearance at the goal is unknown: little is tried before the margin ends
_SAME_SLOPE = 4  # steps for which the gradient of the danger, the dearest part of a step, is kept


class SafeJTRRT(SafePlanner):
    """One tree from the start that grows towards a place of the tip, a goal in the workspace (SAFE_JT-RRT).

    Some extensions go towards a random configuration, as in SafeRRTConnect. The others start from a safe node
    near the goal and follow the pseudoinverse of the arm's Jacobian, which brings the tip straight there;
    the freedom that this leaves to the arm, its null space, turns the links away from danger. The goal must be a
    `WorkspaceGoal`; no inverse kinematics is needed.

    Notes
    -----
    The planner as it is printed in [1] is `PaperSafeJTRRT`, and the classical one `PaperJTRRT`, k₂JᵀΔx. What differs
    here, and why:

    * k₁ and k₂ are relative: the same gains for all robots, without oscillation;
    * Δq₀ goes down the gradient of the greatest danger, with the share of every link in the field: the danger of the
      configuration falls, which a sum over all points does not ensure;
    * that gradient is kept for a few steps: fewer evaluations of the field;
    * joints at their limits stop, and the others take over: the tip still gets there;
    * some extensions begin elsewhere (`random_starts`), and some choices ignore danger (`nearest_fraction`): out of
      dead ends;
    * random steps descend sideways and keep to thresholds (`slide`, `threshold_rise`, `danger_threshold`): lower
      danger;
    * nodes safer than their parents are always allowed: a start in danger can be left;
    * motions keep a margin, as long as they can (`clearance`): obstacles that are not dangerous are not grazed, either;
    * danger loses weight where no path is found (`danger_decay`): it costs no solution;
    * α is relative to the usual slope of the danger: one default serves all robots.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.3.
    .. [2] M. Vande Weghe, D. Ferguson, S. Srinivasa: Randomized path planning for redundant manipulators
       without inverse kinematics. Humanoids 2007.
    """

    plans_to = WorkspaceGoal
    former_names = FormerNames(
        renamed={"patience": "danger_decay"},
        removed={
            "raw_alpha": "PaperSafeJTRRT takes α as length per danger; here it is relative",
            "raw_gains": "PaperSafeJTRRT takes k₁ and k₂ as they are; here they are relative",
            "gain": "PaperSafeJTRRT has the gain k₂; here `step` bounds the steps",
            "strict_threshold": "PaperSafeJTRRT has the strict threshold; here nodes may be safer than parents",
        },
    )

    alpha = Parameter(
        1.0,
        """Weight of danger α, as for `SafeRRTConnect`. It also weighs the danger in the choice of the node from which
        to go to the goal; there the distance is the tip's, and a radian counts as many metres as it typically moves
        the tip (`Place.lever`). 0 plans classically.""",
        kept_in="_danger.alpha",
    )
    # Of random extensions, as for SafeRRTConnect.
    nearest_fraction = replace(SafeRRTConnect.nearest_fraction, default=0.1)
    slide = SafeRRTConnect.slide
    threshold_rise = SafeRRTConnect.threshold_rise
    step = Parameter(
        0.1,
        """Largest length ‖Δq‖ of one step towards the goal. It takes the place of the paper's gain k₂: far from the
        goal all steps are this long, near it they are the pseudoinverse's own.""",
        unit="rad",
        above=0,
        kept_in="_step.largest",
    )
    goal_bias = Parameter(
        0.05,
        "p_g: share of the extensions that go towards the goal. More is faster, less is safer.",
        at_most=1,
    )
    null_space_gain = Parameter(
        1.0,
        """k₁: length of the posture motion Δq₀ relative to the motion that the tip's way needs. It goes down the
        gradient of the danger, Δq₀ ∝ −∇CDF: the paper's Σ Jᵀ CDF, with the share of every link in the field. It needs
        an objective with gradients (`DangerObjective`). 0 leaves the posture alone.""",
        kept_in="_step.null_space_gain",
    )
    danger_threshold = Parameter(
        np.inf,
        """CDF_Threshold: nodes as dangerous as this, in the field's units, are not added, unless they are safer than
        the node that they grow from (a start may be in danger).""",
        above=0,
        kept_in="_fixed_threshold.level",
    )
    transpose = Parameter(
        False,
        "Whether Jᵀ takes the place of J†, without posture motion. With α = 0 this is the classical JT-RRT [2].",
        kept_in="_step.transpose",
    )
    random_starts = Parameter(
        0.3,
        """Share of the extensions towards the goal that begin at any node not chosen before, instead of the best.""",
        at_most=1,
    )
    danger_decay = SafeRRTConnect.danger_decay
    clearance = Parameter(
        0.05,
        """Largest margin that motions keep from all obstacles, dangerous or not. It is no more than 80 % of what the
        start keeps, falls to 60 % after every twelve trapped steps, and ends below 10 mm. It is in force while danger
        has weight, and needs a `CertifiedMotionValidator`. 0 for none.""",
        unit="m",
        kept_in="_margin.largest",
    )

    def _make_parts(self) -> None:
        self._danger = DangerWeight(self._problem)
        self._decay = DangerDecay(self._danger)
        self._selection = SafeSelection(self._danger)
        self._descent = TangentialDescent(self._bridge, self._danger)
        self._threshold = AdaptiveThreshold(self._danger)
        self._margin = AdaptiveMargin(self._problem, self._danger, _LEAST_MARGIN)
        self._fixed_threshold = FixedThreshold(self._problem, self._margin.motion_is_free)
        self._random_step = SafeStep(
            self._bridge, self._danger, self._descent, self._threshold, self._fixed_threshold.motion_is_free
        )
        self._step = GoalStep(self._problem)
        self._goal: Any = None
        self._place: Place
        self._approach: Approach

    # ------------------------------------------------------------------------------- the paper's pseudocode

    def _search(self, ptc: Any) -> FloatArray | None:
        """SAFE_JT-RRT."""
        while self._approach.arrived is None and not ptc():  # WS_DISTANCE(Q, x_g) ≥ D_Threshold
            self._decay.turn(self._rng)
            self._margin.begin(self._approach.trees)
            if self._rng.random() < self.goal_bias:
                self._extend_towards_goal(ptc)
            else:
                self._extend_randomly()
        return None if self._approach.arrived is None else self._approach.tree.branch(self._approach.arrived)

    def _extend_towards_goal(self, ptc: Any) -> None:
        """EXTEND_TOWARDS_GOAL: from the best node not chosen before, step by step as long as there is progress."""
        old = self._best_for_goal()
        if old is None:
            self._extend_randomly()
            return
        approach, tree = self._approach, self._approach.tree
        for k in count():
            if k % _SAME_SLOPE == 0:
                downhill = self._step.downhill(tree, old)
            q_old, distance = tree.configurations[old], approach.distances[old]
            q_new = self._bridge.inside(q_old + self._step.at(q_old, distance, downhill))
            if self._place.distance(q_new) > STALLED * distance:
                return
            # COLLISION_FREE, and ‖CDF(q_new)‖ < CDF_Threshold
            if not self._fixed_threshold.motion_is_free(q_old, q_new):
                return
            old = approach.trees.add(tree, q_new, old)
            approach.measure()
            if approach.arrived is not None or ptc():
                return

    def _extend_randomly(self) -> None:
        """EXTEND_RANDOMLY: one step towards a random configuration from the node with the least ρ + α·CDF."""
        q_rand = self._problem.random_configuration(self._rng)
        approach, tree = self._approach, self._approach.tree
        old = self._selection.best(tree, q_rand, self._rng)
        outcome, new = self._random_step.extend(approach.trees, tree, old, q_rand, self.getRange())
        if outcome is not Extension.TRAPPED:
            approach.measure()
            approach.untried.append(new)

    def _best_for_goal(self) -> int | None:
        """Return argmin of WS_DISTANCE + α·CDF over the nodes not chosen before; None if there is none."""
        return self._approach.best(self._danger.weight * self._place.lever, self.random_starts, self._rng)

    # ---------------------------------------------------------------------------------------- tree and goal

    def _take_goals(self, ptc: Any) -> None:
        """Take the place from the problem; no goal configurations are drawn."""
        goal = self.getProblemDefinition().getGoal()
        if goal is not self._goal:
            self._aim(goal)
        self._approach.take_new()

    def _aim(self, goal: WorkspaceGoal) -> None:
        """Head for another goal; the tree stays, and all of its nodes may be tried for it."""
        self._goal, self._place = goal, goal.place
        self._step.aim(goal.place)
        self._approach = Approach(self._approach.trees, goal)
        if not self._place.redundancy and not self.transpose:
            _log.info(
                "%s: the goal takes all %d joints and leaves no null space: on the way to it the posture "
                "cannot turn from danger",
                self.getName(),
                self._place.robot.n,
            )

    @property
    def _structure(self) -> Approach:
        return self._approach

    def _prepare(self) -> None:
        self._danger.prepare()

    def _forget(self) -> None:
        self._approach = Approach(Trees(self._bridge, self._problem.cost, self.counts), self._goal)
        self._threshold.reset()
        self._margin.reset()
        self._decay.reset()
