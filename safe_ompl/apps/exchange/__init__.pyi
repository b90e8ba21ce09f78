from .mjcf import world_from_mjcf as world_from_mjcf
from .moveit import scene_from_moveit as scene_from_moveit
from .pieces import proven_pieces as proven_pieces
