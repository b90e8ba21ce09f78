"""A board beside a robot in motion: its speed against time, what bounds it, and a cursor that follows."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import SafeOmplError
from safe_ompl.exchange.timed_motion import TimedMotion
from safe_ompl.pictures.plots.speeds import AXES, SIZE, plot_speeds
from safe_ompl.viewer.figures import wxyz

BOARD_SHAPE = SIZE[1] / SIZE[0]
"""Height over width."""
_DPI = 140
_LINES, _LINE = 2, 0.15  # of words above the board, and how high a line is, in heights of the board
_BEFORE = 0.004  # [m] that the cursor is in front of the board
_CURSOR = (30, 30, 30)

_log = logging.getLogger(__name__)


class SpeedBoard:
    """The speed of a motion against time, as a picture that stands in the scene.

    Without Matplotlib there is only the line that says the speed.

    Parameters
    ----------
    view : viser.SceneApi
        Where it is shown.
    name : str
        Name of its node.
    motion : TimedMotion
        What moves.
    centre : (3,) array
        Its centre [m].
    width : float
        [m]
    facing : (3,) array
        A level direction from which it is seen.

    Attributes
    ----------
    has_title : bool
        Whether it says the motion's name: it does where there is Matplotlib.
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
            view.add_image(
                name,
                image,
                float(self._size[0]),
                float(self._size[1]),
                format="png",
                cast_shadow=False,
                receive_shadow=False,
                wxyz=wxyz(turn),
                position=centre,
            )
        self._cursor = view.add_line_segments(
            f"{name}_cursor", np.zeros((1, 2, 3)), _CURSOR, thickness=0.006 * width
        )
        self._labels = [
            view.add_label(f"{name}_told_{k}", "", anchor="bottom-center", font_screen_scale=0.9)
            for k in range(_LINES)
        ]
        self.at(0.0)

    def at(self, time: float) -> None:
        """Show how fast it is at a time [s]."""
        left, bottom, width, height = AXES
        share = left + width * min(time / self._motion.duration, 1.0)
        ends = np.array([self._place(share, bottom), self._place(share, bottom + height)])
        self._cursor.points = ends[None].astype(np.float32)
        said = self._motion.remark(time).split("; ", _LINES - 1)
        for k, label in enumerate(self._labels):
            label.text = said[k] if k < len(said) else ""
            label.visible = k < len(said)
            label.position = self._place(0.5, 1.04 + _LINE * (len(said) - 1 - k))

    def _place(self, across: float, above: float) -> FloatArray:
        place: FloatArray = (
            self._corner + across * self._size[0] * self._right + above * self._size[1] * self._up
        )
        return place


def _picture(motion: TimedMotion) -> Any:
    try:
        figure = plot_speeds(
            motion.times, motion.speeds, motion.bounds, motion.binding, None, title=motion.name, dpi=_DPI
        )
    except SafeOmplError as missing:
        _log.warning("no board with the speed: %s", missing)
        return None
    return np.asarray(figure.canvas.buffer_rgba())[..., :3]
