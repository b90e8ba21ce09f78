"""Former name of `safe_ompl.people.replanning` and `safe_ompl.exchange.ticks`, kept for one version."""

import sys
import warnings
from importlib import import_module

_MOVED = {
    "command": "safe_ompl.people.replanning.command",
    "replanner": "safe_ompl.people.replanning.replanner",
    "ticks": "safe_ompl.exchange.ticks",
}

warnings.warn(
    "safe_ompl.live is gone in the next version: "
    + ", ".join(f"safe_ompl.live.{former} is {name}" for former, name in _MOVED.items()),
    DeprecationWarning,
    stacklevel=2,
)
for _former, _name in _MOVED.items():
    sys.modules[f"{__name__}.{_former}"] = import_module(_name)
