"""The third study: scenes drawn at random from a fixed seed, none left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from _paper.evidence import COLUMNS
from _paper.store import Store
from _paper.studies import Pair, with_crossed
from _paper.tables import markdown_table
from safe_ompl.apps.benchmark.campaign import Campaign
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.common import FloatArray
from safe_ompl.geometry.basic import Box, Shape, Sphere
from safe_ompl.geometry.obstacle import Obstacle
from safe_ompl.geometry.pose import Pose
from safe_ompl.planning.result import PlanResult
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scenario import Goal, Scenario, find_scenario
from safe_ompl.scene.scene import Scene

SCENES, SEED = 30, 2013
TIME = 5.0  # [s] for each run
OMPLS = "RRTConnect"  # says which scenes are hard, and for whom
_MODEL = "paper_1"  # whose arm, floor and planners' parameters are taken
_SPACING = 0.15  # [m] of danger points
_ROOM = 0.3  # [m] around the base's axis that stays empty
_FEWEST, _MOST = 4, 10  # obstacles


def random_scenarios(number: int = SCENES) -> list[Scenario]:
    """Return the scenes: the paper's arm between boxes and balls, from one free configuration to another.

    Every scene that the seed yields is one of them, however easy or hard, and whether or not it can be solved.
    """
    model = replace(Scenario.load(find_scenario(_MODEL)), time=TIME)
    robot = model.build_robot()
    return [_scenario(model, robot, k) for k in range(number)]


def _scenario(model: Scenario, robot: Robot, k: int) -> Scenario:
    rng = np.random.default_rng([SEED, k])
    floor = next(obstacle for obstacle in model.scene.obstacles if obstacle.name == "floor")
    scene = Scene((floor, *_obstacles(rng)), spacing=_SPACING)
    checker = CollisionChecker(robot, scene)
    start, goal = (_free_configuration(rng, robot, checker) for _ in range(2))
    tip = robot.tip_pose(goal).translation
    return replace(
        model,
        name=f"random_{k}",
        description=f"Scene {k} of the random ones.",
        scene=scene,
        start=tuple(start.tolist()),
        goal=Goal(configurations=(tuple(goal.tolist()),), position=tuple(tip.tolist())),
    )


def _obstacles(rng: np.random.Generator) -> list[Obstacle]:
    """Return boxes and balls off the base's axis; the first is dangerous to approach, each other with probability ½."""
    obstacles: list[Obstacle] = []
    number = int(rng.integers(_FEWEST, _MOST + 1))
    while len(obstacles) < number:
        place = rng.uniform([-0.9, -0.9, 0.05], [0.9, 0.9, 1.1])
        sides, is_box = rng.uniform(0.08, 0.4, 3), rng.random() < 0.5
        shape: Shape = Box(tuple(sides.tolist())) if is_box else Sphere(float(sides[0]) / 2)
        turn = tuple(rng.uniform(-np.pi, np.pi, 3).tolist())
        if np.hypot(*place[:2]) > _ROOM:
            weight = 1.0 if rng.random() < 0.5 or not obstacles else 0.0
            pose = Pose.from_rpy(tuple(place.tolist()), turn)
            obstacles.append(Obstacle(f"obstacle_{len(obstacles)}", shape, pose, weight=weight))
    return obstacles


def _free_configuration(rng: np.random.Generator, robot: Robot, checker: CollisionChecker) -> FloatArray:
    while True:
        q: FloatArray = rng.uniform(robot.lower, robot.upper)
        if not checker.in_collision(q):
            return q


# --------------------------------------------------------------------------------------------------- runs


def scene_campaigns(
    folder: Path, pairs: Sequence[Pair], runs: int, scenarios: Sequence[Scenario]
) -> Iterator[tuple[Store, list[Campaign]]]:
    """Yield the store of each scene, and what is left to do there; planners that are deterministic run once."""
    for scenario in scenarios:
        store = Store(folder / scenario.name, scenario)
        todo = []
        for deterministic, number in ((True, 1), (False, runs)):
            names = [n for pair in pairs if pair.deterministic == deterministic for n in pair.planners]
            names += [] if deterministic else [OMPLS]
            if names:
                todo.append(Campaign(scenario, names, number, done=store.done()))
        yield store, [campaign for campaign in todo if len(campaign)]


class Row(NamedTuple):
    """What one run of a planner on one scene came to; NaN where it was not solved."""

    solved: bool
    time: float
    nodes: float
    checks: float
    danger: float


@dataclass(frozen=True)
class RandomStudy:
    """The runs on all scenes.

    Attributes
    ----------
    pairs : tuple of Pair
        The planners.
    rows : mapping of str to list of list of Row
        Planner → scene → its runs.
    """

    pairs: tuple[Pair, ...]
    rows: Mapping[str, Sequence[Sequence[Row]]]

    @classmethod
    def of(cls, stores: Sequence[Store], pairs: Sequence[Pair]) -> RandomStudy:
        """Sort the results of all scenes by planner."""
        names = [OMPLS, *(name for pair in pairs for name in pair.planners)]
        rows: dict[str, list[list[Row]]] = {name: [] for name in names}
        for store in stores:
            results = store.results()
            for name, own in rows.items():
                own.append([_row(result) for result in results if result.planner == name])
        return cls(tuple(pairs), rows)

    def table(self) -> str:
        """Return a row for each planner: what it solved, and medians over the solved runs."""
        header = ("", "scenes solved", "always", "runs", "time [ms]", "nodes", "checks", "mean danger")
        return markdown_table(header, [self._cells(name) for name in self.rows])

    def ratios(self) -> str:
        """Return a row for each pair: safe divided by classical on the scenes that both solved."""
        header = ("safe / classic", "scenes", "mean danger", "lower in", "time", "nodes", "checks")
        return markdown_table(header, [self._ratio_cells(pair) for pair in with_crossed(self.pairs)])

    def _cells(self, name: str) -> tuple[str, ...]:
        scenes = self.rows[name]
        runs = [run for scene in scenes for run in scene]
        solved = [run for run in runs if run.solved]
        medians = np.median([run[1:] for run in solved], axis=0) if solved else np.full(4, np.nan)
        return (
            name,
            f"{sum(any(run.solved for run in scene) for scene in scenes)}/{len(scenes)}",
            f"{sum(all(run.solved for run in scene) for scene in scenes)}/{len(scenes)}",
            f"{len(solved)}/{len(runs)}",
            f"{1e3 * medians[0]:.1f}",
            *(f"{value:.0f}" for value in medians[1:3]),
            f"{medians[3]:.2f}",
        )

    def _ratio_cells(self, pair: Pair) -> tuple[str, ...]:
        classic, safe = (self._means(name) for name in pair.planners)
        both = np.isfinite(classic[:, 3]) & np.isfinite(safe[:, 3])
        if not both.any():
            return pair.title, "0", *["–"] * 5
        ratios = np.exp(np.log(safe[both] / np.maximum(classic[both], 1e-9)).mean(axis=0))
        lower = int((safe[both, 3] < classic[both, 3]).sum())
        time, nodes, checks, danger = (f"{ratio:.2f}" for ratio in ratios)
        return pair.title, str(both.sum()), danger, f"{lower}/{both.sum()}", time, nodes, checks

    def _means(self, name: str) -> FloatArray:
        """Return means (scenes, 4) over the solved runs of a planner; NaN where it solved none."""
        means = []
        for scene in self.rows[name]:
            solved = [run[1:] for run in scene if run.solved]
            means.append(np.maximum(np.mean(solved, axis=0), 1e-9) if solved else np.full(4, np.nan))
        return np.array(means)


def _row(result: PlanResult) -> Row:
    if not result.solved or result.report is None or result.report.danger is None:
        return Row(False, *[float("nan")] * 4)
    effort = (float(COLUMNS[name](result)) for name in ("time", "nodes", "checks"))
    return Row(True, *effort, result.report.danger.mean)


def random_section(study: RandomStudy) -> str:
    """Return the section of the report."""
    scenes = len(study.rows[OMPLS])
    return "\n\n".join(
        [
            f"## Study 3: {scenes} scenes at random, none left out",
            f"The paper's arm between {_FEWEST} to {_MOST} boxes and balls, from one random free configuration to "
            f"another (seed {SEED}). Nothing was selected: scenes that need no planning, and scenes that nobody "
            f"solves in {TIME:g} s, are among them. A scene is solved always if every run solved it. The other numbers "
            "are medians over the solved runs, so that a planner that solves only what is easy looks quick. "
            f"{OMPLS} is OMPL's own.",
            study.table(),
            "Safe divided by classical: geometric means over the scenes that both solved, of each scene's means.",
            study.ratios(),
        ]
    )
