"""Hard limits: a clearance and a danger that no configuration of a path may violate, proven along whole motions."""

from safe_ompl import CollisionError, Obstacle, Person, Pose, Robot, SafeSetup, Scene

worker = Obstacle("worker", Person(height=1.75), Pose((1.1, 0.0, -0.8), (0.0, 0.0, 1.0, 0.0)))
setup = SafeSetup(Robot.from_example("ur5"), Scene((worker,)))
setup.setConfigurations([0.9, -1.6, 1.6, -1.6, -1.57, 0.0], [-0.9, -1.6, 1.6, -1.6, -1.57, 0.0])

free = setup.plan("RRTConnect", time=5.0, seed=2)
print(f"without limits: {1e3 * free.report.clearance.min:.0f} mm, danger up to {free.report.danger.max:.2f}")

setup.setMinClearance(0.15)  # [m] from people, and from whatever has a danger weight
setup.setMaxDanger(10.0)
kept = setup.plan("RRTConnect", time=20.0, seed=2)  # OMPL's own planner keeps to it, too
assert kept, kept.status
print(f"with limits:    {1e3 * kept.report.clearance.min:.0f} mm, danger up to {kept.report.danger.max:.2f}")

try:
    setup.setMaxDanger(1.0)
except CollisionError as refused:
    print(f"a limit that the start violates is refused: {refused}")
