"""The pictures of the pages in docs/, by one command: `python bench/pages.py`, about a minute.

That of the viewer is a picture of the browser's window, taken by hand; those of `panda_shelf` are made by
`safe-ompl view --animation` and `safe-ompl compare`, as the README says.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from safe_ompl import (
    Box,
    Obstacle,
    People,
    Person,
    PointCloud,
    Pose,
    RateLimits,
    Robot,
    SafeSetup,
    Scenario,
    Scene,
)
from safe_ompl.exchange.timed_motion import TimedMotion
from safe_ompl.pictures.plots import plot_bubbles, plot_field, plot_profiles, plot_speeds
from safe_ompl.pictures.render import render_comparison, render_path, save_png
from safe_ompl.scenario.scenario import find_scenario
from safe_ompl.setup.safe_setup import setup_scenario

ROOT = Path(__file__).parents[1]
OUT = ROOT / "docs" / "pictures"
WORKER = Obstacle("worker", Person(height=1.75), Pose((1.0, 0.0, -0.8), (0.0, 0.0, 1.0, 0.0)))
LEFT, RIGHT = [0.9, -1.6, 1.6, -1.6, -1.57, 0.0], [-0.9, -1.6, 1.6, -1.6, -1.57, 0.0]
SIZE = (760, 480)


def own_robot() -> None:
    """Draw the arm of the examples on its way past a post."""
    robot = Robot.from_urdf(ROOT / "examples" / "arm.urdf", tip="tool")
    scene = Scene((Obstacle("post", Box((0.1, 0.1, 0.8)), Pose((0.45, 0.0, 0.4)), weight=1.0),))
    setup = SafeSetup(robot, scene)
    setup.setConfigurations([1.0, 1.0, 0.6, 0.0], [-1.0, 1.0, 0.6, 0.0])
    path = setup.plan("SafeRRTConnect", time=5.0, seed=0, simplify=True).path
    save_png(render_path(robot, scene, path, size=SIZE), OUT / "your-robot.png")


def simplification() -> None:
    """Draw a path as planned, and simplified."""
    robot, scene = Robot.from_example("ur5"), Scene((WORKER,))
    setup = SafeSetup(robot, scene)
    setup.setConfigurations(LEFT, RIGHT)
    paths, words = {}, {}
    for name, simplify in (("as planned", False), ("simplified", True)):
        result = setup.plan("RRTConnect", time=5.0, seed=1, simplify=simplify)
        paths[name] = result.path
        words[name] = f"{result.report.length:.1f} rad, mean danger {result.report.danger.mean:.1f}"
    render_comparison(robot, scene, paths, OUT / "simplification.png", subtitles=words, panel=(460, 400))


def planar() -> None:
    """Draw the danger field of a level arm, and bubbles of its free configurations."""
    setup = setup_scenario(Scenario.load(find_scenario("planar2")))
    plot_field(setup.robot, [[0.3, 0.4], [0.9, -1.8]], OUT / "danger.png")
    plot_bubbles(setup.checker, [[0.5, 0.5], [-1.2, 0.9]], OUT / "bubbles.png")


def scenes() -> None:
    """Draw a scene with a person, shapes and a point cloud."""
    rng = np.random.default_rng(0)
    turn, height = rng.uniform(0.0, 2.0 * np.pi, 1500), rng.uniform(-0.1, 0.5, 1500)
    column = np.column_stack([0.1 + 0.1 * np.cos(turn), -0.7 + 0.1 * np.sin(turn), height])
    table = Obstacle("table", Box((1.4, 1.9, 0.04)), Pose((0.3, 0.0, -0.12)))
    cloud = Obstacle("scan", PointCloud(radius=0.012, points=column), color=(0.3, 0.5, 0.75))
    scene = Scene((table, cloud, WORKER))
    path = np.array([LEFT, LEFT])
    picture = render_path(Robot.from_example("ur5"), scene, path, size=SIZE, ghosts=0)
    save_png(picture, OUT / "scene.png")


def a_start_in_collision() -> None:
    """Draw a robot that stands in a wall."""
    robot = Robot.from_example("ur5")
    scene = Scene((Obstacle("wall", Box((0.1, 1.2, 1.0)), Pose((0.5, 0.0, 0.5))),))
    start = np.array([0.0, -0.5, 0.5, -1.5, -1.57, 0.0])
    save_png(render_path(robot, scene, np.array([start, start]), size=SIZE, ghosts=0), OUT / "collision.png")


def profiles() -> None:
    """Draw the mean danger along the paths of four planners."""
    scenario = Scenario.load(find_scenario("ur5_handover"))
    setup = setup_scenario(scenario)
    found = {}
    for planner in ("SafeRRTConnect", "ClassicRRTConnect", "SafePRM", "ClassicPRM"):
        runs = [setup.plan(planner, time=5.0, seed=seed) for seed in range(10)]
        found[planner] = np.array([run.report.danger.profile for run in runs if run])
    plot_profiles(found, OUT / "profiles.png", title="Mean danger along the path, ur5_handover, 10 runs each")


def people_and_time() -> None:
    """Draw the speed of a motion beside a person, and what bounds it."""
    robot, scene = Robot.from_example("ur5"), Scene((WORKER,))
    setup = SafeSetup(robot, scene)
    setup.setConfigurations(LEFT, RIGHT)
    result = setup.plan("RRTConnect", time=5.0, seed=1)
    people = People(speed=1.0, reaction_time=0.1)
    trajectory = result.timed(RateLimits.of(robot, acceleration=[12.0] * 6), people=people)
    motion = TimedMotion.of(trajectory, robot, scene)
    title = "Past a worker: speed, and what bounds it"
    plot_speeds(motion.times, motion.speeds, motion.bounds, motion.binding, OUT / "speeds.png", title=title)


if __name__ == "__main__":
    for draw in (own_robot, simplification, planar, scenes, a_start_in_collision, profiles, people_and_time):
        draw()
        print(draw.__name__)
    for file in OUT.glob("*.png"):  # fewer colours: a tenth of the bytes
        Image.open(file).convert("RGB").quantize(200, dither=Image.Dither.NONE).save(file, optimize=True)
