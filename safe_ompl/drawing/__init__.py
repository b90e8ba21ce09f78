"""Pictures, plots and the browser view.

The browser view needs the extra `safe-ompl[viewer]`; pictures and plots need `safe-ompl[plots]`. Plots that compare
several paths or planners are in `safe_ompl.drawing.plots`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
