"""Pictures, plots and the view in the browser.

The browser needs the extra `safe-ompl[viewer]`, all pictures `safe-ompl[plots]`. Plots beyond those of one path are in
`safe_ompl.drawing.plots`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.drawing import plots as plots
    from safe_ompl.drawing.content import (
        RECORDING_ENDING as RECORDING_ENDING,
        ViewerContent as ViewerContent,
        read_recording as read_recording,
    )
    from safe_ompl.drawing.page import PLOT_ENDINGS as PLOT_ENDINGS
    from safe_ompl.drawing.pictures import (
        ANIMATION_ENDINGS as ANIMATION_ENDINGS,
        draw_plan as draw_plan,
        draw_program as draw_program,
        render_comparison as render_comparison,
        render_path as render_path,
        save_animation as save_animation,
        save_picture as save_picture,
        small_picture as small_picture,
    )
    from safe_ompl.drawing.surfaces import RobotBody as RobotBody
    from safe_ompl.drawing.viewer import BrowserView as BrowserView, save_page as save_page, view as view

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
