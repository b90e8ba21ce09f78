"""Draw a robot along a path, or the paths of several planners side by side, as pictures or animations (WebP, GIF)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from io import BytesIO
from os import cpu_count
from pathlib import Path
from textwrap import shorten, wrap
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from safe_ompl.collision import CollisionChecker
from safe_ompl.common import FloatArray, InputError, SafeOmplError, files
from safe_ompl.drawing.content import ViewerContent, safety_facts
from safe_ompl.drawing.drawn_scene import Camera, DrawnScene, best_view, resampled
from safe_ompl.drawing.page import plot_kind
from safe_ompl.drawing.plots import plot_check, plot_motion, plot_plan, plot_program
from safe_ompl.drawing.renderer import Renderer, tone_mapped
from safe_ompl.drawing.style import NEUTRAL, Colour, as_bytes, mixed, planner_styles
from safe_ompl.drawing.surfaces import ColouredSurface, Surface, obstacle_surfaces, tube
from safe_ompl.geometry import Person
from safe_ompl.motions import MotionCheck, Repair, Trajectory
from safe_ompl.planning import PlanResult
from safe_ompl.planning.simplification import PROFILE_POINTS, Curve, PathReport
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene
from safe_ompl.tasks import ProgramResult

if TYPE_CHECKING:
    # Importing SafeSetup needs OMPL, and drawing must work without OMPL.
    from safe_ompl.planning import SafeSetup

Image = NDArray[np.uint8]
"""Rows of pixels in sRGB: (height, width, 3)."""

ACCENT: Colour = (0.09, 0.42, 0.78)
START: Colour = (0.66, 0.67, 0.69)
# Coinciding bodies are inflated by this share of the size of the robot's motion, so that their surfaces differ.
_COINCIDENCE = 1e-3
# Radii of the tip's trace and of the trace before simplification, as shares of the size of the robot's motion.
TRACE, _THIN = 0.006, 0.0022
GHOSTS = 4
PALE: Colour = (1.0, 1.0, 1.0)
# The share of the accent colour in the first posture after the start.
_FIRST_TINT = 0.35


def render_path(
    robot: Robot,
    scene: Scene,
    path: FloatArray | PlanResult,
    *,
    size: tuple[int, int] = (900, 700),
    camera: Camera | None = None,
    ghosts: int = GHOSTS,
) -> Image:
    """Draw a robot along a path: the start in grey, the goal in colour, and translucent postures between them.

    The path is given as way points (N, n) [rad or m], between which the joints move linearly, or as a solved result. A
    result is drawn in the planner's colour, with one posture where the robot is closest to an obstacle, and with the
    tip's path before simplification as a thin line. `ghosts` is the number of translucent postures. Returns an image
    (height, width, 3) of uint8 in sRGB; `size` is its width and height [px]. The default camera shows most of the robot
    and the people. Raises InputError if a path is empty, has the wrong number of joints or is not finite.
    """
    drawn = DrawnScene(robot, scene, [_way_points(path)])
    renderer = Renderer(drawn.floor, camera or best_view(drawn, size), size)
    accent = ACCENT
    if isinstance(path, PlanResult):
        accent = planner_styles([path.planner])[path.planner].colour
    return _draw(drawn, renderer, path, accent, ghosts)


def _way_points(path: FloatArray | PlanResult) -> FloatArray:
    if not isinstance(path, PlanResult):
        return path
    if path.path is None:
        raise InputError(f"{path.planner} found no path to draw: {path.status}")
    return path.path


def _draw(
    drawn: DrawnScene, renderer: Renderer, path: FloatArray | PlanResult, accent: Colour, ghosts: int = GHOSTS
) -> Image:
    """Draw one path of a scene; see `render_path`."""
    samples, closest, before = resampled(drawn.robot, _way_points(path)), None, None
    if isinstance(path, PlanResult):
        before = path.planned_path
        if path.report is not None and path.report.clearance.obstacle is not None:
            closest = path.report.clearance.at
    more = []
    if before is not None:
        planned = resampled(drawn.robot, before)
        more.append(ColouredSurface(trace(drawn, planned, _THIN), mixed(accent, PALE, 0.35)))
    shares = np.linspace(0.0, 1.0, ghosts + 2)[1:-1]
    if closest is not None and ghosts:
        shares[np.argmin(np.abs(shares - closest))] = closest
    return _postures(drawn, renderer, samples, shares, accent, more)


def _postures(
    drawn: DrawnScene,
    renderer: Renderer,
    samples: FloatArray,
    shares: FloatArray,
    accent: Colour,
    more: Sequence[ColouredSurface],
) -> Image:
    """Draw a robot along samples (S, n), with translucent postures at `shares` of the samples, and more surfaces."""
    start, goal = samples[0], samples[-1]
    gap = _COINCIDENCE * drawn.size
    things = [
        ColouredSurface(drawn.body.posed(start), START, glossy=True),
        ColouredSurface(drawn.body.posed(goal, moved_from=start).inflated(gap), accent, glossy=True),
        ColouredSurface(trace(drawn, samples, TRACE), accent),
        *drawn.surroundings(),
        *more,
    ]
    postures = [samples[round(share * (len(samples) - 1))] for share in shares]
    bodies = [drawn.body.posed(q, moved_from=start).inflated(-2.0 * gap) for q in postures]
    linear, layers = renderer.render_layers(things, [(body, _glass(body, renderer)) for body in bodies])
    picture = tone_mapped(linear)
    for share, layer in zip(shares, layers, strict=True):
        weight = _FIRST_TINT + (1.0 - _FIRST_TINT) * share
        tint = (1.0 - weight) * np.array(START) + weight * np.array(accent)
        picture = picture * (1.0 - layer[..., :1]) + tint * layer[..., 1:]
    return as_bytes(picture)


def trace(drawn: DrawnScene, samples: FloatArray, width: float) -> Surface:
    """Return the path of the tip as a tube. `width` is its radius as a share of the size of the robot's motion."""
    return Surface.from_triangles(*tube(drawn.trace(samples), width * drawn.size))


def _glass(body: Surface, renderer: Renderer) -> FloatArray:
    """Return the opacity of a translucent body at its vertices, and brightness times opacity, as an array (V, 2)."""
    to_eye = renderer.camera.eye - body.vertices
    to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
    facing = np.einsum("ij,ij->i", to_eye, body.normals)
    lit = np.clip((body.normals * np.sign(facing)[:, None]) @ renderer.camera.key_light(), 0.0, 1.0)
    opacity = 0.34 + 0.45 * (1.0 - np.abs(facing)) ** 3
    return np.column_stack([opacity, opacity * (0.72 + 0.44 * lit)])


# The compression of PNG files, from 0 to 9. Level 3 is twice as fast as 6, and the files are hardly larger.
_COMPRESSION = 3
_PROGRAM_SAMPLES = 600
# If the tips of several postures are closer together than this, only one posture is drawn.
_EQUAL_TIPS = 0.1  # [m]
# The resolution of the picture of a single plan. It is low because drawing must be quick.
_QUICK_DPI = 100


def draw_plan(setup: SafeSetup, result: PlanResult, file: str) -> None:
    """Draw the robot along a solved plan, and on the right the danger and clearance along the path."""
    assert result.path is not None
    assert result.report is not None
    assert result.report.danger is not None
    curves = plot_plan(
        result.report.danger.profile,
        None,
        clearance=_clearances(setup, result.path),
        planner=result.planner,
        title=f"{result.planner}, seed {result.seed}",
        dpi=_QUICK_DPI,
    )
    right = np.asarray(curves.canvas.buffer_rgba())[..., :3]
    size = len(right) * 5 // 4, len(right)
    left = render_path(setup.robot, setup.scene, result, size=size)
    save_picture(np.hstack([left, right]), file)


def draw_program(result: ProgramResult, file: str | Path) -> None:
    """Draw the robot at the ends of the steps of a program, the path of its tip, and on the right the steps over time.

    Objects that the robot moves are drawn at their first and last poses. Raises InputError if nothing was planned.
    """
    content = ViewerContent.of_program(result)
    (shown,) = content.motions.values()
    right = np.asarray(plot_program(result, None, dpi=_QUICK_DPI).canvas.buffer_rgba())[..., :3]
    size = len(right) * 5 // 4, len(right)
    drawn = DrawnScene(content.robot, content.scene, [shown.motion.knots])
    samples = shown.motion.at(np.linspace(0.0, shown.motion.duration, _PROGRAM_SAMPLES))
    ends = np.array([stretch.begin + stretch.motion.duration for stretch in result.stretches[:-1]])
    tips = drawn.trace(shown.motion.at(ends))
    apart = [k for k in range(len(ends)) if (np.linalg.norm(tips[:k] - tips[k], axis=1) > _EQUAL_TIPS).all()]
    moved = [] if content.movers is None else content.movers.obstacles_at(shown.motion.duration, content.scene)
    things = [surface for obstacle in moved for surface in obstacle_surfaces(obstacle)]
    renderer = Renderer(drawn.floor, best_view(drawn, size), size)
    left = _postures(drawn, renderer, samples, ends[apart] / shown.motion.duration, ACCENT, things)
    save_picture(np.hstack([left, right]), file)


def _clearances(setup: SafeSetup, path: FloatArray) -> dict[str, FloatArray]:
    """Return clearances [m] at equal steps of a path, separately from dangerous and from other obstacles, if any."""
    curve = Curve(setup.robot, path)
    samples = curve.at(np.linspace(0.0, curve.length, PROFILE_POINTS))
    distances = np.array([setup.checker.distances(q) for q in samples])
    owners = [setup.scene[obstacle] for _, obstacle in setup.checker.distance_names]
    people = all(isinstance(obstacle.shape, Person) for obstacle in owners if obstacle.weight > 0)
    kinds = {
        "people" if people else "what is dangerous": [obstacle.weight > 0 for obstacle in owners],
        "things": [obstacle.weight == 0 for obstacle in owners],
    }
    return {kind: distances[:, chosen].min(axis=1) for kind, chosen in kinds.items() if any(chosen)}


_CAPTION = "grey: start    colour: goal    translucent: on the way    line: path of the tip"
_PLANNED = ", thin: before it was simplified"
_GUTTER = 14  # [px] between panels
# The average width of a letter as a share of its height.
_LETTER = 0.56
# The colours of subtitles and of the caption.
_DARK, _GREY = (77, 77, 77), (102, 102, 102)
_LARGE = (760, 600)  # [px] of a panel
# Up to this many paths have panels of equal size. With more paths, the first two panels are large and the others small.
_MOST_ALIKE = 4


def render_comparison(
    robot: Robot,
    scene: Scene,
    paths: Mapping[str, FloatArray | PlanResult],
    file: str | Path,
    *,
    panel: tuple[int, int] | None = None,
    words: str = "",
) -> None:
    """Draw the robot along the path of each planner, one panel per planner, and save the picture; see `render_path`.

    `paths` maps planners to paths, which are drawn in the planner's colour. For results, the panel also states danger
    and clearance. `panel` is the width and height of a panel [px]; with more than four paths only the first two panels
    have this size, and the others are half as large. `words` are written above all panels. Raises InputError if there
    is no path or a path is invalid, and SafeOmplError if Matplotlib and Pillow are not installed.
    """
    styles = planner_styles(paths)
    large = panel or {1: (900, 700), 3: (620, 520)}.get(len(paths), _LARGE)
    sizes = [large] * len(paths)
    if len(paths) > _MOST_ALIKE:
        width = (large[0] - _GUTTER) // 2
        sizes[2:] = [(width, large[1] * width // large[0])] * (len(paths) - 2)
    drawn = DrawnScene(robot, scene, [_way_points(path) for path in paths.values()])
    camera = best_view(drawn, large)
    renderers = {size: Renderer(drawn.floor, camera, size) for size in dict.fromkeys(sizes)}
    panels = []
    for (name, path), size in zip(paths.items(), sizes, strict=True):
        image = _draw(drawn, renderers[size], path, styles[name].colour)
        panels.append(_Panel(image, name, "\n".join(_facts(path))))
    simplified = any(isinstance(path, PlanResult) and path.planned_path is not None for path in paths.values())
    save_picture(np.asarray(_panels(panels, words, _CAPTION + _PLANNED * simplified)), file)


def _facts(path: FloatArray | PlanResult) -> list[str]:
    return safety_facts(path.report) if isinstance(path, PlanResult) and path.report is not None else []


def save_picture(image: Image, file: str | Path) -> None:
    """Save an image (height, width, 3) of uint8 as PNG, SVG, PDF or WebP by file extension. Create missing folders."""
    kind = plot_kind(file)
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    try:
        from matplotlib.image import imsave
    except ImportError as missing:
        raise SafeOmplError("pictures need Matplotlib: pip install 'safe-ompl[plots]'") from missing
    with files.replacing(file, binary=True) as stream:
        imsave(stream, image, format=kind, pil_kwargs={"compress_level": _COMPRESSION} if kind == "png" else None)


class _Panel(NamedTuple):
    """An image with a title and a subtitle of one or several lines above it."""

    image: Image
    title: str
    subtitle: str

    @property
    def letters(self) -> tuple[int, int]:
        """The font sizes of title and subtitle [px]."""
        width = self.image.shape[1]
        return max(18, width // 30), max(15, width // 36)

    @property
    def heading(self) -> int:
        """The height of title and subtitle together [px]."""
        title, subtitle = self.letters
        return round(1.6 * title + 1.3 * subtitle * (1 + self.subtitle.count("\n")))


def _panels(panels: Sequence[_Panel], words: str = "", caption: str = "") -> Any:
    """Arrange panels in rows, with `words` above all panels and `caption` below, and return a Pillow image.

    If smaller panels follow the first two, the page is as wide as the first two. Otherwise the number of columns is
    chosen so that the rows are filled best.
    """
    try:
        from PIL import Image as Picture, ImageDraw
    except ImportError as missing:
        raise SafeOmplError("pictures need Pillow: pip install 'safe-ompl[plots]'") from missing
    count, first = len(panels), panels[0].image.shape[1]
    columns = count if count <= 3 else 2 if count == 4 else min((4, 3), key=lambda columns: -count % columns)
    if panels[-1].image.shape[1] < first:
        columns = 2
    width = columns * (first + _GUTTER) + _GUTTER
    small, large = max(14, width // 95), max(16, width // 75)
    lines = wrap(words, int(width / (_LETTER * large)))
    left, top = _GUTTER, round(1.5 * large * len(lines))
    places = []
    for k, panel in enumerate(panels):
        height, across = panel.image.shape[:2]
        if k and left + across > width:
            left, top = _GUTTER, top + panels[k - 1].heading + panels[k - 1].image.shape[0]
        places.append((left, top + panel.heading))
        left += across + _GUTTER
    bottom = places[-1][1] + height
    page = Picture.new("RGB", (width, bottom + (2 * small if caption else 0)), "white")
    pen = ImageDraw.Draw(page)
    for k, line in enumerate(lines):
        pen.text((_GUTTER + 2, round(1.5 * large * (k + 0.8))), line, "black", _font(large), "ls")
    for panel, (left, top) in zip(panels, places, strict=True):
        title, subtitle = panel.letters
        page.paste(Picture.fromarray(panel.image), (left, top))
        at = top - panel.heading + round(1.3 * title)
        pen.text((left + 2, at), panel.title, "black", _font(title, "-Bold"), "ls")
        for k, line in enumerate(panel.subtitle.split("\n"), 1):
            fitting = shorten(line, int(panel.image.shape[1] / (_LETTER * subtitle)), placeholder=" …")
            pen.text((left + 2, at + round(1.3 * subtitle * k)), fitting, _DARK, _font(subtitle), "ls")
    pen.text((_GUTTER + 2, bottom + round(1.4 * small)), caption, _GREY, _font(small), "ls")
    return page


def _font(pixels: int, style: str = "") -> Any:
    """Load the font that Matplotlib's plots use, in a size in pixels."""
    from matplotlib import get_data_path
    from PIL import ImageFont

    return ImageFont.truetype(str(Path(get_data_path(), "fonts", "ttf", f"DejaVuSans{style}.ttf")), pixels)


ANIMATION_ENDINGS = (".webp", ".gif")
PANEL = (420, 380)
RATE = 12.5  # [Hz]
FEWEST_FRAMES = 40
# The last frame is shown for this time.
_REST = 1.2  # [s]
# The quality of WebP, from 0 to 100.
_QUALITY = 80
# The share of the planner's colour in the colour of its robot.
_TINT = 0.45


def save_animation(content: ViewerContent, file: str | Path) -> None:
    """Write the motions of a view side by side as one animation (.webp or .gif).

    A timed motion is shown in real time, with the people and objects that move. The captions of paths state the danger
    and the distance to people; the captions of timed motions state the speed and the active limit. Raises InputError if
    there is no path or the extension is unknown, and SafeOmplError if Pillow is not installed.
    """
    if not content.paths:
        raise InputError("there is no path to show in motion")
    ending = Path(file).suffix.lower()
    if ending not in ANIMATION_ENDINGS:
        raise InputError(f"must end in {' or '.join(ANIMATION_ENDINGS)}, got {str(file)!r}", "animation")
    shares = np.linspace(0.0, 1.0, max(FEWEST_FRAMES, round(RATE * content.playing_time) + 1))
    paths = {name: content.along(name, shares) for name in content.paths}
    captions = [_captions(content, name, way, shares) for name, way in paths.items()]
    safest = f"Safest: {content.safest}" if content.safest else ""
    pages = [
        _panels([_Panel(*shown) for shown in zip(images, paths, [words[k] for words in captions], strict=True)], safest)
        for k, images in enumerate(_frames(content, paths, shares * content.playing_time))
    ]
    duration = round(1e3 * content.playing_time / (len(shares) - 1))  # [ms] of a frame
    stays = [duration] * (len(shares) - 1) + [round(1e3 * _REST)]
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    options: dict[str, Any] = {"quality": _QUALITY, "method": 5} if ending == ".webp" else {"optimize": True}
    options |= {"save_all": True, "append_images": pages[1:], "duration": stays, "loop": 0}
    with files.replacing(file, binary=True) as stream:
        pages[0].save(stream, ending[1:], **options)


def _frames(content: ViewerContent, paths: Mapping[str, FloatArray], times: FloatArray) -> Iterator[list[Image]]:
    """Yield the images of all paths (F, n) at each of the times (F,) [s], all with the same camera and light."""
    movers, styles = content.movers, planner_styles(paths)
    drawn = DrawnScene(content.robot, content.scene_at_start, list(paths.values()))
    obstacles = [[] if movers is None else movers.obstacles_at(t, content.scene) for t in times]
    moving = [[surface for one in there for surface in obstacle_surfaces(one)] for there in obstacles]
    still = drawn.surroundings({one.name for there in obstacles for one in there})
    reached = [drawn.landmarks(), *(thing.surface.vertices for things in (*moving, still) for thing in things)]
    renderer = Renderer(drawn.floor, best_view(drawn, PANEL), PANEL, still, np.vstack(reached))

    def pictures(k: int) -> list[Image]:
        images = []
        for name, path in paths.items():
            colour = styles[name].colour
            robot = ColouredSurface(drawn.body.posed(path[k]), mixed(NEUTRAL, colour, _TINT), glossy=True)
            way = ColouredSurface(trace(drawn, path[: k + 1], TRACE), colour)
            images.append(as_bytes(tone_mapped(renderer.render([robot, way, *moving[k]]))))
        return images

    with ThreadPoolExecutor(cpu_count()) as threads:
        yield from threads.map(pictures, range(len(times)))


def _captions(content: ViewerContent, name: str, way: FloatArray, shares: FloatArray) -> Sequence[str]:
    """Return the captions of the frames of one path."""
    if name in content.motions:
        return [content.motions[name].remark(float(share) * content.playing_time) for share in shares]
    field = content.danger_field
    dangers = None if field is None else field.values(way)
    checker = CollisionChecker(content.robot, Scene([o for o in content.scene if o.weight > 0]))
    captions = []
    for k, q in enumerate(way):
        found = checker.clearance(q)
        facts = [] if dangers is None else [f"danger {dangers[k]:.1f}"]
        facts += [] if found.obstacle is None else [f"{1e3 * found.distance:.0f} mm to {found.obstacle}"]
        captions.append("\n".join([f"here: {', '.join(facts)}", *content.facts(name)[:-1]]))
    return captions


# The size of a preview of a robot [px], and the resolution of a preview of a plot [dpi].
_PREVIEW_SIZE, _PREVIEW_DPI = (360, 280), 60  # [px]


def small_picture(shown: Any) -> bytes:
    """Return a small PNG image of a robot along its path, or of the plot of a report, a trajectory or a check.

    The result is empty if there is nothing to draw or Matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        return b""
    stream = BytesIO()
    shown = shown.check if isinstance(shown, Repair) else shown
    if isinstance(shown, PlanResult) and shown.robot is not None and shown.scene is not None:
        from matplotlib.image import imsave

        if shown.path is None:
            return b""
        imsave(stream, render_path(shown.robot, shown.scene, shown, size=_PREVIEW_SIZE), format="png")
    elif (figure := _plot(shown)) is not None:
        figure.savefig(stream, format="png", dpi=_PREVIEW_DPI)
    return stream.getvalue()


def _plot(shown: Any) -> Any:
    report = shown.report if isinstance(shown, PlanResult) else shown
    if isinstance(report, PathReport) and report.danger is not None:
        return plot_plan(np.asarray(report.danger.profile), None, title="danger")
    if isinstance(shown, Trajectory):
        return plot_motion(shown, None)
    return plot_check(shown, None) if isinstance(shown, MotionCheck) else None
