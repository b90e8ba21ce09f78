"""The picture of a trajectory: caps that bind in their colours, joints within their limits, danger and its bound."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from safe_ompl import DangerField, RateLimits, time_path
from safe_ompl.io import ACCELERATION
from safe_ompl.view.plots import plot_motion

PATH = [
    [0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.0],
    [1.2, 0.2, 0.4, -1.2, 0.3, 2.0, 0.5],
    [0.2, 0.4, -0.4, -1.8, 0.0, 1.0, 0.0],
]


@pytest.fixture(scope="module")
def trajectory(panda):
    return time_path(PATH, panda, RateLimits.of(panda, 1.0, 4.0), tool_speed=0.4)


def test_speed_and_what_binds_it(trajectory, tmp_path):
    speed, velocity, acceleration = plot_motion(trajectory, tmp_path / "motion.png").axes
    assert (tmp_path / "motion.png").stat().st_size > 10_000
    lines = {line.get_label(): line for line in speed.lines}
    whole = lines[ACCELERATION]
    assert whole.get_ydata().max() == pytest.approx(np.sqrt(trajectory.law.squares.max()))
    bound = lines["tool speed"].get_ydata()
    kept = np.isfinite(bound)
    assert 0 < kept.mean() < 1
    np.testing.assert_allclose(bound[kept], whole.get_ydata()[kept])
    assert len(speed.lines) >= 3
    for axes in (velocity, acceleration):
        shares = np.concatenate([line.get_ydata() for line in axes.lines if len(line.get_ydata()) > 2])
        assert 0.3 < abs(shares).max() <= 1 + 1e-9


def test_nothing_is_cut_at_the_edges(trajectory, tmp_path):
    figure = plot_motion(trajectory, tmp_path / "motion.png")
    renderer = figure.canvas.get_renderer()
    width, height = figure.canvas.get_width_height()
    for axes in figure.axes:
        box = axes.get_tightbbox(renderer)
        assert 0.005 * width < box.x0 < box.x1 < 0.99 * width
        assert 0 < box.y0 < box.y1 <= height
        frame = axes.get_window_extent(renderer)
        assert frame.x1 < 0.985 * width, "a line at the end of the axes is drawn in full"


def test_danger_and_its_proven_peak(trajectory, panda, tmp_path):
    danger = trajectory.danger(DangerField(panda, [[0.6, 0.4, 0.5]]).moving)
    figure = plot_motion(trajectory, tmp_path / "motion.svg", danger=danger, title="mine")
    axes = figure.axes
    assert figure.get_suptitle() == "mine"
    np.testing.assert_allclose(axes[3].lines[0].get_ydata(), danger.values)
    assert f"proven below {danger.proven_peak:.2f}" in axes[3].get_title(loc="right")
