"""Construction of robots: from files or models, on a base, with objects in the gripper, beside others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.robot.loading.blueprint import (
        Attached,
        Attachment,
        Blueprint,
        Combined,
        OnBase,
        OnMobileBase,
        WithAccelerations,
        check_prefixes,
        mobile_ranges,
    )
    from safe_ompl.robot.loading.collision import CollisionSource, links_lacking_shapes
    from safe_ompl.robot.loading.packages import EXAMPLES, ExampleRobot, PackageFolders, find_example, robots_folder
    from safe_ompl.robot.loading.reduction import joints_without_range, resting_value
    from safe_ompl.robot.loading.sources import UrdfBlueprint
    from safe_ompl.robot.loading.srdf import SrdfFile, disabled_links, srdf_text
    from safe_ompl.robot.loading.urdf import UrdfFile, parsed

__all__ = [
    "EXAMPLES",
    "Attached",
    "Attachment",
    "Blueprint",
    "CollisionSource",
    "Combined",
    "ExampleRobot",
    "OnBase",
    "OnMobileBase",
    "PackageFolders",
    "SrdfFile",
    "UrdfBlueprint",
    "UrdfFile",
    "WithAccelerations",
    "check_prefixes",
    "disabled_links",
    "find_example",
    "joints_without_range",
    "links_lacking_shapes",
    "mobile_ranges",
    "parsed",
    "resting_value",
    "robots_folder",
    "srdf_text",
]

__getattr__, __dir__ = lazily(__name__, __file__)
