"""The speed of a motion against time, and what bounds it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError
from safe_ompl.exchange.timed_motion import ACCELERATION
from safe_ompl.pictures.plots.data import curve
from safe_ompl.pictures.plots.page import DPI, GREY, Page
from safe_ompl.pictures.style import cap_colours

SIZE = (6.0, 2.7)
"""Width and height of the picture [inch]."""
AXES = (0.105, 0.19, 0.87, 0.58)
"""Left, bottom, width and height of the axes, as shares of the picture: where a cursor has to go."""


def plot_speeds(
    times: ArrayLike,
    speeds: ArrayLike,
    bounds: Mapping[str, ArrayLike],
    binding: Sequence[str | None],
    file: str | Path | None,
    *,
    title: str = "Speed along the path",
    dpi: int = DPI,
) -> Any:
    """Draw the speed along a path against time, in the colour of what bounds it, and the caps above it.

    Parameters
    ----------
    times : (T,) array
        [s]
    speeds : (T,) array
        ṡ [rad/s].
    bounds : mapping of str to (T,) array
        Name of a cap → the largest ṡ that it allows; +inf where it allows any.
    binding : sequence of str or None
        T names: the cap that the speed reaches; None where accelerations bind.
    file, title
        As of all pictures, see `safe_ompl.pictures.plots`; None: only the canvas of the figure is drawn.
    dpi : int
        Pixels per inch.

    Raises
    ------
    InputError
        If lengths differ, there is nothing to draw, or a time or speed is not finite.
    """
    t, s = curve(times, "times"), curve(speeds, "speeds")
    caps = {name: np.asarray(values, dtype=float) for name, values in bounds.items()}
    if {len(s), len(binding), *map(len, caps.values())} != {len(t)}:
        raise InputError(f"times, speeds, bounds and binding must be equally many, got {len(t)} times")
    names = dict.fromkeys([*caps, *filter(None, binding), ACCELERATION])
    colours = cap_colours(names)
    top = 1.25 * float(s.max()) or 1.0
    with Page(file, *SIZE, dpi, arranged=False) as page:
        axes = page.figure.add_axes(AXES)
        for name, values in caps.items():
            axes.plot(t, np.where(values <= 2 * top, values, np.nan), color=colours[name], linewidth=1.2)
        used = [name for name in names if name in {n or ACCELERATION for n in binding}]
        for name in used:
            reached = np.array([(n or ACCELERATION) == name for n in binding])
            axes.plot(t, _joined(s, reached), color=colours[name], linewidth=3.4, label=name)
        axes.set(xlabel="time [s]", ylabel="speed [rad/s]", xlim=(0.0, float(t[-1])), ylim=(0.0, top))
        page.figure.text(AXES[0], 0.93, title, weight="bold", fontsize=12)
        page.figure.text(0.985, 0.93, f"{t[-1]:.2f} s", ha="right", color=GREY, fontsize=12)
        axes.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=4,
            borderaxespad=0.2,
            handlelength=1.0,
            handletextpad=0.5,
            fontsize=8.5 if len(used) < 4 else 7.5,  # four names of caps are just within the axes
            columnspacing=1.0,
        )
    return page.figure


def _joined(values: FloatArray, chosen: Any) -> FloatArray:
    """Return values where chosen or just after, NaN elsewhere, so that the pieces of a line meet."""
    shown = chosen | np.concatenate([[False], chosen[:-1]])
    return np.where(shown, values, np.nan)
