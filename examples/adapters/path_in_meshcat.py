"""Robot, scene and path in meshcat, which plays it in the browser (pip install meshcat)."""

try:
    import meshcat
    import meshcat.geometry as g
except ModuleNotFoundError:
    raise SystemExit("meshcat is missing: pip install meshcat") from None
import numpy as np
from pinocchio.visualize import MeshcatVisualizer

from safe_ompl import Box, Obstacle, Pose, Robot, SafeSetup, Scene

robot = Robot.from_example("ur5")
scene = Scene((Obstacle("pillar", Box((0.15, 0.15, 1.0)), Pose((0.45, 0.0, 0.4)), weight=1.0),))
setup = SafeSetup(robot, scene)
setup.setConfigurations([0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0])
result = setup.plan("SafeRRTConnect", time=10.0, simplify=True)
assert result, result.status

show = MeshcatVisualizer(robot.model, robot.collision_model, robot.visual_model)
show.initViewer(meshcat.Visualizer())
show.loadViewerModel()
for obstacle in scene:
    vertices, faces = obstacle.triangles(32)
    material = g.MeshLambertMaterial(color=0xC8452B if obstacle.weight else 0xCCAD87)
    show.viewer["scene"][obstacle.name].set_object(g.TriangularMeshGeometry(vertices, faces), material)

film = meshcat.animation.Animation(default_framerate=30)
shares = np.linspace(0.0, len(result.path) - 1, 30 * len(result.path))
for frame, share in enumerate(shares):
    k = min(int(share), len(result.path) - 2)
    q = result.path[k] + (share - k) * robot.difference(result.path[k], result.path[k + 1])
    with film.at_frame(show.viewer, frame) as view:
        show.viewer, whole = view, show.viewer
        show.display(robot.pinocchio_configuration(q))
        show.viewer = whole
show.viewer.set_animation(film)
print(f"{len(shares)} frames at {show.viewer.url()}")
