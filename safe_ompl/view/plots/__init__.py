"""Plots of danger along paths, of speeds, and of what compares planners.

All functions take numbers or motions, write one picture and return it as a `matplotlib.figure.Figure`. `file` is where
it goes: the ending of its name decides the format (PNG, SVG, PDF or WebP), and missing folders are made. `title` is the
line above it, `dpi` are pixels per inch, where these can be chosen. Without Matplotlib they raise a SafeOmplError.
"""

from safe_ompl.view.plots.paths import plot_check, plot_motion, plot_plan, plot_speeds
from safe_ompl.view.plots.planners import plot_clearance_danger, plot_profiles, plot_tradeoff

__all__ = [
    "plot_check",
    "plot_clearance_danger",
    "plot_motion",
    "plot_plan",
    "plot_profiles",
    "plot_speeds",
    "plot_tradeoff",
]
