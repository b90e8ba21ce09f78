"""The collision shapes of a MuJoCo model (MJCF) as a scene, and a plan among them (pip install mujoco)."""

try:
    import mujoco
except ModuleNotFoundError:
    raise SystemExit("mujoco is missing: pip install mujoco") from None
import pinocchio as pin

from safe_ompl import Box, Capsule, Cylinder, Obstacle, Pose, Robot, SafeSetup, Scene, Sphere

WORLD = """
<mujoco><worldbody>
  <geom name="pillar" type="box" size="0.075 0.075 0.5" pos="0.45 0 0.4"/>
  <body name="table" pos="0 0.7 0.2"><geom name="top" type="cylinder" size="0.25 0.02" euler="0 0 30"/></body>
  <geom name="picture" type="sphere" size="0.1" pos="0 0 3" contype="0" conaffinity="0"/>
</worldbody></mujoco>
"""
SHAPES = {
    mujoco.mjtGeom.mjGEOM_BOX: lambda size: Box(tuple((2.0 * size).tolist())),
    mujoco.mjtGeom.mjGEOM_SPHERE: lambda size: Sphere(float(size[0])),
    mujoco.mjtGeom.mjGEOM_CAPSULE: lambda size: Capsule(float(size[0]), 2.0 * float(size[1])),
    mujoco.mjtGeom.mjGEOM_CYLINDER: lambda size: Cylinder(float(size[0]), 2.0 * float(size[1])),
}


def scene_of(model: mujoco.MjModel, data: mujoco.MjData) -> Scene:
    """Return what can collide, where it is now; a KeyError names an unknown kind of shape."""
    mujoco.mj_forward(model, data)
    obstacles = []
    for k in range(model.ngeom):
        if model.geom_contype[k] or model.geom_conaffinity[k]:
            shape = SHAPES[mujoco.mjtGeom(model.geom_type[k])](model.geom_size[k])
            pose = Pose.of(pin.SE3(data.geom_xmat[k].reshape(3, 3), data.geom_xpos[k]))
            obstacles.append(Obstacle(model.geom(k).name or f"geom {k}", shape, pose))
    return Scene(tuple(obstacles))


model = mujoco.MjModel.from_xml_string(WORLD)  # or from_xml_path("world.xml")
scene = scene_of(model, mujoco.MjData(model))
setup = SafeSetup(Robot.from_example("ur5"), scene)
setup.setConfigurations([0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0])
result = setup.plan("SafeRRTConnect", time=10.0, seed=0, simplify=True)
print([obstacle.name for obstacle in scene], f"clearance {1e3 * result.report.clearance.min:.0f} mm")
