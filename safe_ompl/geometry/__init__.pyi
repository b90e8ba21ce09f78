from . import surfaces as surfaces
from .cells import Voxels as Voxels
from .cloud import PointCloud as PointCloud
from .hulls import (
    DISTANCE_ERROR as DISTANCE_ERROR,
    ConvexBodies as ConvexBodies,
    Hull as Hull,
    bounding_box as bounding_box,
    bounding_hull as bounding_hull,
    convex_hull as convex_hull,
    hull_planes as hull_planes,
    triangle_tree as triangle_tree,
)
from .meshes import MeshFrame as MeshFrame, check_mesh as check_mesh
from .obstacle import Obstacle as Obstacle, check_number as check_number
from .person import LIMBS as LIMBS, STANDING as STANDING, Limb as Limb, Person as Person
from .pose import (
    LONGEST as LONGEST,
    POSE_KEYS as POSE_KEYS,
    Pose as Pose,
    PoseLike as PoseLike,
    placed as placed,
    rotation_vectors as rotation_vectors,
    turn_between as turn_between,
    turn_onto as turn_onto,
)
from .shapes import (
    Box as Box,
    Capsule as Capsule,
    Cylinder as Cylinder,
    Mesh as Mesh,
    Part as Part,
    Shape as Shape,
    Sphere as Sphere,
    written_mesh as written_mesh,
)
from .surfaces import Triangles as Triangles
