"""Three-dimensional pictures of robots along paths, rendered without a display."""

from safe_ompl.pictures.render.camera import Camera
from safe_ompl.pictures.render.comparison import render_comparison, save_png
from safe_ompl.pictures.render.path import choose_camera, render_path

__all__ = ["Camera", "choose_camera", "render_comparison", "render_path", "save_png"]
