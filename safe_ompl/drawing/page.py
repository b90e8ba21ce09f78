"""Figures with a common style, and checks of the plotted numbers; pyplot is not used."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, SafeOmplError, files, finite_array

ALONG = "along the path, from start to goal"
DANGER = "danger"
GREY = "0.45"
ALARM = "#c8452b"
DPI = 150
_STYLE = Path(__file__).with_suffix(".mplstyle")

PLOT_ENDINGS = (".png", ".svg", ".pdf", ".webp")


def plot_kind(file: str | Path) -> str:
    """Return the file format for the extension of a picture, or raise InputError for another extension."""
    ending = Path(file).suffix.lower()
    if ending not in PLOT_ENDINGS:
        raise InputError(f"{str(file)!r} must end in {' or '.join(PLOT_ENDINGS)}", "picture")
    return ending[1:]


@contextmanager
def page(
    file: str | Path | None, width: float, height: float, dpi: int = DPI, *, arranged: bool = True
) -> Iterator[Any]:
    """Yield a figure of width and height [inch]. At the end it is saved to a file, or only drawn on its canvas.

    Matplotlib arranges the axes if `arranged`. Missing folders are created. Raises SafeOmplError if
    Matplotlib is not installed.
    """
    try:
        import matplotlib
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.layout_engine import ConstrainedLayoutEngine
    except ImportError as missing:
        raise SafeOmplError("plots need Matplotlib: pip install 'safe-ompl[plots]'") from missing
    kind = None if file is None else plot_kind(file)
    with matplotlib.rc_context(fname=_STYLE):
        # The margin keeps what ends at the edge of the axes, such as a tick's label, from being cut.
        layout = ConstrainedLayoutEngine(rect=(0.008, 0.0, 0.98, 0.992)) if arranged else None
        figure = Figure(figsize=(width, height), dpi=dpi, layout=layout)
        FigureCanvasAgg(figure)
        yield figure
        if file is None:
            figure.canvas.draw()
            return
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        with files.replacing(file, binary=True) as stream:
            figure.savefig(stream, format=kind)


def set_title(figure: Any, title: str) -> None:
    """Write a title above all axes."""
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, weight="bold")


def curve(values: ArrayLike, kind: str) -> FloatArray:
    """Return the values along a path as a non-empty array (S,)."""
    curve = finite_array(values, (None,), kind)
    if not len(curve):
        raise InputError(f"{kind} has no values; give at least one")
    return curve


def draw_limit(axes: Any, value: float) -> None:
    """Draw a dashed line at a limit."""
    axes.axhline(value, color=ALARM, linewidth=1.0, linestyle=(0, (4.0, 3.0)))


def add_legend_above(axes: Any, fontsize: float = 9.0, **more: Any) -> None:
    """Write the legend just above the axes, in up to four columns."""
    place = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": 4, "borderaxespad": 0.2}
    axes.legend(**{**place, "fontsize": fontsize, **more})
