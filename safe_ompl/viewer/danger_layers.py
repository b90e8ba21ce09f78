"""The danger field in a view: danger points with their levels, and a slice through the field that can be moved."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.danger.field import DangerField
from safe_ompl.viewer import colours
from safe_ompl.viewer.figures import wxyz

Plane = Literal["level", "facing x", "facing y"]
PLANES: tuple[Plane, ...] = get_args(Plane)

_MOST_POINTS = 4000  # danger points that are shown; of more, evenly chosen ones
_NORMAL = {"level": 2, "facing x": 0, "facing y": 1}
_SLICE = 96  # pixels along the longer side of a slice
_SLICE_OPACITY = 0.55
_BELOW, _ABOVE = 5, 3  # steps below and above the darkest danger point that are told apart


class DangerPoints:
    """The danger points, coloured by their levels w·CDF(p), and the most dangerous one with its level.

    Parameters
    ----------
    view : viser.SceneApi
        Where they are shown.
    name : str
        Name of their node.
    field : DangerField
        Whose points; fixed ones.
    most : float
        The level of the darkest colour.
    """

    def __init__(self, view: Any, name: str, field: DangerField, most: float) -> None:
        assert field.points is not None
        self._field, self._most = field, most
        self._shown = np.unique(
            np.linspace(0, len(field.points) - 1, min(len(field.points), _MOST_POINTS)).astype(int)
        )
        points = np.array(field.points)[self._shown]
        self._cloud = view.add_point_cloud(
            name, points, self._colours(np.zeros(len(points))), point_size=0.014, point_shape="circle"
        )
        self._label = view.add_label(f"{name}/most", "", anchor="bottom-left", font_screen_scale=0.9)

    def pose(self, q: FloatArray) -> None:
        """Show the levels at `q: (n,)`."""
        assert self._field.points is not None
        levels = self._field.field(q, self._field.points)
        if self._field.weights is not None:
            levels = levels * self._field.weights
        most = int(levels.argmax())
        self._cloud.colors = self._colours(levels[self._shown])
        self._label.text = f"danger {levels[most]:.2f}"
        self._label.position = np.array(self._field.points)[most]

    def show(self, visible: bool) -> None:
        """Show or hide them."""
        self._cloud.visible = self._label.visible = visible

    def _colours(self, levels: FloatArray) -> colours.Bytes:
        return colours.of_levels(levels, self._most)


class FieldSlice:
    """A plane through the danger field, coloured by its level.

    Parameters
    ----------
    view : viser.SceneApi
        Where it is shown.
    name : str
        Name of its node.
    field : DangerField
        The field.
    low, high : (3,) array
        Corners of the box that it goes through [m].
    most : float
        The level of the darkest colour.
    """

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
        grid[..., up] = (self._low[up] + (np.arange(rows) + 0.5) / rows * size[1])[
            :, None
        ]  # viser's y: by rows
        levels = self._field.field(q, grid.reshape(-1, 3))
        image = self._painted(levels).reshape(rows, columns, 4)
        if self._image is None:
            self._image = self._add(image, size, across, up)
        else:
            self._image.image = image

    def _painted(self, levels: FloatArray) -> colours.Bytes:
        """Return red, green, blue and opacity (M, 4): steps of colour, so that lines of equal danger are seen.

        A step is a factor √2 of danger: the field falls off like one over the distance.
        """
        steps = np.rint(2.0 * np.log2(np.maximum(levels, 1e-12) / self._most))
        shares = np.clip((steps + _BELOW) / (_BELOW + _ABOVE), 0.0, 1.0)
        opacity = _SLICE_OPACITY * np.clip(2.5 * shares, 0.15, 1.0)
        return np.column_stack([colours.of_levels(shares, 1.0), colours.as_bytes(opacity)])

    def _add(self, image: colours.Bytes, size: FloatArray, across: int, up: int) -> Any:
        place = 0.5 * (self._low + self._high)
        place[_NORMAL[self.plane]] = self.offset
        rotation = np.zeros((3, 3))
        rotation[across, 0] = rotation[up, 1] = 1.0
        rotation[:, 2] = np.cross(rotation[:, 0], rotation[:, 1])
        return self._view.add_image(
            self._name,
            image,
            float(size[0]),
            float(size[1]),
            format="png",
            cast_shadow=False,
            receive_shadow=False,
            wxyz=wxyz(rotation),
            position=place,
        )
