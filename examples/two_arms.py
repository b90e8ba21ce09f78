"""Two arms in one cell, planned together; and one arm on a base that drives."""

from safe_ompl import Box, Obstacle, Pose, Robot, SafeSetup, Scene

left = Robot.from_example("ur5", base=(0.0, 0.5, 0.0))
right = Robot.from_example("ur5", base=(0.0, -0.5, 0.0))
cell = Robot.combined("cell", {"left": left, "right": right})
floor = Obstacle("floor", Box((4.0, 4.0, 0.02)), Pose((0.0, 0.0, -0.03)))
post = Obstacle("post", Box((0.06, 0.06, 0.9)), Pose((1.0, 0.0, 0.45)), weight=1.0)

setup = SafeSetup(cell, Scene((floor, post)))
posture = [-1.4, 1.4, -1.6, -1.57, 0.0]
start, goal = [1.0, *posture, -1.0, *posture], [-0.5, *posture, 1.0, *posture]
setup.setConfigurations(start, goal)
result = setup.plan("SafeRRTConnect", time=10.0)
assert result, result.status
print(f"two arms, {cell.n} joints: {result.report.length:.2f} rad, certified: {result.report.certified}")

driving = Robot.from_example("ur5", base=(0.0, 0.0, 0.5), mobile_base=((-2.0, 2.0), (-2.0, 2.0)))
setup = SafeSetup(driving, Scene((Obstacle("post", Box((0.1, 0.1, 2.0)), Pose((0.0, 0.0, 1.0)), weight=1.0),)))
arm = [0.0, -1.6, 1.6, -1.6, -1.57, 0.0]
setup.setConfigurations([-1.5, 0.0, 0.0, *arm], [1.5, 0.0, 0.0, *arm])
result = setup.plan("SafeRRTConnect", time=10.0)
assert result, result.status
print(f"on wheels, {', '.join(driving.joint_names[:3])} …: {len(result.path)} way points")
