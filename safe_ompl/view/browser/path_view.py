"""One path in a view: robot, scene and all that is drawn over them, in a place of its own."""

from __future__ import annotations

from typing import Any

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.io import ACCELERATION, TimedMotion
from safe_ompl.robot import Robot
from safe_ompl.view.annotations import Nearest, Proof
from safe_ompl.view.browser.figures import MoverFigures, RobotFigure, RobotModel, add_scenery
from safe_ompl.view.browser.layers import ClearanceLines, DangerPoints, FieldSlice, SpeedBoard
from safe_ompl.view.content import ViewerContent
from safe_ompl.view.pictures.scene import DrawnScene
from safe_ompl.view.style import NEUTRAL, START_COLOUR, Colour, as_bytes, cap_colours, gap_colours, mixed, rgb

SAMPLES = 121
_EVENLY = np.linspace(0.0, 1.0, SAMPLES)
_GOAL_OPACITY, _START_OPACITY = 0.22, 0.16
_TINT = 0.62  # share of the planner's colour in its robot
_AROUND = 0.15  # [m] that a slice reaches beyond the robot's motion and the danger points


class PathView:
    """A path, or a standing robot, with its scene.

    Parameters
    ----------
    view : viser.SceneApi
        Where it is shown.
    number : int
        Which path_view it is.
    content : ViewerContent
        What is shown.
    name : str
        Name of the path; empty where there is none.
    model : RobotModel
        Surfaces of the robot.
    colour : Colour, optional
        Of robot and trace.

    Attributes
    ----------
    name : str
    motion : TimedMotion or None
        The path in time.
    board : SpeedBoard or None
    movers : MoverFigures or None
        People and things that move.
    root, scenery : viser handles
        The place of the path_view, and its scene.
    samples : ndarray, shape (SAMPLES, n)
        The path at equal steps of its length.
    points : DangerPoints or None
    slice : FieldSlice or None
    lines : ClearanceLines
    label : viser handle or None
        The name of the path, where no board says it.
    proof : viser handle or None
    """

    def __init__(
        self,
        view: Any,
        number: int,
        content: ViewerContent,
        name: str,
        model: RobotModel,
        colour: Colour | None,
    ) -> None:
        self.name, self._view, self._content = name, view, content
        self.node = f"/booth_{number}"
        self.samples = content.along(name, _EVENLY)
        self.motion = content.motions.get(name)
        self.board: SpeedBoard | None = None
        movers = content.movers
        self.movers = (
            None if movers is None else MoverFigures(view, f"{self.node}/movers", movers, content.scene)
        )
        self.root = view.add_frame(self.node, show_axes=False)
        self.scenery = add_scenery(view, f"{self.node}/scene", content.still)
        paint = NEUTRAL if colour is None else mixed(NEUTRAL, colour, _TINT)
        self._robot = RobotFigure(view, f"{self.node}/robot", model, paint)
        self.ghosts = [] if colour is None else self._ghosts(model, colour)
        self._add_danger()
        people = [obstacle for obstacle in content.scene if obstacle.weight > 0]
        things = [obstacle for obstacle in content.scene if obstacle.weight == 0]
        nearest = [Nearest(content.robot, group) for group in (people, things)]
        self.lines = ClearanceLines(view, f"{self.node}/clearance", nearest)
        tips = np.asarray(content.robot.keypoints_batch(self.samples)[:, -1])
        self.label: Any = None
        if colour is not None:
            if self.motion is None:
                add_trace(view, f"{self.node}/trace", tips, colour)
            else:
                add_timed_trace(view, f"{self.node}/trace", self.motion)
            self.label = view.add_label(
                f"{self.node}/name", name, position=self._above(), anchor="bottom-center"
            )
        self.proof = None
        if content.proof is not None:
            dense = content.along(name, np.linspace(0.0, 1.0, 10 * SAMPLES))
            self.proof = add_proof(view, f"{self.node}/proof", content.robot, dense, content.proof)

    def at(self, share: float) -> FloatArray:
        """Return the configuration (n,) at a fraction of the path's length."""
        return np.asarray(self._content.along(self.name, np.array([share]))[0])

    def pose(self, q: FloatArray) -> None:
        """Show the robot at `q: (n,)`, and what depends on it."""
        self._robot.pose(q)
        self.lines.pose(q)
        for layer in (self.points, self.slice):
            if layer is not None:
                layer.pose(q)

    def at_time(self, time: float) -> None:
        """Show what belongs to a time [s] of a motion: how fast the robot is, and where people and things are."""
        if self.board is not None:
            self.board.at(time)
        if self.movers is not None:
            self.movers.at(time)

    def describe(self, q: FloatArray, share: float | None) -> str:
        """Return what there is to say of `q: (n,)` in words, as Markdown."""
        lines = [f"**{self.name or self._content.robot.name}**"]
        field = self._content.danger_field
        if field is not None:
            lines.append(f"danger {field.value(q):.3f}")
        lines += [
            f"{1e3 * found.distance:.0f} mm: {found.link} – {found.obstacle}" for found in self.lines.found(q)
        ]
        if self.motion is not None and share is not None:
            lines.append(self.motion.remark(share * self._content.playing_time))
        if self._content.proof is not None and share is not None:
            lines.append(f"proven: {self._content.proof.at(share)}")
        return "  \n".join(lines)

    def add_board(self, centre: FloatArray, width: float, facing: FloatArray) -> None:
        """Add a board with the speed against time, if the motion has times, see `SpeedBoard`."""
        if self.motion is not None:
            self.board = SpeedBoard(self._view, f"{self.node}/speed", self.motion, centre, width, facing)
            if self.label is not None and self.board.has_title:
                self.label.remove()  # the board says it
                self.label = None

    def add_floor(self, drawn: DrawnScene) -> None:
        """Add the floor of a drawn, and a pedestal where the robot would hang in the air."""
        for thing in drawn.pedestal:
            surface = thing.surface
            self._view.add_mesh_simple(
                f"{self.node}/scene/pedestal", surface.vertices, surface.faces, color=rgb(thing.colour)
            )
        height, size = drawn.floor, drawn.size
        width = 3.0 * size
        self._view.add_grid(
            f"{self.node}/scene/floor",
            width,
            width,
            position=(0.0, 0.0, height - 0.002),
            cell_color=(225, 227, 230),
            section_color=(205, 208, 212),
            cell_size=0.1,
            section_size=0.5,
            fade_distance=4.0 * size,
            fade_from="origin",
            shadow_opacity=0.25,
            plane_color=(250, 250, 250),
            plane_opacity=1.0,
        )

    def _ghosts(self, model: RobotModel, colour: Colour) -> list[RobotFigure]:
        start = RobotFigure(self._view, f"{self.node}/start", model, START_COLOUR, _START_OPACITY)
        goal = RobotFigure(self._view, f"{self.node}/goal", model, colour, _GOAL_OPACITY)
        start.pose(self.samples[0])
        goal.pose(self.samples[-1])
        return [start, goal]

    def _add_danger(self) -> None:
        field = self._content.danger_field
        self.points: DangerPoints | None = None
        self.slice: FieldSlice | None = None
        if field is None or field.points is None:
            return
        most = max(float(field.values(self._content.along(name, _EVENLY)).max()) for name in self._names())
        self.points = DangerPoints(self._view, f"{self.node}/danger", field, most)
        keypoints = self._content.robot.keypoints_batch(self.samples).reshape(-1, 3)
        around = np.vstack([keypoints, field.points])
        low, high = around.min(axis=0) - _AROUND, around.max(axis=0) + _AROUND
        self.slice = FieldSlice(self._view, f"{self.node}/field", field, low, high, most)
        self.slice.show(False)

    def _names(self) -> list[str]:
        return list(self._content.paths) or [""]

    def _above(self) -> FloatArray:
        points = self._content.robot.keypoints_batch(self.samples).reshape(-1, 3)
        middle: FloatArray = 0.5 * (points.min(axis=0) + points.max(axis=0))
        middle[2] = points[:, 2].max() + 0.25
        return middle


def add_trace(view: Any, name: str, points: FloatArray, colour: Colour) -> Any:
    """Add a line through `points: (P, 3)` [m]."""
    segments = np.stack([points[:-1], points[1:]], axis=1)
    return view.add_line_segments(name, segments, rgb(colour), thickness=0.008)


def add_timed_trace(view: Any, name: str, motion: TimedMotion) -> Any:
    """Add the way of the tip, each piece in the colour of what bounds the speed there."""
    points = np.asarray(motion.robot.keypoints_batch(motion.configurations)[:, -1])
    paints = cap_colours([*motion.bounds, *filter(None, motion.binding)])
    paint = as_bytes(np.array([paints[bound or ACCELERATION] for bound in motion.binding[:-1]]))
    segments = np.stack([points[:-1], points[1:]], axis=1)
    return view.add_line_segments(name, segments, np.repeat(paint[:, None], 2, axis=1), thickness=0.014)


def add_proof(view: Any, name: str, robot: Robot, samples: FloatArray, proof: Proof) -> Any:
    """Add the way of the tip, in stripes of the proof's intervals: the warmer, the nearer two bodies come.

    Parameters
    ----------
    samples : (S, n) array
        The path at equal steps of its length.
    """
    points = np.asarray(robot.keypoints_batch(samples)[:, -1])
    middles = (np.arange(len(samples) - 1) + 0.5) / max(1, len(samples) - 1)
    numbers = np.clip(np.searchsorted(proof.stops, middles, side="right") - 1, 0, len(proof.intervals) - 1)
    gaps = np.array([interval.distance for interval in proof.intervals])[numbers]
    paint = gap_colours(gaps)
    paint = np.where((numbers % 2 == 0)[:, None], paint, (0.72 * paint).astype(np.uint8))
    segments = np.stack([points[:-1], points[1:]], axis=1)
    return view.add_line_segments(name, segments, np.repeat(paint[:, None], 2, axis=1), thickness=0.02)
