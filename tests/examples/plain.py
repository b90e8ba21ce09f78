"""An arm turns past a pillar: python plain.py arm.urdf arm.srdf meshes/."""

import sys

import coal
import numpy as np
import pinocchio as pin
from ompl import base as ob
from ompl import geometric as og

URDF, SRDF, MESHES = sys.argv[1:4]
PILLAR = {"name": "pillar", "box": {"size": [0.15, 0.15, 1.0]}, "position": [0.45, 0.0, 0.4], "weight": 1}
START, GOAL = [0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0]

model = pin.buildModelFromUrdf(URDF)
bodies = pin.buildGeomFromUrdf(model, URDF, pin.COLLISION, package_dirs=[MESHES])
place = pin.SE3(np.eye(3), np.array(PILLAR["position"]))
pillar = pin.GeometryObject("pillar", 0, place, coal.Box(*PILLAR["box"]["size"]))
bodies.addGeometryObject(pillar)
bodies.addAllCollisionPairs()
pin.removeCollisionPairs(model, bodies, SRDF)
data, contacts = model.createData(), pin.GeometryData(bodies)
for request in contacts.collisionRequests:
    request.enable_contact = True  # coal misses overlaps otherwise


def is_valid(state):
    """Return whether the arm touches neither the pillar nor itself."""
    return not pin.computeCollisions(model, data, bodies, contacts, np.array(state[0 : model.nq]), True)


space = ob.RealVectorStateSpace(model.nq)
bounds = ob.RealVectorBounds(model.nq)
for i in range(model.nq):
    bounds.setLow(i, model.lowerPositionLimit[i])
    bounds.setHigh(i, model.upperPositionLimit[i])
space.setBounds(bounds)

ss = og.SimpleSetup(space)
ss.setStateValidityChecker(is_valid)
start, goal = space.allocState(), space.allocState()
start[0 : model.nq], goal[0 : model.nq] = START, GOAL
ss.setStartAndGoalStates(start, goal)
ss.setPlanner(og.RRTConnect(ss.getSpaceInformation()))
if ss.solve(10.0):
    print(ss.getSolutionPath().printAsMatrix())
