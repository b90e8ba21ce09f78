"""What others write: scenes and worlds of MoveIt and MuJoCo, and convex pieces of meshes."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.apps.exchange.mjcf import world_from_mjcf as world_from_mjcf
    from safe_ompl.apps.exchange.moveit import scene_from_moveit as scene_from_moveit
    from safe_ompl.apps.exchange.pieces import proven_pieces as proven_pieces

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
