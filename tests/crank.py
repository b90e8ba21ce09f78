"""A ball that one joint turns, other balls, and a danger of the angle: reports on its paths are computed by hand."""

from types import SimpleNamespace

import numpy as np

from safe_ompl import CollisionChecker, Obstacle, PathReport, Pose, Scene, Sphere

CRANK = """<robot name="crank"><link name="base"/>
  <link name="ball"><collision><origin xyz="0.5 0 0"/><geometry><sphere radius="0.05"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="ball"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""


def balls(*distances):
    """Balls of 0.05 m on the x axis, at these distances from the origin."""
    return Scene(tuple(Obstacle(f"ball{k}", Sphere(0.05), Pose((d, 0, 0))) for k, d in enumerate(distances)))


class Field:
    """Stands for a danger field: a function of the joint value of the crank, of which nothing can be proven."""

    robot = SimpleNamespace(within_limits=lambda q: np.array([False]))  # then nothing is proven

    def __init__(self, function):
        self.function = function

    def frozen(self):
        return self

    def values(self, Q):
        return self.function(Q[:, 0])


def report(robot, path, scene=None, function=None):
    checker = CollisionChecker(robot, scene or Scene())
    return PathReport.of(np.array(path, dtype=float), checker, function and Field(function))


def distance(q, ball):
    """Between the crank's ball at joint value `q` and a ball on the x axis."""
    return np.sqrt(0.25 + ball**2 - ball * np.cos(q)) - 0.1
