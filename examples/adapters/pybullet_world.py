"""The collision shapes of a PyBullet world as a scene, and a plan among them (pip install pybullet)."""

try:
    import pybullet as p
except ModuleNotFoundError:
    raise SystemExit("pybullet is missing: pip install pybullet") from None

from safe_ompl import Box, Capsule, Cylinder, Obstacle, Pose, Robot, SafeSetup, Scene, Sphere

SHAPES = {
    p.GEOM_BOX: lambda size: Box(size),
    p.GEOM_SPHERE: lambda size: Sphere(size[0]),
    p.GEOM_CYLINDER: lambda size: Cylinder(size[1], size[0]),  # PyBullet has the length first
    p.GEOM_CAPSULE: lambda size: Capsule(size[1], size[0]),
}


def scene_of(*bodies: int) -> Scene:
    """Return the shapes of bodies of one link, where they are now; a KeyError names a kind that is not known."""
    obstacles = []
    for body in bodies:
        name = p.getBodyInfo(body)[1].decode() or "body"
        base = p.getBasePositionAndOrientation(body)
        for k, (_, _, kind, size, _, *local) in enumerate(p.getCollisionShapeData(body, -1)):
            pose = Pose(*p.multiplyTransforms(*base, *local))
            obstacles.append(Obstacle(f"{name} {body}.{k}", SHAPES[kind](size), pose))
    return Scene(tuple(obstacles))


p.connect(p.DIRECT)
pillar = p.createCollisionShape(p.GEOM_BOX, halfExtents=[0.075, 0.075, 0.5])
ball = p.createCollisionShape(p.GEOM_CAPSULE, radius=0.1, height=0.3)
bodies = [
    p.createMultiBody(0, pillar, basePosition=[0.45, 0.0, 0.4]),
    p.createMultiBody(0, ball, basePosition=[0.0, 0.7, 0.3], baseOrientation=[0.0, 0.38, 0.0, 0.92]),
]
setup = SafeSetup(Robot.from_example("ur5"), scene_of(*bodies))
setup.setConfigurations([0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0])
result = setup.plan("SafeRRTConnect", time=10.0, seed=0, simplify=True)
assert result, result.status
print(setup.scene, f"clearance {1e3 * result.report.clearance.min:.0f} mm")
