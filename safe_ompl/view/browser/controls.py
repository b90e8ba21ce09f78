"""The panel of a live view: play bar, what is shown, the slice of the danger field, joint sliders."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from safe_ompl.view.browser.layers import PLANES

if TYPE_CHECKING:
    from safe_ompl.view.browser.view import BrowserView

_FRAME, _IDLE = 1 / 30, 0.1  # [s]
_STEP = 1e-3


class Controls:
    """The panel of a live view.

    Parameters
    ----------
    view : BrowserView
        What it controls.
    clock : callable
        Returns the time [s] by which it plays.

    Attributes
    ----------
    bar : viser slider
        The play bar, where there is a path.
    joints : list of viser sliders
        One for each joint.
    """

    def __init__(self, view: BrowserView, clock: Callable[[], float] = perf_counter) -> None:
        self._view, self._clock = view, clock
        self._gui = view.server.gui
        self._text = self._gui.add_markdown("")
        self._last = clock()
        self._playing = False
        self._following = False  # whether sliders follow the robot, and do not lead it
        if view.content.paths:
            self._add_play_bar()
        self._add_layers()
        self._add_joints()
        self._describe()

    def advance(self) -> float:
        """Play on, if it plays; return after how long to come again [s]."""
        if not self._playing:
            return _IDLE
        now = self._clock()
        share = self._view.share + (now - self._last) / self._view.content.playing_time * self._speed.value
        self._last = now
        self.go_to(share % 1.0)
        return _FRAME

    def _add_play_bar(self) -> None:
        self.bar = self._gui.add_slider("path", 0.0, 1.0, _STEP, 0.0)
        self._button = self._gui.add_button("Play")
        self._speed = self._gui.add_slider("speed", 0.1, 3.0, 0.1, 1.0)
        self.bar.on_update(lambda _: self._seek())
        self._button.on_click(lambda _: self.play(not self._playing))

    def play(self, on: bool) -> None:
        """Start or stop playing."""
        self._playing = on
        self._button.label = "Pause" if on else "Play"
        self._last = self._clock()

    def _seek(self) -> None:
        if not self._following:
            self.go_to(self.bar.value)

    def go_to(self, share: float) -> None:
        """Bring the robots to a fraction of their paths, and all sliders with them."""
        self._view.go_to(share)
        self._following = True
        self.bar.value = round(share / _STEP) * _STEP
        self._update_sliders()
        self._following = False
        self._describe()

    def _add_layers(self) -> None:
        path_views = self._view.path_views
        with self._gui.add_folder("Show"):
            if len(path_views) > 1:
                self._checkbox("side by side", True, self._view.set_side_by_side)
            if path_views[0].ghosts:
                self._checkbox("start and goal", True, self._show_ghosts)
            self._checkbox("clearance", True, lambda on: self._show("lines", on))
            if path_views[0].points is not None:
                self._checkbox("danger points", True, lambda on: self._show("points", on))
            if path_views[0].proof is not None:
                self._checkbox("proof", True, self._show_proof)
        if path_views[0].slice is not None:
            self._add_slice()

    def _checkbox(self, label: str, value: bool, changed: Any) -> None:
        box = self._gui.add_checkbox(label, value)
        box.on_update(lambda _: changed(box.value))

    def _show(self, layer: str, on: bool) -> None:
        for path_view in self._view.path_views:
            getattr(path_view, layer).show(on)
        self._view.refresh()

    def _show_ghosts(self, on: bool) -> None:
        for path_view in self._view.path_views:
            for ghost in path_view.ghosts:
                ghost.show(on)

    def _show_proof(self, on: bool) -> None:
        for path_view in self._view.path_views:
            assert path_view.proof is not None
            path_view.proof.visible = on

    def _add_slice(self) -> None:
        slices = [path_view.slice for path_view in self._view.path_views if path_view.slice is not None]
        with self._gui.add_folder("Danger field"):
            self._checkbox("slice", False, lambda on: self._show("slice", on))
            plane = self._gui.add_dropdown("plane", PLANES, initial_value=PLANES[0])
            low, high = slices[0].range()
            offset = self._gui.add_slider(
                "at [m]", round(low, 2), round(high, 2), 0.01, round(slices[0].offset, 2)
            )

        def turn(_: Any) -> None:
            for part in slices:
                part.move(plane.value, part.offset)
            low, high = slices[0].range()
            offset.min, offset.max = round(low, 2), round(high, 2)
            offset.value = round(0.5 * (low + high), 2)

        def shift(_: Any) -> None:
            for part in slices:
                part.move(plane.value, offset.value)
            self._view.refresh()

        plane.on_update(turn)
        offset.on_update(shift)

    def _add_joints(self) -> None:
        robot, q = self._view.content.robot, self._view.q
        with self._gui.add_folder("Joints", expand_by_default=not self._view.content.paths):
            self.joints = [
                self._gui.add_slider(
                    name,
                    float(low),
                    float(high),
                    float(high - low) / 1000,
                    float(np.clip(value, low, high)),
                )
                for name, low, high, value in zip(robot.joint_names, robot.lower, robot.upper, q, strict=True)
            ]
        for slider in self.joints:
            slider.on_update(lambda _: self._pose_by_sliders())

    def _pose_by_sliders(self) -> None:
        if not self._following:
            if self._playing:
                self.play(False)
            self._view.pose(np.array([slider.value for slider in self.joints]))
            self._describe()

    def _update_sliders(self) -> None:
        robot = self._view.content.robot
        for slider, value in zip(self.joints, np.clip(self._view.q, robot.lower, robot.upper), strict=True):
            slider.value = float(value)

    def _describe(self) -> None:
        self._text.content = "\n\n".join(self._view.describe())
