"""The pictures of the pages in docs/, some minutes.

That of the viewer is a picture of a headless Chromium's window (selenium, `chromium` and `chromium-driver`). Those of
`panda_shelf` are `paths.png` of `safe-ompl compare panda_shelf --out out`, and what `safe-ompl view panda_shelf
--animation docs/panda_shelf.webp` writes.
"""

from __future__ import annotations

import argparse
import io
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image

from bench._harness import Report
from safe_ompl import (
    Box,
    CollisionChecker,
    DangerField,
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
    plan,
)
from safe_ompl.apps.cli.program import main as safe_ompl_command
from safe_ompl.collision import bubbles
from safe_ompl.common import FloatArray
from safe_ompl.drawing import ViewerContent, read_recording, render_comparison, render_path, save_picture
from safe_ompl.drawing.drawn_scene import DrawnScene, best_view
from safe_ompl.drawing.plots import plot_speeds
from safe_ompl.drawing.viewer import save_page
from safe_ompl.geometry import STANDING
from safe_ompl.io import EmbeddedProblem, MotionRecord
from safe_ompl.live.skeletons import find_skeleton
from safe_ompl.planning import setup_scenario

CLAIM = "the pictures of the pages"
ROOT = Path(__file__).parents[1]
OUT = ROOT / "docs" / "pictures"
WORKER = Obstacle("worker", Person(height=1.75), Pose((1.0, 0.0, -0.8), (0.0, 0.0, 1.0, 0.0)))
LEFT, RIGHT = [0.9, -1.6, 1.6, -1.6, -1.57, 0.0], [-0.9, -1.6, 1.6, -1.6, -1.57, 0.0]
SIZE = (760, 480)
_PATIENCE, _SETTLED = 120.0, 20.0  # [s] for a page to load, and to be drawn without a graphics card


def own_robot() -> None:
    """Draw the arm of the examples on its way past a post."""
    robot = Robot.from_urdf(ROOT / "examples" / "arm.urdf", tip="tool")
    scene = Scene((Obstacle("post", Box((0.1, 0.1, 0.8)), Pose((0.45, 0.0, 0.4)), weight=1.0),))
    setup = SafeSetup(robot, scene)
    setup.setConfigurations([1.0, 1.0, 0.6, 0.0], [-1.0, 1.0, 0.6, 0.0])
    path = setup.plan("SafeRRTConnect", time=5.0, seed=0, simplify=True).path
    save_picture(render_path(robot, scene, path, size=SIZE), OUT / "your-robot.png")


def simplification() -> None:
    """Draw a path as planned, and simplified."""
    robot, scene = Robot.from_example("ur5"), Scene((WORKER,))
    setup = SafeSetup(robot, scene)
    setup.setConfigurations(LEFT, RIGHT)
    paths = {}
    for name, simplify in (("as planned", False), ("simplified", True)):
        paths[name] = replace(setup.plan("RRTConnect", time=5.0, seed=1, simplify=simplify), planned_path=None)
    render_comparison(robot, scene, paths, OUT / "simplification.png", panel=(460, 400))


def danger() -> None:
    """Draw contours of the danger field of a level arm at two configurations."""
    robot = Scenario.load("planar2").build_robot()
    line = np.linspace(-1.25, 1.25, 241)
    x, y = np.meshgrid(line, line)
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    field, figure = DangerField(robot, points), Figure(figsize=(8.5, 4.2), dpi=110, layout="constrained")
    panels, poses = figure.subplots(1, 2, sharey=True), ([0.3, 0.4], [0.9, -1.8])
    values = [field.field(np.array(q), points).reshape(x.shape) for q in poses]
    finite = np.array(values)[np.isfinite(values)]
    levels = np.geomspace(finite.min(), np.quantile(finite, 0.985), 14)  # the area between two shrinks evenly
    for axes, q, value in zip(panels, poses, values, strict=True):
        shades = axes.contourf(x, y, value, levels, cmap="YlOrRd", extend="both")
        axes.contour(x, y, value, levels, colors="white", linewidths=0.6)
        draw_arm(axes, robot, np.array(q), "0.25")
        axes.set(aspect="equal", xlabel="x [m]")
    figure.colorbar(shades, ax=panels, label="danger field [1/m]", format="%.1f")
    FigureCanvasAgg(figure).print_png(OUT / "danger.png")


def free_bubbles() -> None:
    """Draw an arm of two joints at two configurations, and its bubbles of free configurations there.

    Of each bubble is drawn all that one distance query proves free, and within it the diamond of all links' distances
    (solid), the paper's diamond (9, dashed), and the cube (dotted).
    """
    setup = setup_scenario(Scenario.load("planar2"))
    robot, checker = setup.robot, setup.checker
    figure = Figure(figsize=(9.4, 4.7), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    for obstacle in setup.scene:
        vertices, faces = obstacle.triangles()
        colour = "#d9822b" if obstacle.weight else "#b9bdc4"
        left.add_collection(PolyCollection(vertices[faces][:, :, :2], facecolors=colour))
    x, y = np.meshgrid(*(np.linspace(low, high, 181) for low, high in zip(robot.lower, robot.upper, strict=True)))
    touches = [checker.in_collision(q) for q in np.stack([x, y], axis=-1).reshape(-1, 2)]
    right.contourf(x, y, np.reshape(touches, x.shape), [0.5, 1.5], colors=["0.72"])
    for q, colour in (([0.5, 0.5], "#0b62b4"), ([-1.2, 0.9], "#7d2f91")):
        draw_arm(left, robot, np.array(q), colour)
        draw_bubble(right, checker, np.array(q), colour)
    left.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title="workspace")
    names = [f"{name} [rad]" for name in robot.joint_names]
    right.set(aspect="equal", xlabel=names[0], ylabel=names[1], title="configuration space")
    right.set(xlim=(robot.lower[0], robot.upper[0]), ylim=(robot.lower[1], robot.upper[1]))
    FigureCanvasAgg(figure).print_png(OUT / "bubbles.png")


def draw_arm(axes: Any, robot: Robot, q: FloatArray, colour: str) -> None:
    """Draw the skeleton of an arm that moves in a level plane, at `q: (n,)`."""
    axes.plot(*robot.keypoints(q)[:, :2].T, "-o", color=colour, linewidth=7, markerfacecolor="white", markersize=5)


def draw_bubble(axes: Any, checker: CollisionChecker, q: FloatArray, colour: str) -> None:
    """Draw a bubble of free configurations about `q: (2,)`, and the shapes within it."""
    radii, distances = checker.pair_radii_at(q), checker.pair_distances(q)
    radii, distances = radii[radii.any(axis=1)], distances[radii.any(axis=1)]
    dx, dy = np.meshgrid(*[np.linspace(-np.pi, np.pi, 721)] * 2)
    reach = [(r[0] * abs(dx) + r[1] * abs(dy)) / d for r, d in zip(radii, distances, strict=True)]
    axes.contourf(q[0] + dx, q[1] + dy, np.max(reach, axis=0), [-1.0, 1.0], colors=[colour], alpha=0.22)
    paper = bubbles.common_diamond(checker.robot.bounds.displacement_radii_at(q), distances)
    for weights, dashes in ((bubbles.link_diamond(radii, distances), "-"), (paper, "--")):
        a, b = bubbles.extents(weights)
        axes.plot(q[0] + [a, 0, -a, 0, a], q[1] + [0, b, 0, -b, 0], dashes, color=colour, linewidth=1.8)
    axes.plot(*q, "o", color=colour, markersize=6)


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
    save_picture(picture, OUT / "scene.png")


def people_and_time() -> None:
    """Draw the speed of a motion beside a person, and what bounds it."""
    robot, scene = Robot.from_example("ur5"), Scene((WORKER,))
    setup = SafeSetup(robot, scene)
    setup.setConfigurations(LEFT, RIGHT)
    result = setup.plan("RRTConnect", time=5.0, seed=1)
    people = People(speed=1.0, reaction_time=0.1)
    trajectory = result.timed(RateLimits.of(robot, acceleration=[12.0] * 6), people=people)
    record = MotionRecord.of(trajectory, EmbeddedProblem(robot, scene, None))
    title = "Past a worker: speed, and what bounds it"
    plot_speeds(record.motion.times, record.speeds, record.bounds, record.binding, OUT / "speeds.png", title=title)


def a_drive() -> None:
    """Draw moments of a robot that is driven beside a person who reaches in front of it, and goes again."""
    with tempfile.TemporaryDirectory() as folder:
        recording = f"{folder}/reaching.npz"
        save_reaching(recording)
        options = ["--people", recording, "--seconds", "14", "--simplify", "0.3", "--out", folder]
        safe_ompl_command(["live", "ur5_handover", *options])
        draw_moments(f"{folder}/ticks.jsonl")


def save_reaching(file: str) -> None:
    """Write a recording of a person who stretches her right arm out and draws it back, every six seconds."""
    skeleton, height = find_skeleton("recording12"), 1.75
    bones = {"upper_arm": "shoulder", "forearm": "elbow", "hand": "wrist"}
    places = {"hip": [0, 0, STANDING["left_hip"][2]], "torso": [0, 0, 0.65], "neck": [0, 0, 0.82]}
    places["head"] = STANDING["head"]
    for side in ("left", "right"):
        places[f"{side}_collar"] = [0, 0, 0.8]
        places |= {f"{side}_{bone}": STANDING[f"{side}_{joint}"] for bone, joint in bones.items()}
    standing = height * np.array([places[name] for name in skeleton.points])
    shoulder, elbow, hand = (skeleton.points.index(f"right_{bone}") for bone in bones)
    upper, whole = (np.linalg.norm(standing[k] - standing[shoulder]) for k in (elbow, hand))
    frames = []
    for time in np.arange(0.0, 12.0, 0.05):
        share = max(0.0, np.sin(2.0 * np.pi * time / 6.0 - 1.2)) ** 2
        direction = np.array([np.sin(1.35 * share), 0.1, -np.cos(1.35 * share)])
        direction /= np.linalg.norm(direction)
        frame = standing.copy()
        frame[elbow], frame[hand] = (standing[shoulder] + length * direction for length in (upper, whole))
        frames.append(frame + np.array([0.4 * share - 0.35, 0.0, 0.0]))
    np.savez(file, names=np.array(skeleton.points), rate=20.0, clip_0=np.array(frames))


def draw_moments(ticks: str) -> None:
    """Draw moments of a drive: on the way, slowed, standing before a hand, and on the way again."""
    content = read_recording(ticks)
    record, movers = content.motions["live"], content.movers
    assert movers is not None
    motion, states = record.motion, np.array(record.binding)
    stands = int(np.flatnonzero((states == "standing") & (motion.times > 1.0))[0])
    slowed = int(np.flatnonzero((states != "standing")[:stands])[-1]) - 4
    goes = stands + int(np.flatnonzero(states[stands:] == "moving")[0]) + 12
    shown = [max(stands - 30, 0), slowed, stands + 10, min(goes, len(states) - 1)]
    still = [obstacle for obstacle in content.scene if not isinstance(obstacle.shape, Person)]
    scenes = [Scene((*still, *movers.people_at(motion.times[k]))) for k in shown]
    panel = (420, 400)
    people = [replace(person, name=f"{person.name} {k}") for k in shown for person in movers.people_at(motion.times[k])]
    camera = best_view(DrawnScene(content.robot, Scene((*still, *people)), [motion.knots[shown]]), panel)
    images = [
        render_path(content.robot, scene, motion.knots[[k, k]], size=panel, ghosts=0, camera=camera)
        for scene, k in zip(scenes, shown, strict=True)
    ]
    words = [f"{motion.times[k]:.1f} s: {record.binding[k]}" for k in shown]
    save_strip(images, words, OUT / "live.png")


def viewer() -> None:
    """Photograph the page of a motion in time, as the browser shows it half-way; needs Chromium and its driver."""
    scenario = Scenario.load("panda_shelf")
    result = plan(scenario, seed=0, simplify=True)
    limits = RateLimits.of(result.robot, acceleration=[8.0] * result.robot.n)
    trajectory = result.timed(limits, people=scenario.people)
    problem = EmbeddedProblem(result.robot, result.scene, result.danger)
    record = MotionRecord.of(trajectory, problem, name="SafeRRTConnect")
    from selenium import webdriver
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.ui import WebDriverWait

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for option in (
        *("headless", "no-sandbox", "use-angle=swiftshader", "enable-unsafe-swiftshader"),
        *("window-size=1000,900", "lang=en-US"),
    ):
        options.add_argument(f"--{option}")
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "view.html"
        save_page(ViewerContent.of_motions([record]), page)
        driver = webdriver.ChromeService(shutil.which("chromedriver"))
        with webdriver.Chrome(options=options, service=driver) as browser:
            browser.get(page.as_uri())
            bar = WebDriverWait(browser, _PATIENCE).until(
                lambda b: b.find_element("css selector", "input[inputmode=decimal]")
            )
            bar.send_keys(Keys.CONTROL, "a")
            bar.send_keys(f"{0.45 * record.motion.duration:.2f}", Keys.ENTER)
            sleep(_SETTLED)
            for notice in browser.find_elements("css selector", ".mantine-Notification-closeButton"):
                notice.click()  # that it is drawn without a graphics card
            sleep(1.0)
            picture = Image.open(io.BytesIO(browser.get_screenshot_as_png()))
            picture.convert("RGB").quantize(256).save(OUT / "viewer.png", optimize=True)


def robots() -> None:
    """Draw four arms of example-robot-data."""
    postures = {
        "panda": [0.3, -0.4, 0, -2.2, 0, 1.9, 0.8],
        "ur10": [0.4, -1.2, 1.5, -1.9, -1.57, 0.0],
        "kinova": [0.5, 3.6, 1.9, 0.4, 1.2, 0.3],
        "xarm7": [0.3, -0.4, 0, 0.9, 0, 1.3, 0],
    }
    images = []
    for name, q in postures.items():
        robot, way = Robot.from_example(name), np.array([q, q])
        images.append(render_path(robot, Scene(), way, size=(300, 340), ghosts=0))
    save_strip(images, list(postures), OUT / "robots.png")


def region() -> None:
    """Draw a region of the tip, and a path to it."""
    setup = setup_scenario(Scenario.load("ur5_handover"))
    result = setup.plan("SafeRRTConnect", time=5.0, seed=0, simplify=True)
    tip = setup.robot.tip_pose(result.path[-1]).translation
    ring = Obstacle("region", Box((0.26, 0.22, 0.012)), Pose(tuple(tip)), color=(0.2, 0.75, 0.4))
    scene = Scene((*setup.scene, ring))
    save_picture(render_path(setup.robot, scene, result.path, size=SIZE), OUT / "goals.png")


def save_strip(images: list, words: list, file: Path) -> None:
    """Save pictures side by side, with words above each."""
    height, width = images[0].shape[:2]
    total, gap, head = len(images) * (width + 8) - 8, 8, 30
    figure = Figure(figsize=(total / 100, (height + head) / 100), dpi=100)
    for k, (image, said) in enumerate(zip(images, words, strict=True)):
        figure.figimage(image, k * (width + gap), 0, origin="upper")
        figure.text((k * (width + gap) + 3) / total, 1 - 20 / (height + head), said, fontsize=11)
    FigureCanvasAgg(figure).print_png(file)


PICTURES = {
    draw.__name__: draw
    for draw in (
        *(own_robot, simplification, danger, free_bubbles, scenes),
        *(people_and_time, a_drive, viewer, robots, region),
    )
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("pictures", nargs="*", help=f"of {', '.join(PICTURES)}; default: all")


def main(options: argparse.Namespace, report: Report) -> None:
    """Draw the pictures."""
    for name in options.pictures or PICTURES:
        PICTURES[name]()
        print(name)
    for file in OUT.glob("*.png"):  # fewer colours: a tenth of the bytes
        Image.open(file).convert("RGB").quantize(200, dither=Image.Dither.NONE).save(file, optimize=True)
