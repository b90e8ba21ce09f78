"""SafeRRTConnect: RRT-Connect whose trees grow from safe configurations."""

from __future__ import annotations

from typing import Any

from safe_ompl.common import FloatArray
from safe_ompl.planning.planners.base import Parameter, SafePlanner
from safe_ompl.planning.planners.growth import Growth
from safe_ompl.planning.planners.problem import DangerDecay, DangerWeight, Margin


class SafeRRTConnect(SafePlanner):
    """Two trees, from start and goal, that grow from safe nodes and greedily connect (SAFE_RRT-CONNECT).

    A random configuration is approached from the node that minimises ρ + α·CDF, a compromise between nearness and
    danger; then the other tree tries to connect to the new node. On its way every new node moves down the gradient
    of the danger, at right angles to the step, as far as the way stays free. With α = 0 it is RRT-Connect.

    Parameters
    ----------
    range : float >= 0, default 0.0 [rad]
        Largest length of one extension, before it moves sideways; 0 takes 7.5 % of the space's extent.
    alpha : float >= 0, default 1.0
        Weight of danger α, relative to the median of ‖∇CDF‖ over valid configurations: at 1, nodes that differ in
        danger as much as a typical step of 1 rad changes it are set 1 rad apart. 0 plans classically.
    nearest_fraction : float >= 0, <= 1, default 0.3
        ε: share of the choices of a node by distance alone. Any ε > 0 keeps the planner probabilistically complete: a
        node in a dangerous passage would otherwise never be chosen again.
    slide : float >= 0, <= 1, default 0.8
        Largest sideways motion of a new node down the gradient of the danger, as a fraction of the range; 0 gives the
        paper's straight extension. It acts where α > 0 and the objective offers gradients (`DangerObjective` does).
    threshold_rise : float >= 0, default 0.05
        No node is added that is more dangerous than its parent and than a threshold. This is at first the danger of the
        more dangerous end, which no path can avoid; after every eight refusals it rises by this share. It keeps the
        peak of the danger low. 0 for no threshold.
    danger_decay : float >= 0, default 100.0
        Number of turns after which half of the turns ignore danger and margin; after three times as many nearly all do.
        So danger that keeps the planner out of a narrow place costs no more than about that many turns. 0 for no decay.
    clearance : float >= 0, default 0.05 [m]
        Largest margin that motions keep from all obstacles, dangerous or not, also where nothing is dangerous. It is no
        more than 80 % of what start and goal keep. It falls to 60 % after every twelve trapped steps, or every 48 where
        nothing is dangerous. It acts where α > 0, in turns that do not ignore danger (`danger_decay`), and needs a
        `CertifiedMotionValidator`. 0 for none.
    iterations : int >= 0, default 0
        K: how many turns the trees take before the planner gives up; 0: until time is up.

    Notes
    -----
    The planner as it is printed in [1] is `PaperSafeRRTConnect`, and RRT-Connect as printed in [2] `PaperRRTConnect`.
    What differs here, and why:

    * a share of the choices ignores danger (`nearest_fraction`): no passage stays closed;
    * steps descend sideways and keep to a threshold (`slide`, `threshold_rise`): lower danger;
    * a shorter step is tried where a whole one is trapped: fewer nodes in narrow places;
    * once a tree has more than 64 nodes, the smaller one has eight of nine turns (all of them in [3], §5.5.3): a
      narrow place around a start or a goal is left sooner;
    * motions keep a margin, as long as they can (`clearance`): obstacles that are not dangerous are not grazed, either;
    * danger and margin lose weight where no path is found (`danger_decay`): they cost no solution;
    * α is relative to the usual slope of the danger: one default serves all robots.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.4.
    .. [2] J. Kuffner, S. LaValle: RRT-Connect. ICRA 2000.
    .. [3] S. LaValle: Planning Algorithms. Cambridge University Press, 2006.

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
        """SAFE_RRT-CONNECT."""
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
