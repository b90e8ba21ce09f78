"""Show robots and paths in the browser, live with control panels or as one HTML file that opens offline."""

from __future__ import annotations

import webbrowser
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from html import escape
from importlib import import_module
from io import StringIO
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, InputError, SafeOmplError, files
from safe_ompl.drawing.content import ViewerContent
from safe_ompl.drawing.drawn_scene import DrawnScene, best_view
from safe_ompl.drawing.path_view import BOARD_SHAPE, PathView
from safe_ompl.drawing.style import planner_styles, rgb
from safe_ompl.drawing.surfaces import RobotBody
from safe_ompl.io import EmbeddedProblem, MotionRecord
from safe_ompl.motions import Trajectory
from safe_ompl.planning import PlanResult
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene
from safe_ompl.tasks import ProgramResult

PORT = 8080
# The size of the window for which cameras are chosen.
_SIZE = (1200, 800)  # [px]
# The distance between two paths, in widths of a path.
_PATH_DISTANCE = 1.15
# The width of a speed board, as a multiple of the size of the robot's motion.
_BOARD = 1.25
# Words reach up to this many half heights of a board above its middle.
_WORDS_TOP = 1.7
_FIELD_OF_VIEW = 0.6  # [rad]
# The tangents of half the vertical and half the horizontal field of view in a window of this size.
_UPWARDS = np.tan(0.5 * _FIELD_OF_VIEW)
_SIDEWAYS = _UPWARDS * _SIZE[0] / _SIZE[1]
_BACKGROUND = 245


def view(
    shown: ViewerContent | PlanResult | ProgramResult | MotionRecord | Trajectory | Sequence[PlanResult],
    *,
    robot: Robot | None = None,
    scene: Scene | None = None,
    port: int = PORT,
    browser: bool = True,
) -> None:
    """Show paths in the browser until Ctrl-C. This needs the extra `safe-ompl[viewer]`.

    Parameters
    ----------
    shown : PlanResult, sequence of PlanResult, ProgramResult, Trajectory, MotionRecord or ViewerContent
        The content to show. Several results are shown side by side.
    robot, scene : Robot and Scene
        Robot and scene of a `Trajectory`, which does not contain them. The scene is optional.
    port : int
        Port of the server. If the port is taken, the next free port is used.
    browser : bool
        Whether to open the page in the browser.

    Raises
    ------
    InputError
        If a result lacks its robot or scene, if robots or scenes of the results differ, or if the robot of a trajectory
        is missing.
    SafeOmplError
        If viser is not installed.
    """
    if isinstance(shown, Trajectory):
        if robot is None:
            raise InputError("a Trajectory does not contain its robot: give robot= and scene=", "view")
        shown = MotionRecord.of(shown, EmbeddedProblem(robot, Scene() if scene is None else scene, None))
    if isinstance(shown, MotionRecord):
        shown = ViewerContent.of_motions([shown])
    elif isinstance(shown, ProgramResult):
        shown = ViewerContent.of_program(shown)
    elif not isinstance(shown, ViewerContent):
        shown = ViewerContent.of_results([shown] if isinstance(shown, PlanResult) else shown)
    BrowserView(shown, port=port).run(browser=browser)


class BrowserView:
    """A server that shows a view in browsers on this machine.

    If the port is taken, the next free port is used. Callers may add objects to the `scene` of viser's `server`.
    `share` is the position of the robots along their paths, as a fraction of the length.
    """

    def __init__(self, content: ViewerContent, *, port: int = PORT) -> None:
        self.content = content
        try:
            viser = import_module("viser")
        except ImportError as missing:
            raise SafeOmplError("the view needs viser: pip install 'safe-ompl[viewer]'") from missing
        with redirect_stdout(StringIO()):  # viser prints a banner
            self.server = viser.ViserServer(host="127.0.0.1", port=port, label=content.title, verbose=False)
        self.server.scene.set_up_direction("+z")
        self.server.scene.set_background_image(np.full((2, 2, 3), _BACKGROUND, dtype=np.uint8))
        body = RobotBody(content.robot)
        styles = planner_styles(content.paths)
        names = list(content.paths) or [""]
        self.path_views = [
            PathView(self.server.scene, k, content, name, body, styles[name].colour if name else None)
            for k, name in enumerate(names)
        ]
        self._set_camera()
        self.go_to(0.0)

    @property
    def url(self) -> str:
        """The address of the page."""
        return f"http://127.0.0.1:{self.server.get_port()}"

    def go_to(self, share: float) -> None:
        """Move all robots to a fraction of the length of their paths."""
        self.share = float(np.clip(share, 0.0, 1.0))
        self._postures = [path_view.at(self.share) for path_view in self.path_views]
        self._on_path = True
        self.refresh()

    def pose(self, q: FloatArray) -> None:
        """Move all robots to the configuration `q: (n,)`."""
        self._postures = [q] * len(self.path_views)
        self._on_path = False
        self.refresh()

    @property
    def q(self) -> FloatArray:
        """The configuration (n,) of the first robot."""
        return self._postures[0]

    def refresh(self) -> None:
        """Update all robots and their overlays."""
        with self.server.atomic():
            for path_view, q in zip(self.path_views, self._postures, strict=True):
                path_view.pose(q)
                if self._on_path:
                    path_view.at_time(self.share * self.content.playing_time)

    def describe(self) -> list[str]:
        """Return a description of the robot's state for each path view, as Markdown."""
        share = self.share if self._on_path else None
        both = zip(self.path_views, self._postures, strict=True)
        return [path_view.describe(q, share) for path_view, q in both]

    def run(self, *, browser: bool = True) -> None:
        """Serve the view until Ctrl-C. With `browser`, open the page."""
        controls = Controls(self)
        if browser:
            webbrowser.open(self.url)
        while True:
            sleep(controls.advance())

    def stop(self) -> None:
        """Stop serving."""
        with redirect_stdout(StringIO()):
            self.server.stop()

    def _set_camera(self) -> None:
        """Arrange the paths side by side, and set the camera so that all paths are in view."""
        paths = [path_view.samples for path_view in self.path_views]
        drawn = DrawnScene(self.content.robot, self.content.scene_at_start, paths)
        best = best_view(drawn, (_SIZE[0] // len(paths), _SIZE[1]))
        (back, right), landmarks = best.axes(), drawn.landmarks()
        for path_view in self.path_views:
            path_view.add_floor(drawn)
        # Each path gets a speed board above it, which faces the camera.
        if self.content.motions:
            width = _BOARD * drawn.size
            centre, up = 0.5 * (landmarks.min(axis=0) + landmarks.max(axis=0)), np.array([0.0, 0.0, 1.0])
            centre[2] = landmarks[:, 2].max() + 0.65 * width * BOARD_SHAPE
            for path_view in self.path_views:
                path_view.add_board(centre, width, np.array([back[0], back[1], 0.0]))
            ends = (-1, _WORDS_TOP)
            corners = [centre + 0.5 * width * (x * right + z * BOARD_SHAPE * up) for x in (-1, 1) for z in ends]
            landmarks = np.vstack([landmarks, *corners])
        step = _PATH_DISTANCE * float(np.ptp(landmarks @ right)) * right
        places = [step * (k - 0.5 * (len(paths) - 1)) for k in range(len(paths))]
        for path_view, place in zip(self.path_views, places, strict=True):
            path_view.root.position = place
        azimuth, elevation = float(np.arctan2(back[1], back[0])), float(np.arcsin(back[2]))
        points = np.vstack([landmarks + place for place in places])
        camera = best.framing(points, azimuth, elevation, _SIZE, _FIELD_OF_VIEW)
        initial = self.server.initial_camera
        initial.position, initial.look_at, initial.fov = camera.eye, camera.target, camera.field_of_view
        self.server.on_client_connect(_see_all)


def _see_all(client: Any) -> None:
    """Widen the field of view in a narrow window, such as a phone's, so that the whole width stays visible."""
    client.camera.fov = max(_FIELD_OF_VIEW, 2.0 * float(np.arctan(_SIDEWAYS / client.camera.aspect)))


# The motion rests at the goal for this time before it begins again.
_REST = 0.8  # [s]
# The rate of frames of a motion with times.
_RATE = 25.0  # [Hz]
_FEWEST_FRAMES, _MOST_FRAMES = 97, 1501


def save_page(content: ViewerContent, file: str | Path) -> None:
    """Write a view as one HTML file that needs no server and no network.

    The page opens at the start of the motion, which can be played. Raises SafeOmplError if viser is not installed.
    """
    view = BrowserView(content)
    try:
        recording = view.server.get_scene_serializer()
        if content.paths:
            wanted = _RATE * content.playing_time if content.motions else _FEWEST_FRAMES
            frames = int(np.clip(wanted, _FEWEST_FRAMES, _MOST_FRAMES))
            for share in np.linspace(0.0, 1.0, frames)[1:]:
                recording.insert_sleep(content.playing_time / (frames - 1))
                view.go_to(float(share))
            recording.insert_sleep(_REST)
        before, end, after = recording.as_html().rpartition("</body>")
        files.write(file, before + _on_page(content) + end + after)
    finally:
        view.stop()


# The client of viser has no panel and begins to play where a page is opened. Scripts of the page's body run before it.
_PAGE = """
<style>
html > body { display: flex; flex-direction: column; font: 14px/1.45 system-ui, sans-serif; color: #222 }
body > #root { flex: 1; height: auto; min-height: 0 }
#paths { order: -1; max-height: 40vh; overflow: auto; padding: 0.5em 0.9em; border-bottom: 1px solid #e4e6e8 }
#paths summary { cursor: pointer; font-weight: 600 }
#paths p { display: inline-block; vertical-align: top; margin: 0.4em 3em 0.2em 0 }
</style>
%(panel)s
<script>
{
  const panel = document.getElementById("paths"), aspect = innerWidth / innerHeight;
  if (panel && innerWidth < %(small)d) panel.open = false;
  const across = %(across)f;
  try { history.replaceState(null, "", "?initialCameraFov=" + 2 * Math.atan(Math.max(%(tan)f, across / aspect))); }
  catch (error) { console.log("the camera stays as it is", error); }
  const time = () => document.querySelector("input[inputmode=decimal]");
  const loaded = setInterval(() => {
    if (!time()) return;
    clearInterval(loaded);
    setTimeout(() => dispatchEvent(new KeyboardEvent("keydown", { code: "Space" })), 300);
    setTimeout(() => {
      if (!parseFloat(time().value)) return;
      Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(time(), "0");
      time().dispatchEvent(new Event("input", { bubbles: true }));
    }, 600);
  }, 50);
}
</script>
"""
# A window that is narrower than this is treated as a phone's.
_PHONE_WIDTH = 600  # [px]


def _on_page(content: ViewerContent) -> str:
    """Return the HTML of a page besides the scene: a description of the paths above the scene, and a script.

    The script pauses the motion at the start, collapses the description on a small screen, and widens the field of view
    in a narrow window.
    """
    styles, parts = planner_styles(content.paths), []
    for name in content.reports:
        dot = f'<span style="color: rgb{rgb(styles[name].colour)}">●</span>'
        parts.append(f"<p>{'<br>'.join([f'{dot} <b>{escape(name)}</b>', *content.facts(name)])}</p>")
    heading = f"Safest: {escape(content.safest)}" if content.safest else "Path"
    panel = f'<details id="paths" open><summary>{heading}</summary>{"".join(parts)}</details>' if parts else ""
    return _PAGE % {"panel": panel, "small": _PHONE_WIDTH, "tan": _UPWARDS, "across": _SIDEWAYS}


_FRAME, _IDLE = 1 / 30, 0.1  # [s]
_SLIDER_STEP = 1e-3


class Controls:
    """The panels of a live view: play bar, description of the paths, and joint sliders.

    The description has a panel of its own beside the scene. The browser collapses this panel on a small screen.
    """

    def __init__(self, view: BrowserView, clock: Callable[[], float] = perf_counter) -> None:
        self._view, self._clock = view, clock
        self._gui = view.server.gui
        self._last = clock()
        self._playing = False
        # True while the sliders are set from the robot's posture, so that they do not pose the robot.
        self._following = False
        if view.content.safest:
            self._gui.add_markdown(f"**Safest: {view.content.safest}**")
        if view.content.paths:
            self._add_play_bar()
        panel = self._gui.add_panel()
        with panel.add_tab("Paths" if view.content.paths else "Robot"):
            self._text = self._gui.add_markdown("")
        panel.dock_left()
        self._add_joints()
        self._describe()

    def advance(self) -> float:
        """Advance the motion if it is playing. Return the time [s] until the next call."""
        if not self._playing:
            return _IDLE
        now = self._clock()
        share = self._view.share + (now - self._last) / self._view.content.playing_time * self._speed.value
        self._last = now
        self.go_to(share % 1.0)
        return _FRAME

    def _add_play_bar(self) -> None:
        self.bar = self._gui.add_slider("path", 0.0, 1.0, _SLIDER_STEP, 0.0)
        self._button = self._gui.add_button("Play")
        self._speed = self._gui.add_slider("speed", 0.1, 3.0, 0.1, 1.0)
        self.bar.on_update(lambda _: None if self._following else self.go_to(self.bar.value))
        self._button.on_click(lambda _: self.play(not self._playing))

    def play(self, on: bool) -> None:
        """Start or stop playing."""
        self._playing = on
        self._button.label = "Pause" if on else "Play"
        self._last = self._clock()

    def go_to(self, share: float) -> None:
        """Move the robots to a fraction of their paths, and set all sliders accordingly."""
        self._view.go_to(share)
        self._following = True
        self.bar.value = round(share / _SLIDER_STEP) * _SLIDER_STEP
        robot = self._view.content.robot
        for slider, value in zip(self.joints, np.clip(self._view.q, robot.lower, robot.upper), strict=True):
            slider.value = float(value)
        self._following = False
        self._describe()

    def _add_joints(self) -> None:
        robot, q = self._view.content.robot, self._view.q
        with self._gui.add_folder("Joints", expand_by_default=not self._view.content.paths):
            limits = zip(robot.joint_names, robot.lower.tolist(), robot.upper.tolist(), q, strict=True)
            self.joints = [
                self._gui.add_slider(name, low, high, (high - low) / 1000, float(np.clip(value, low, high)))
                for name, low, high, value in limits
            ]
        for slider in self.joints:
            slider.on_update(lambda _: self._pose_by_sliders())

    def _pose_by_sliders(self) -> None:
        if not self._following:
            if self._playing:
                self.play(False)
            self._view.pose(np.array([slider.value for slider in self.joints]))
            self._describe()

    def _describe(self) -> None:
        self._text.content = "\n\n".join(self._view.describe())
