"""Your own robot: what safe-ompl reads from a URDF, and a first plan."""

from pathlib import Path

from safe_ompl import Box, Obstacle, Pose, Robot, SafeSetup, Scene

# Meshes named `package://…` are found in folders above the URDF; others: package_dirs=[…]. An SRDF says which links may
# touch; without one, neighbours and links that always touch are left out, and the log says which.
robot = Robot.from_urdf(Path(__file__).parent / "arm.urdf", tip="tool")
print(robot)
for name, low, high in zip(robot.joint_names, robot.lower, robot.upper, strict=True):
    print(f"  {name}: {low:+.2f} to {high:+.2f} rad")

# Only people are dangerous by default; `weight` makes anything else so.
post = Obstacle("post", Box((0.1, 0.1, 0.8)), Pose((0.45, 0.0, 0.4)), weight=1.0)
setup = SafeSetup(robot, Scene((post,)))
setup.setConfigurations([1.0, 1.0, 0.6, 0.0], [-1.0, 1.0, 0.6, 0.0])
result = setup.plan("SafeRRTConnect", time=5.0, simplify=True)

assert result, result.status
nearest = result.report.clearance
print(f"{len(result.path)} way points, {result.report.length:.2f} rad")
print(f"danger: mean {result.report.danger.mean:.2f}, at most {result.report.danger.max_bound:.2f}, proven")
print(f"clearance: {1e3 * nearest.min:.0f} mm from {nearest.link} to {nearest.obstacle}")
