"""A robot of LeRobot that guards another one, ``--robot.type=safe_ompl``; needs LeRobot (`pip install lerobot`)."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.apps.exchange.lerobot.robot import (
        SafeOmplChunks as SafeOmplChunks,
        SafeOmplRobot as SafeOmplRobot,
        SafeOmplRobotConfig as SafeOmplRobotConfig,
    )

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
