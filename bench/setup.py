"""What a setup costs, and what it costs that obstacles move.

Scenes of 12 obstacles and a person. CPU time of each part, in ms and as a ratio to one collision query of the same
process. Bars: SafeSetup of a known robot 10 ms; moving one obstacle or the person 1 ms, with the checker and the danger
field; what `plan` does besides planning after such a move 5 ms.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import process_time

import numpy as np

from bench._harness import Report
from bench._scenes import free_configuration, scattered
from safe_ompl import CollisionChecker, DangerField, Obstacle, Person, Pose, Robot, SafeSetup, Scene
from safe_ompl.common import FloatArray
from safe_ompl.geometry import STANDING

CLAIM = "a new scene takes milliseconds, a person who moves less"
OBSTACLES = 12
MOVABLE = ("obstacle 3", "obstacle 4", "person")


def scene(seed: int) -> Scene:
    """Return obstacles and a person beside the robot."""
    person = Obstacle("person", Person(), Pose((0.9, 0.5, -0.7)))
    return scattered(OBSTACLES, seed).with_obstacles(person)


def key_points(rng: np.random.Generator) -> dict[str, FloatArray]:
    """Return the key points of someone who stands somewhere near, each of them shaken."""
    place = np.array([*rng.uniform(0.5, 1.2, 2) * rng.choice([-1, 1], 2), -0.7])
    return {name: 1.75 * point + place + rng.normal(0.0, 0.03, 3) for name, point in STANDING.items()}


def pose(rng: np.random.Generator) -> Pose:
    """Return a place within reach."""
    place = rng.uniform([-0.8, -0.8, 0.0], [0.8, 0.8, 1.0])
    return Pose.from_rpy(tuple(place), tuple(rng.uniform(-np.pi, np.pi, 3)))


@dataclass
class Part:
    """Something whose cost is measured; `begin` makes ready for it, and is not."""

    name: str
    run: Callable[[], object]
    begin: Callable[[], object] = lambda: None

    def cost(self) -> float:
        """Return the CPU time that it takes now [s]."""
        self.begin()
        begin = process_time()
        self.run()
        return process_time() - begin


class Cell:
    """A robot among obstacles, and the next scene that it is to know."""

    def __init__(self) -> None:
        self.robot = Robot.from_example("panda")
        self.rng = np.random.default_rng(0)
        self.checker = CollisionChecker(self.robot, scene(0), movable=MOVABLE)
        self.field = DangerField.of_scene(self.robot, scene(0))
        self.setup = SafeSetup(self.robot, scene(0), movable=MOVABLE)
        self.q = self._free()
        self.setup.setConfigurations(self.q, self._free())
        self.scene = scene(0)
        self.seed = 0

    def _free(self) -> FloatArray:
        return free_configuration(self.setup.checker, self.rng)

    def another_scene(self) -> None:
        """Go on to a scene that nothing is known of."""
        self.seed += 1
        self.scene = scene(self.seed)

    def a_new_robot(self) -> None:
        """Go on to one, which nothing has been made for."""
        self.another_scene()
        self.stranger = Robot.from_example("panda")

    def choose_places(self) -> None:
        """Choose where all that moves goes next."""
        self.places = {name: key_points(self.rng) if name == "person" else pose(self.rng) for name in MOVABLE}

    def move(self, name: str) -> None:
        """Move an obstacle or the person there, with checker and danger field."""
        scene = self.checker.scene.moved({name: self.places[name]})
        self.checker.move(scene)
        self.field.move(scene)

    def move_in_setup(self) -> None:
        """Move an obstacle a little, and forget the solution."""
        self.setup.moveObstacle("obstacle 3", Pose((2.0, 2.0, self.rng.uniform(0.0, 1.0))))

    def prepare(self) -> None:
        """Do what `plan` does before planning."""
        self.setup.prepare("SafeRRTConnect", 0)

    def parts(self) -> Iterator[Part]:
        """Yield all that is measured."""
        robot, known = self.robot, lambda: SafeSetup(self.robot, self.scene)
        yield Part("one collision query", lambda: [self.checker.touches(self.q) for _ in range(100)])
        yield Part("Robot, from its files", lambda: Robot.from_example("panda"))
        yield Part("SafeSetup, new robot", lambda: SafeSetup(self.stranger, self.scene), self.a_new_robot)
        yield Part("SafeSetup, known robot", known, self.another_scene)
        yield Part("  CollisionChecker", lambda: CollisionChecker(robot, self.scene), self.another_scene)
        yield Part("  DangerField", lambda: DangerField.of_scene(robot, self.scene), self.another_scene)
        yield Part("simplifier of a setup", lambda: self.fresh.simplifier, self._fresh_setup)
        yield Part("moving an obstacle", lambda: self.move("obstacle 3"), self.choose_places)
        yield Part("moving the person", lambda: self.move("person"), self.choose_places)
        yield Part("moveObstacle of a setup", self.move_in_setup)
        yield Part("before planning after that", self.prepare, self.move_in_setup)

    def _fresh_setup(self) -> None:
        self.another_scene()
        self.fresh = SafeSetup(self.robot, self.scene)


def costs(cell: Cell, rounds: int) -> list[tuple[object, ...]]:
    """Return the rows of the table of costs."""
    parts = list(cell.parts())
    for part in parts:
        part.cost()  # warms up
    taken = np.array([[part.cost() for part in parts] for _ in range(rounds)])
    taken[:, 0] /= 100  # queries
    medians, ratios = np.median(taken, axis=0), np.median(taken / taken[:, :1], axis=0)
    return [
        (part.name, 1e3 * float(time), float(ratio)) for part, time, ratio in zip(parts, medians, ratios, strict=True)
    ]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--rounds", type=int, default=15)


def main(options: argparse.Namespace, report: Report) -> None:
    """Report costs."""
    report.table(("part", "CPU [ms]", "collision queries"), costs(Cell(), options.rounds))
