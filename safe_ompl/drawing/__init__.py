"""Pictures, plots and the view in the browser.

The browser needs the extra `safe-ompl[viewer]`, all pictures `safe-ompl[plots]`. Plots beyond those of one path are in
`safe_ompl.drawing.plots`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
