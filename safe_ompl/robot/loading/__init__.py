"""Construction of robots: from files or models, on a base, with objects in the gripper, beside others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.robot.loading.attachment import Attachment
    from safe_ompl.robot.loading.collision import CollisionSource, links_lacking_shapes
    from safe_ompl.robot.loading.examples import EXAMPLES, ExampleRobot, find_example, robots_folder
    from safe_ompl.robot.loading.reduction import joints_without_range, resting_value
    from safe_ompl.robot.loading.srdf import SrdfFile, disabled_links, srdf_text
    from safe_ompl.robot.loading.urdf import PackageFolders, UrdfFile, parsed

__all__ = [
    "EXAMPLES",
    "Attachment",
    "CollisionSource",
    "ExampleRobot",
    "PackageFolders",
    "SrdfFile",
    "UrdfFile",
    "disabled_links",
    "find_example",
    "joints_without_range",
    "links_lacking_shapes",
    "parsed",
    "resting_value",
    "robots_folder",
    "srdf_text",
]

__getattr__, __dir__ = lazily(__name__, __file__)
