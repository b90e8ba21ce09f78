"""Construction of robots: from files or models, on a base, with objects in the gripper, beside others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.robot.loading.blueprint import Attached as Attached
    from safe_ompl.robot.loading.blueprint import Attachment as Attachment
    from safe_ompl.robot.loading.blueprint import Blueprint as Blueprint
    from safe_ompl.robot.loading.blueprint import Combined as Combined
    from safe_ompl.robot.loading.blueprint import OnBase as OnBase
    from safe_ompl.robot.loading.blueprint import OnMobileBase as OnMobileBase
    from safe_ompl.robot.loading.blueprint import WithAccelerations as WithAccelerations
    from safe_ompl.robot.loading.blueprint import check_prefixes as check_prefixes
    from safe_ompl.robot.loading.blueprint import mobile_ranges as mobile_ranges
    from safe_ompl.robot.loading.collision import CollisionSource as CollisionSource
    from safe_ompl.robot.loading.packages import EXAMPLES as EXAMPLES
    from safe_ompl.robot.loading.packages import ExampleRobot as ExampleRobot
    from safe_ompl.robot.loading.packages import PackageFolders as PackageFolders
    from safe_ompl.robot.loading.packages import find_example as find_example
    from safe_ompl.robot.loading.packages import robots_folder as robots_folder
    from safe_ompl.robot.loading.reduction import joints_without_range as joints_without_range
    from safe_ompl.robot.loading.reduction import resting_value as resting_value
    from safe_ompl.robot.loading.sources import UrdfBlueprint as UrdfBlueprint
    from safe_ompl.robot.loading.srdf import SrdfFile as SrdfFile
    from safe_ompl.robot.loading.srdf import disabled_links as disabled_links
    from safe_ompl.robot.loading.srdf import srdf_text as srdf_text
    from safe_ompl.robot.loading.urdf import UrdfFile as UrdfFile
    from safe_ompl.robot.loading.urdf import parsed as parsed

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
