"""A view of an exhibit in the browser: one booth for each planner, a play bar, sliders, and what is drawn over it."""

from __future__ import annotations

import webbrowser
from contextlib import redirect_stdout
from importlib import import_module
from io import StringIO
from time import sleep
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import SafeOmplError
from safe_ompl.pictures.render.stage import Stage
from safe_ompl.pictures.render.viewpoint import best_view
from safe_ompl.pictures.style import planner_styles
from safe_ompl.viewer.booth import Booth
from safe_ompl.viewer.controls import Controls
from safe_ompl.viewer.exhibit import Exhibit
from safe_ompl.viewer.figures import RobotModel
from safe_ompl.viewer.speed_board import BOARD_SHAPE

PORT = 8080
_SIZE = (1200, 800)  # [px] of the window that cameras are chosen for
_APART = 1.15  # widths of a booth from one to the next
_BOARD = 1.25  # sizes of the robot's motion; width of a board
_FIELD_OF_VIEW = 0.6  # [rad]
_BACKGROUND = 245


class View:
    """A view of an exhibit, served to browsers on this machine.

    Parameters
    ----------
    exhibit : Exhibit
        What is shown.
    port : int
        Port of the server; the next free one if it is taken.
    side_by_side : bool
        Whether several paths stand beside each other; else all in one place.

    Attributes
    ----------
    server : viser.ViserServer
        The server; its `scene` may be added to.
    booths : list of Booth
        One for each path.
    share : float
        Where on the paths the robots are, as a fraction of their length.

    Raises
    ------
    SafeOmplError
        If viser is not installed.
    """

    def __init__(self, exhibit: Exhibit, *, port: int = PORT, side_by_side: bool = True) -> None:
        self.exhibit = exhibit
        with redirect_stdout(StringIO()):  # viser prints a banner
            self.server = _viser().ViserServer(
                host="127.0.0.1", port=port, label=exhibit.title, verbose=False
            )
        self.server.scene.set_up_direction("+z")
        self.server.scene.set_background_image(np.full((2, 2, 3), _BACKGROUND, dtype=np.uint8))
        model = RobotModel(exhibit.robot)
        styles = planner_styles(exhibit.paths)
        names = list(exhibit.paths) or [""]
        self.booths = [
            Booth(self.server.scene, k, exhibit, name, model, styles[name].colour if name else None)
            for k, name in enumerate(names)
        ]
        self._set_camera()
        self.set_side_by_side(side_by_side)
        self.share = 0.0
        self.go_to(0.0)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://127.0.0.1:{self.server.get_port()}"

    def go_to(self, share: float) -> None:
        """Bring all robots to a fraction of the length of their paths."""
        self.share = float(np.clip(share, 0.0, 1.0))
        self._postures = [booth.at(self.share) for booth in self.booths]
        self._on_path = True
        self.refresh()

    def pose(self, q: FloatArray) -> None:
        """Bring all robots to the configuration `q: (n,)`."""
        self._postures = [q] * len(self.booths)
        self._on_path = False
        self.refresh()

    @property
    def q(self) -> FloatArray:
        """The configuration (n,) of the first robot."""
        return self._postures[0]

    def refresh(self) -> None:
        """Draw all robots, and what is drawn over them, once more."""
        with self.server.atomic():
            for booth, q in zip(self.booths, self._postures, strict=True):
                booth.pose(q)
                if self._on_path:
                    booth.at_time(self.share * self.exhibit.playing_time)

    def facts(self) -> list[str]:
        """Return for each booth what there is to say of its robot, as Markdown."""
        share = self.share if self._on_path else None
        return [booth.facts(q, share) for booth, q in zip(self.booths, self._postures, strict=True)]

    def set_side_by_side(self, apart: bool) -> None:
        """Set the booths beside each other, or all into one place, where only the first scene is shown."""
        middle = 0.5 * (len(self.booths) - 1)
        for k, booth in enumerate(self.booths):
            booth.root.position = self._step * (k - middle) if apart else np.zeros(3)
            booth.scenery.visible = apart or k == 0
        camera = self._camera_of(len(self.booths) if apart else 1)
        initial = self.server.initial_camera
        initial.position, initial.look_at, initial.fov = camera.eye, camera.target, camera.field_of_view

    def run(self, *, browser: bool = True) -> None:
        """Serve the view until Ctrl-C.

        Parameters
        ----------
        browser : bool
            Whether to open it in the browser.
        """
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
        paths = [booth.samples for booth in self.booths]
        stage = Stage(self.exhibit.robot, self.exhibit.staged, paths)
        self._landmarks = stage.landmarks()
        self._view = best_view(stage, (_SIZE[0] // len(paths), _SIZE[1]))
        right = self._view.axes()[1]
        across = self._landmarks @ right
        self._step = _APART * float(np.ptp(across)) * right
        for booth in self.booths:
            booth.add_floor(stage)
        if self.exhibit.motions:
            self._add_boards(_BOARD * stage.size, right)

    def _add_boards(self, width: float, right: FloatArray) -> None:
        """Hang a board over each booth, seen from the front by the camera."""
        back, _ = self._view.axes()
        facing = np.array([back[0], back[1], 0.0])
        height = width * BOARD_SHAPE
        centre = 0.5 * (self._landmarks.min(axis=0) + self._landmarks.max(axis=0))
        centre[2] = self._landmarks[:, 2].max() + 0.65 * height
        for booth in self.booths:
            booth.add_board(centre, width, facing)
        corners = [
            centre + 0.5 * (x * width * right + [0.0, 0.0, z * height]) for x in (-1, 1) for z in (-1, 1)
        ]
        self._landmarks = np.vstack([self._landmarks, *corners])
        self._step = _APART * max(float(np.ptp(self._landmarks @ right)), width) * right

    def _camera_of(self, booths: int) -> Any:
        """Return the camera that sees so many booths beside each other."""
        middle = 0.5 * (booths - 1)
        points = np.vstack([self._landmarks + self._step * (k - middle) for k in range(booths)])
        back, _ = self._view.axes()
        azimuth, elevation = float(np.arctan2(back[1], back[0])), float(np.arcsin(back[2]))
        return self._view.framing(points, azimuth, elevation, _SIZE, _FIELD_OF_VIEW)


def _viser() -> Any:
    try:
        return import_module("viser")
    except ImportError as missing:
        raise SafeOmplError("the view needs viser: pip install 'safe-ompl[viewer]'") from missing
