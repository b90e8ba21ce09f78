"""Plots of danger along paths, of planners' times, and of configuration spaces of small arms.

All functions take numbers or models, write one picture and return it as a `matplotlib.figure.Figure`. `file` is where
it goes: the ending of its name decides the format (PNG, SVG or PDF), and missing folders are made. `title` is the line
above it. Without Matplotlib they raise a SafeOmplError.
"""

from safe_ompl.pictures.plots.cspace import plot_bubbles, plot_cspace_path
from safe_ompl.pictures.plots.field import plot_field
from safe_ompl.pictures.plots.motion import plot_motion
from safe_ompl.pictures.plots.plan import plot_plan
from safe_ompl.pictures.plots.planners import plot_bands, plot_clearance_danger, plot_profiles, plot_times
from safe_ompl.pictures.plots.speeds import plot_speeds

__all__ = [
    "plot_bands",
    "plot_bubbles",
    "plot_clearance_danger",
    "plot_cspace_path",
    "plot_field",
    "plot_motion",
    "plot_plan",
    "plot_profiles",
    "plot_speeds",
    "plot_times",
]
