"""Plan with OMPL's PRM in a plain SimpleSetup that has our checkers."""

import numpy as np
from ompl import base as ob
from ompl import geometric as og

from safe_ompl import CertifiedMotionValidator, CollisionFreeValidity
from safe_ompl.apps.cli.arguments import load_scenario
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.ompl import StateBridge, joint_space

ours = setup_scenario(load_scenario("planar2"))
setup = og.SimpleSetup(joint_space(ours.robot))
si, bridge = setup.getSpaceInformation(), StateBridge(setup.getStateSpace())
validity, validator = CollisionFreeValidity(si, ours.checker), CertifiedMotionValidator(si, ours.checker)
setup.setStateValidityChecker(validity)
si.setMotionValidator(validator)
ends = [setup.getStateSpace().allocState() for _ in range(2)]
for state, q in zip(ends, (ours.problem.start, ours.problem.goals[0]), strict=True):
    bridge.write(np.asarray(q), state)
setup.setStartAndGoalStates(*ends)
setup.setPlanner(og.PRM(si))
print(setup.solve(5.0) == ob.PlannerStatus.EXACT_SOLUTION, flush=True)
