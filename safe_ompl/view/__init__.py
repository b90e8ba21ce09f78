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
    from safe_ompl.view import plots as plots
    from safe_ompl.view.browser.view import BrowserView as BrowserView
    from safe_ompl.view.browser.view import save_page as save_page
    from safe_ompl.view.browser.view import view as view
    from safe_ompl.view.content import RECORDING_ENDING as RECORDING_ENDING
    from safe_ompl.view.content import ViewerContent as ViewerContent
    from safe_ompl.view.content import read_recording as read_recording
    from safe_ompl.view.pictures.path import ANIMATION_ENDINGS as ANIMATION_ENDINGS
    from safe_ompl.view.pictures.path import DrawnPath as DrawnPath
    from safe_ompl.view.pictures.path import draw_plan as draw_plan
    from safe_ompl.view.pictures.path import drawn_path as drawn_path
    from safe_ompl.view.pictures.path import render_comparison as render_comparison
    from safe_ompl.view.pictures.path import render_contact as render_contact
    from safe_ompl.view.pictures.path import render_path as render_path
    from safe_ompl.view.pictures.path import save_animation as save_animation
    from safe_ompl.view.pictures.path import save_png as save_png
    from safe_ompl.view.pictures.surface import RobotBody as RobotBody

__all__, __getattr__, __dir__ = lazily(__name__, __file__)


class _CallableModule(ModuleType):
    """Lets people call `safe_ompl.view(result)`, a name that importing this module binds to the module."""

    def __call__(self, *shown: Any, **options: Any) -> None:
        """Show results in the browser, see `view`."""
        self.view(*shown, **options)


sys.modules[__name__].__class__ = _CallableModule
