"""The figures: those of each study (Figs. 6–13), and what explains the ideas (Figs. 1, 3, 4)."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from _paper.evidence import Evidence
from _paper.planar import plot_bubbles, plot_cspace_path, plot_field
from safe_ompl.apps.cli.compare import draw_comparison
from safe_ompl.planning.from_scenario import setup_scenario
from safe_ompl.planning.safe_setup import SafeSetup
from safe_ompl.scene.scenario import Scenario, find_scenario
from safe_ompl.view import DrawnPath, render_path, save_png
from safe_ompl.view.style import planner_styles

_IN_CSPACE = ("ClassicRRTConnect", "SafeRRTConnect")
_FIELD_POSES = ((0.6, 0.9), (1.4, -2.0))
_BUBBLE_POSES = ((0.8, 0.0), (2.3, 1.2))


class Figure(NamedTuple):
    """A picture of a study: its file, the number of the paper's figure in study 1 and 2, and what it shows."""

    file: str
    after: tuple[str, str]
    caption: str


STUDY_FIGURES = (
    Figure("paths.png", ("6", "10"), "Typical paths: of each planner the run of median mean danger"),
    Figure("profiles.png", ("7", "11"), "Danger along the path, averaged over the runs"),
    Figure("bands.png", ("8", "12"), "Danger along the path: mean, median, 15–85 %"),
    Figure("times.png", ("9", "13"), "Planning times"),
)


def draw_study(evidence: Evidence, scenario: Scenario, folder: Path) -> None:
    """Draw the pictures of a study into its folder."""
    summaries = [summary for summary in evidence.summaries.values() if summary.solved]
    if summaries:
        draw_comparison(setup_scenario(scenario), summaries, folder)


def draw_ideas(folder: Path) -> dict[str, str]:
    """Draw the pictures that explain the ideas; return their captions by file name."""
    arm = setup_scenario(Scenario.load(find_scenario("planar2")))
    plot_field(arm.robot, _FIELD_POSES, folder / "field.png")
    plot_bubbles(arm.checker, _BUBBLE_POSES, folder / "bubbles.png")
    _draw_cspace(setup_scenario(Scenario.load(find_scenario("planar3"))), folder / "cspace.png")
    return {
        "cspace.png": "After Fig. 1: paths in C-space, and the arm along the safe one",
        "field.png": "After Fig. 3: contours of the danger field of an arm of two joints",
        "bubbles.png": "After Fig. 4: two configurations, and their bubbles in C-space",
    }


def _draw_cspace(setup: SafeSetup, file: Path) -> None:
    results = {name: setup.plan(name, seed=1) for name in _IN_CSPACE}
    paths = {name: result.path for name, result in results.items() if result.path is not None}
    figure = plot_cspace_path(setup.checker, paths, file)
    left = np.asarray(figure.canvas.buffer_rgba())[..., :3]
    safe = _IN_CSPACE[1]
    right = render_path(
        setup.robot,
        setup.scene,
        DrawnPath(paths[safe], accent=planner_styles([safe])[safe].colour),
        size=(len(left), len(left)),
    )
    save_png(np.hstack([left, right]), file)
