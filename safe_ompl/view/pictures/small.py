"""Small pictures of results, reports, trajectories and checks, for notebooks."""

from __future__ import annotations

from importlib.util import find_spec
from io import BytesIO
from typing import Any

import numpy as np

from safe_ompl.motions import MotionCheck, Repair
from safe_ompl.paths import PathReport
from safe_ompl.planning import PlanResult
from safe_ompl.trajectories import Trajectory
from safe_ompl.view.pictures.path import DrawnPath, drawn_path, render_path
from safe_ompl.view.plots.paths import plot_check, plot_motion, plot_plan

_SIZE = (360, 280)  # [px]
_DPI = 60  # of plots


def small_picture(shown: Any) -> bytes:
    """Return a small picture as a PNG file: a robot along its path, or the plot of a report, a trajectory or a check.

    It is empty where there is nothing to draw, or Matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        return b""
    stream = BytesIO()
    shown = shown.check if isinstance(shown, Repair) else shown
    if isinstance(shown, PlanResult) and shown.robot is not None and shown.scene is not None:
        from matplotlib.image import imsave

        if shown.path is None:
            return b""
        path = DrawnPath(shown.path) if shown.report is None else drawn_path(shown)
        imsave(stream, render_path(shown.robot, shown.scene, path, size=_SIZE), format="png")
    elif (figure := _plot(shown)) is not None:
        figure.savefig(stream, format="png", dpi=_DPI)
    return stream.getvalue()


def _plot(shown: Any) -> Any:
    report = shown.report if isinstance(shown, PlanResult) else shown
    if isinstance(report, PathReport) and report.danger is not None:
        return plot_plan(np.asarray(report.danger.profile), None, title="danger")
    if isinstance(shown, Trajectory):
        return plot_motion(shown, None)
    return plot_check(shown, None) if isinstance(shown, MotionCheck) else None
