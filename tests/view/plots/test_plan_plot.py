"""The plot of one plan: clearances of people and of things apart, labels beside the curves."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from safe_ompl import Box, InputError, Obstacle, Person, Pose, SafeSetup, Scene
from safe_ompl.view.pictures.results import _clearances
from safe_ompl.view.plots import plot_plan


def test_clearances_of_several_kinds_are_told_apart(tmp_path):
    people, things = np.array([0.5, 0.4, 0.6]), np.array([0.1, 0.1, 0.08])
    axes = plot_plan([1, 2, 1], tmp_path / "p.png", clearance={"people": people, "things": things}).axes[1]
    np.testing.assert_allclose(axes.lines[0].get_ydata(), 1e3 * people)
    np.testing.assert_allclose(axes.lines[1].get_ydata(), 1e3 * things)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["to people", "to things"]
    assert axes.get_title(loc="right") == "closest: 80 mm to things"
    assert axes.get_ylim()[1] > 600


@pytest.mark.parametrize("danger", [[5.0, 1.0, 5.01], [5.01, 1.0, 5.0], [1.0, 3.0, 5.0]])
def test_labels_of_start_and_goal_are_beside_the_axes_and_apart(danger, tmp_path):
    figure = plot_plan(danger, tmp_path / "p.png")
    axes = figure.axes[0]
    renderer = figure.canvas.get_renderer()
    boxes = [text.get_window_extent(renderer) for text in axes.texts]
    assert len(boxes) == 2
    assert all(box.x0 >= axes.get_window_extent(renderer).x1 for box in boxes)
    assert not boxes[0].overlaps(boxes[1])


def test_no_curve_of_clearance_is_refused(tmp_path):
    with pytest.raises(InputError, match="one curve at least"):
        plot_plan([1, 2], tmp_path / "p.png", clearance={})


def test_people_and_things_of_a_setup(ur5):
    person = Obstacle("worker", Person(height=1.7), Pose((1.2, 0.0, -0.8)))
    table = Obstacle("table", Box((1.0, 1.0, 0.04)), Pose((0.0, 0.0, -0.05)))
    path = np.array([[0.4, -1.2, 1.2, -1.0, -1.57, 0.0], [-0.8, -1.0, 1.0, -1.0, -1.57, 0.0]])
    both = SafeSetup(ur5, Scene((person, table)))
    found = _clearances(both, path)
    assert list(found) == ["people", "things"]
    nearest = [both.checker.clearance(q).distance for q in path]
    np.testing.assert_allclose(np.minimum(*found.values())[[0, -1]], nearest)
    assert list(_clearances(SafeSetup(ur5, Scene((table,))), path)) == ["things"]
    assert not _clearances(SafeSetup(ur5, Scene()), path)
    block = Obstacle("block", Box((0.1, 0.1, 0.1)), Pose((1.5, 0.0, 0.0)), weight=1.0)
    assert list(_clearances(SafeSetup(ur5, Scene((block,))), path)) == ["what is dangerous"]
