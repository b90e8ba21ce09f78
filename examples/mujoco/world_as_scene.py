"""The collision shapes of a MuJoCo model (MJCF) as a scene, and a plan among them (pip install mujoco)."""

from pathlib import Path
from tempfile import TemporaryDirectory

from safe_ompl import Robot, SafeSetup
from safe_ompl.apps.exchange import world_from_mjcf

WORLD = """
<mujoco><worldbody>
  <geom name="pillar" type="box" size="0.075 0.075 0.5" pos="0.45 0 0.4"/>
  <body name="table" pos="0 0.7 0.2"><geom name="top" type="cylinder" size="0.25 0.02" euler="0 0 30"/></body>
  <geom name="picture" type="sphere" size="0.1" pos="0 0 3" contype="0" conaffinity="0"/>
</worldbody></mujoco>
"""

with TemporaryDirectory() as folder:
    file = Path(folder, "world.xml")
    file.write_text(WORLD, encoding="utf-8")
    try:
        _, scene = world_from_mjcf(file)
    except ModuleNotFoundError as error:
        raise SystemExit(str(error)) from None
setup = SafeSetup(Robot.from_example("ur5"), scene)
setup.setConfigurations([0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0])
result = setup.plan("SafeRRTConnect", time=10.0, seed=0, simplify=True)
print([obstacle.name for obstacle in scene], f"clearance {1e3 * result.report.clearance.min:.0f} mm")
