"""SafeRRTConnect: RRT-Connect whose trees grow from safe configurations."""

from __future__ import annotations

from typing import Any

from safe_ompl.common import FloatArray
from safe_ompl.planning.planners.base import Parameter, SafePlanner
from safe_ompl.planning.planners.growth import Growth
from safe_ompl.planning.planners.problem import DangerDecay, DangerWeight, Margin


class SafeRRTConnect(SafePlanner):
    """RRT-Connect whose two trees, from start and goal, grow from safe nodes (SAFE_RRT-CONNECT).

    A tree is extended towards a random configuration from the node that minimises ρ + α·CDF, a compromise between
    distance and danger. Then the other tree tries to connect to the new node. Every new node is moved down the gradient
    of the danger, perpendicular to the step, as long as the motion stays free. With α = 0 it is RRT-Connect.

    Parameters
    ----------
    range : float >= 0, default 0.0 [rad]
        Largest length of one extension, before it is moved sideways; 0 means 7.5 % of the space's extent.
    alpha : float >= 0, default 1.0
        Weight of danger α, relative to the median of ‖∇CDF‖ over valid configurations. At 1, a typical change of the
        danger over a step of 1 rad weighs as much as a distance of 1 rad. 0 plans classically.
    nearest_fraction : float >= 0, <= 1, default 0.3
        ε: share of iterations that choose the node by distance alone. Any ε > 0 keeps the planner probabilistically
        complete: otherwise a node in a dangerous passage might never be chosen.
    slide : float >= 0, <= 1, default 0.8
        Largest sideways motion of a new node down the gradient of the danger, as a fraction of the range; 0 gives the
        paper's straight extension. It acts if α > 0 and the objective has gradients, as `DangerObjective` has.
    threshold_rise : float >= 0, default 0.05
        A node that is more dangerous than its parent and than a threshold is refused. The threshold is at first the
        danger of the more dangerous end, which no path can avoid. After every eight refusals it rises by this share. It
        keeps the peak of the danger low. 0 for no threshold.
    danger_decay : float >= 0, default 100.0
        Number of iterations after which half of the iterations ignore danger and margin; after three times as many
        nearly all do. So danger that blocks a narrow passage costs about this many iterations at most. 0 for no decay.
    clearance : float >= 0, default 0.05 [m]
        Largest margin from all obstacles, dangerous or not. It is limited to 80 % of the clearance of start and goal.
        It falls to 60 % after every twelve trapped steps, or every 48 if nothing is dangerous. It acts if α > 0, in
        iterations that do not ignore danger (`danger_decay`), and needs a `CertifiedMotionValidator`. 0 for no margin.
    iterations : int >= 0, default 0
        K: largest number of iterations; 0: until the time is over.

    Notes
    -----
    `PaperSafeRRTConnect` is the planner as printed in [1], and `PaperRRTConnect` is RRT-Connect as printed in [2]. The
    differences of this planner, with reasons:

    * A share of the iterations ignores danger (`nearest_fraction`), so that no passage stays closed.
    * Steps are moved sideways and obey a threshold (`slide`, `threshold_rise`), for lower danger.
    * If a whole step is trapped, a shorter one is tried, for fewer nodes in narrow passages.
    * Once a tree has more than 64 nodes, the smaller tree has eight of nine iterations (all of them in [3], §5.5.3). So
      a narrow passage around a start or a goal is left sooner.
    * Motions keep a margin as long as they can (`clearance`), so that paths do not graze harmless obstacles either.
    * Danger and margin lose weight if no path is found (`danger_decay`), so that they do not prevent a solution.
    * α is relative to the typical slope of the danger, so that one default fits all robots.

    References
    ----------
    1. B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.4.
    2. J. Kuffner, S. LaValle: RRT-Connect. ICRA 2000.
    3. S. LaValle: Planning Algorithms. Cambridge University Press, 2006.

    Examples
    --------
    >>> setup = setup_scenario("planar2")
    >>> setup.setPlanner(SafeRRTConnect(setup.getSpaceInformation()))
    >>> bool(setup.solve(5.0))
    True
    """

    alpha = Parameter(1.0)
    setAlpha, getAlpha = alpha.methods()
    nearest_fraction = Parameter(0.3, at_most=1)
    setNearestFraction, getNearestFraction = nearest_fraction.methods()
    slide = Parameter(0.8, at_most=1)
    setSlide, getSlide = slide.methods()
    threshold_rise = Parameter(0.05)
    setThresholdRise, getThresholdRise = threshold_rise.methods()
    danger_decay = Parameter(100.0)
    setDangerDecay, getDangerDecay = danger_decay.methods()
    clearance = Parameter(0.05)
    setClearance, getClearance = clearance.methods()
    iterations = Parameter(0)
    setIterations, getIterations = iterations.methods()

    def _make_parts(self) -> None:
        self._danger = DangerWeight(self._problem)
        self._margin = Margin(self._problem, self._danger)
        self._decay = DangerDecay(self._danger, self._margin)
        self._growth = Growth(self._problem, self._danger, self._margin, self._decay)

    def _apply_parameters(self) -> None:
        self._danger.alpha = self.alpha
        self._growth.slide = self.slide
        self._growth.rise = self.threshold_rise
        self._decay.half_life = self.danger_decay
        self._margin.largest = self.clearance

    def _search(self, ptc: Any) -> FloatArray | None:
        """Run the paper's SAFE_RRT-CONNECT."""
        self._margin.begin(self._trees)
        return self._growth.connect(
            self._trees,
            self._rng,
            reach=self.getRange(),
            ignored=self.nearest_fraction,
            iterations=self.iterations,
            stop=ptc,
            enough_nodes=lambda: self._enough_nodes,
            take_goals=lambda: self._take_goals(ptc),
        )

    def _forget(self) -> None:
        super()._forget()
        self._growth.reset()
        self._margin.reset()
        self._decay.reset()
