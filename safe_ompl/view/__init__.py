"""Robot, scene, paths, danger and proofs in the browser, live or as one file; needs the extra `safe-ompl[viewer]`."""

from safe_ompl.view.browser.view import View, save_page
from safe_ompl.view.content import ViewerContent
from safe_ompl.view.pictures.animation import save_animation
from safe_ompl.view.recordings import read_recording

__all__ = ["ViewerContent", "View", "read_recording", "save_animation", "save_page"]
