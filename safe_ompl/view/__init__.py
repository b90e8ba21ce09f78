"""Pictures, plots and the view in the browser.

The browser needs the extra `safe-ompl[viewer]`, all pictures `safe-ompl[plots]`. The module can be called:
`safe_ompl.view(result)` is `safe_ompl.view.view(result)`. Plots beyond those of one path are in `safe_ompl.view.plots`.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.view import plots
    from safe_ompl.view.content import RECORDING_ENDING, ViewerContent, read_recording
    from safe_ompl.view.page import PLOT_ENDINGS
    from safe_ompl.view.pictures import (
        ANIMATION_ENDINGS,
        draw_plan,
        render_comparison,
        render_path,
        save_animation,
        save_picture,
        small_picture,
    )
    from safe_ompl.view.surfaces import RobotBody
    from safe_ompl.view.viewer import BrowserView, save_page, view

__all__ = [
    "ANIMATION_ENDINGS",
    "PLOT_ENDINGS",
    "RECORDING_ENDING",
    "BrowserView",
    "RobotBody",
    "ViewerContent",
    "draw_plan",
    "plots",
    "read_recording",
    "render_comparison",
    "render_path",
    "save_animation",
    "save_page",
    "save_picture",
    "small_picture",
    "view",
]

__getattr__, __dir__ = lazily(__name__, __file__)


class _CallableModule(ModuleType):
    """Lets people call `safe_ompl.view(result)`, a name that importing this module binds to the module."""

    def __call__(self, *shown: Any, **options: Any) -> None:
        """Show results in the browser, see `view`."""
        self.view(*shown, **options)


sys.modules[__name__].__class__ = _CallableModule
