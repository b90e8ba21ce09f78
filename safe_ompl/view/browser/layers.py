"""What is drawn over robot and scene: danger points, a slice of the field, clearance lines, a board of speeds."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, SafeOmplError
from safe_ompl.danger import DangerField
from safe_ompl.io import TimedMotion
from safe_ompl.view.content import Nearest, NearestPoints
from safe_ompl.view.plots.paths import AXES, SIZE, plot_speeds
from safe_ompl.view.style import Bytes, as_bytes, level_colours, rgb

Plane = Literal["level", "facing x", "facing y"]
PLANES: tuple[Plane, ...] = get_args(Plane)

_MOST_POINTS = 4000  # danger points that are shown; of more, evenly chosen ones
_NORMAL = {"level": 2, "facing x": 0, "facing y": 1}
_SLICE = 96  # pixels along the longer side of a slice
_SLICE_OPACITY = 0.55
_BELOW, _ABOVE = 5, 3  # steps below and above the darkest danger point that are told apart


class DangerPoints:
    """The danger points, coloured by their levels w·CDF(p) up to `most`, and the most dangerous one with its level."""

    def __init__(self, view: Any, name: str, field: DangerField, most: float) -> None:
        assert field.points is not None
        self._field, self._most = field, most
        self._shown = np.unique(
            np.linspace(0, len(field.points) - 1, min(len(field.points), _MOST_POINTS)).astype(int)
        )
        points = np.array(field.points)[self._shown]
        colours = level_colours(np.zeros(len(points)), most)
        self._cloud = view.add_point_cloud(name, points, colours, point_size=0.014, point_shape="circle")
        self._label = view.add_label(f"{name}/most", "", anchor="bottom-left", font_screen_scale=0.9)

    def pose(self, q: FloatArray) -> None:
        """Show the levels at `q: (n,)`."""
        assert self._field.points is not None
        levels = self._field.field(q, self._field.points)
        if self._field.weights is not None:
            levels = levels * self._field.weights
        most = int(levels.argmax())
        self._cloud.colors = level_colours(levels[self._shown], self._most)
        self._label.text = f"danger {levels[most]:.2f}"
        self._label.position = np.array(self._field.points)[most]

    def show(self, visible: bool) -> None:
        """Show or hide them."""
        self._cloud.visible = self._label.visible = visible


class FieldSlice:
    """A plane through the danger field in a box (corners (3,) [m]), coloured by its levels up to `most`."""

    def __init__(
        self, view: Any, name: str, field: DangerField, low: FloatArray, high: FloatArray, most: float
    ) -> None:
        self._view, self._name, self._field = view, name, field
        self._low, self._high, self._most = low, high, most
        self._image: Any = None
        self._visible = True
        self.plane: Plane = "level"
        self.offset = float(0.5 * (low[2] + high[2]))

    def range(self) -> tuple[float, float]:
        """Return between which offsets [m] the plane can move."""
        axis = _NORMAL[self.plane]
        return float(self._low[axis]), float(self._high[axis])

    def move(self, plane: Plane, offset: float) -> None:
        """Choose the plane, and where it is along its normal [m]; shown by the next `pose`."""
        self.plane, self.offset = plane, offset
        if self._image is not None:
            self._image.remove()
            self._image = None

    def show(self, visible: bool) -> None:
        """Show or hide it."""
        self._visible = visible
        if self._image is not None:
            self._image.visible = visible

    def pose(self, q: FloatArray) -> None:
        """Show the field of the robot at `q: (n,)`."""
        if not self._visible:
            return
        across, up = (axis for axis in range(3) if axis != _NORMAL[self.plane])
        size = (self._high - self._low)[[across, up]]
        columns, rows = np.maximum(2, np.rint(_SLICE * size / size.max())).astype(int)
        grid = np.empty((rows, columns, 3))
        grid[..., _NORMAL[self.plane]] = self.offset
        grid[..., across] = self._low[across] + (np.arange(columns) + 0.5) / columns * size[0]
        # viser's y: by rows
        grid[..., up] = (self._low[up] + (np.arange(rows) + 0.5) / rows * size[1])[:, None]
        levels = self._field.field(q, grid.reshape(-1, 3))
        image = self._painted(levels).reshape(rows, columns, 4)
        if self._image is None:
            self._image = self._add(image, size, across, up)
        else:
            self._image.image = image

    def _painted(self, levels: FloatArray) -> Bytes:
        """Return RGBA (M, 4) in steps of a factor √2 of danger, so that lines of equal danger are seen."""
        steps = np.rint(2.0 * np.log2(np.maximum(levels, 1e-12) / self._most))
        shares = np.clip((steps + _BELOW) / (_BELOW + _ABOVE), 0.0, 1.0)
        opacity = _SLICE_OPACITY * np.clip(2.5 * shares, 0.15, 1.0)
        return np.column_stack([level_colours(shares, 1.0), as_bytes(opacity)])

    def _add(self, image: Bytes, size: FloatArray, across: int, up: int) -> Any:
        place = 0.5 * (self._low + self._high)
        place[_NORMAL[self.plane]] = self.offset
        rotation = np.zeros((3, 3))
        rotation[across, 0] = rotation[up, 1] = 1.0
        rotation[:, 2] = np.cross(rotation[:, 0], rotation[:, 1])
        return _add_image(self._view, self._name, image, size, rotation, place)


def _add_image(
    view: Any, name: str, image: Bytes, size: FloatArray, rotation: FloatArray, place: FloatArray
) -> Any:
    """Add a picture of a size (2,) [m]: right, down its rows and away are the columns of the rotation (3, 3)."""
    width, height = size.tolist()
    look = {"format": "png", "cast_shadow": False, "receive_shadow": False}
    return view.add_image(name, image, width, height, **look, wxyz=wxyz(rotation), position=place)


def wxyz(rotation: FloatArray) -> FloatArray:
    """Return the quaternion (w, x, y, z) of a rotation matrix (3, 3)."""
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return np.array([w, x, y, z])


_PEOPLE, _THINGS = (0.80, 0.10, 0.12), (0.10, 0.35, 0.75)


class ClearanceLines:
    """Segments from the robot to the nearest person, or what else is dangerous, and to the nearest thing."""

    def __init__(self, view: Any, name: str, nearest: Sequence[Nearest]) -> None:
        self._nearest = nearest
        self._visible = True
        nothing = np.zeros((1, 2, 3))
        self._lines = [
            view.add_line_segments(f"{name}/{k}", nothing, rgb(colour), thickness=0.01)
            for k, colour in enumerate((_PEOPLE, _THINGS)[: len(nearest)])
        ]
        self._labels = [
            view.add_label(f"{name}/{k}/length", "", anchor="center-left", font_screen_scale=0.8)
            for k in range(len(nearest))
        ]

    def show(self, visible: bool) -> None:
        """Show or hide them."""
        self._visible = visible
        for node in (*self._lines, *self._labels):
            node.visible = visible

    def found(self, q: FloatArray) -> list[NearestPoints]:
        """Return the nearest points at `q: (n,)`, of people and of things, where there are any."""
        return [found for found in (nearest.at(q) for nearest in self._nearest) if found is not None]

    def pose(self, q: FloatArray) -> None:
        """Show where the robot is nearest at `q: (n,)`."""
        if not self._visible:
            return
        for nearest, line, label in zip(self._nearest, self._lines, self._labels, strict=True):
            found = nearest.at(q)
            line.visible = label.visible = found is not None
            if found is not None:
                line.points = np.array([[found.on_robot, found.on_obstacle]], dtype=np.float32)
                label.text = f"{1e3 * found.distance:.0f} mm to {found.obstacle}"
                label.position = 0.5 * (found.on_robot + found.on_obstacle)


BOARD_SHAPE = SIZE[1] / SIZE[0]
"""Height over width."""
_DPI = 140
_LINES, _LINE = 2, 0.15  # of words above the board, and how high a line is, in heights of the board
_BEFORE = 0.004  # [m] that the cursor is in front of the board
_CURSOR = (30, 30, 30)

_log = logging.getLogger(__name__)


class SpeedBoard:
    """The speed of a motion against time, as a picture in the scene, `width` [m] wide, that faces a direction.

    Without Matplotlib there is only the line that says the speed, and no title.
    """

    def __init__(
        self, view: Any, name: str, motion: TimedMotion, centre: FloatArray, width: float, facing: FloatArray
    ) -> None:
        self._motion = motion
        normal = facing / np.linalg.norm(facing)
        up = np.array([0.0, 0.0, 1.0])
        self._right, self._up = np.cross(up, normal), up
        self._size = np.array([width, width * BOARD_SHAPE])
        self._corner = centre - 0.5 * (self._size[0] * self._right + self._size[1] * up) + _BEFORE * normal
        image = _picture(motion)
        self.has_title = image is not None
        if image is not None:
            turn = np.column_stack([self._right, -up, -normal])  # viser's y goes down the rows
            _add_image(view, name, image, self._size, turn, centre)
        cursor = np.zeros((1, 2, 3))
        self.cursor = view.add_line_segments(f"{name}_cursor", cursor, _CURSOR, thickness=0.006 * width)
        self.labels = [
            view.add_label(f"{name}_told_{k}", "", anchor="bottom-center", font_screen_scale=0.9)
            for k in range(_LINES)
        ]
        self.at(0.0)

    def at(self, time: float) -> None:
        """Show how fast it is at a time [s]."""
        left, bottom, width, height = AXES
        share = left + width * min(time / self._motion.duration, 1.0)
        ends = np.array([self._place(share, bottom), self._place(share, bottom + height)])
        self.cursor.points = ends[None].astype(np.float32)
        lines = self._motion.remark(time).split("; ", _LINES - 1)
        for k, label in enumerate(self.labels):
            label.text = lines[k] if k < len(lines) else ""
            label.visible = k < len(lines)
            label.position = self._place(0.5, 1.04 + _LINE * (len(lines) - 1 - k))

    def _place(self, across: float, above: float) -> FloatArray:
        right, up = across * self._size[0] * self._right, above * self._size[1] * self._up
        return np.asarray(self._corner + right + up)


def _picture(motion: TimedMotion) -> Any:
    try:
        known = motion.times, motion.speeds, motion.bounds, motion.binding
        figure = plot_speeds(*known, None, title=motion.name, dpi=_DPI)
    except SafeOmplError as missing:
        _log.warning("no board with the speed: %s", missing)
        return None
    return np.asarray(figure.canvas.buffer_rgba())[..., :3]
