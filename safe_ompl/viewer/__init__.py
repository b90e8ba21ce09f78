"""Robot, scene, paths, danger and proofs in the browser, live or as one file; needs the extra `safe-ompl[viewer]`."""

from safe_ompl.viewer.exhibit import Exhibit
from safe_ompl.viewer.film import save_film
from safe_ompl.viewer.page import save_page
from safe_ompl.viewer.recordings import read_recording
from safe_ompl.viewer.view import View

__all__ = ["Exhibit", "View", "read_recording", "save_film", "save_page"]
