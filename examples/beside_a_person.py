"""A person reaches over a table: safe and classical planning of the same motion."""

from safe_ompl import Box, Obstacle, Person, Pose, Robot, SafeSetup, Scene

# Key points may come from a tracker, some or all: head, left_wrist, right_hand, … in the frame of the person [m].
worker = Person(height=1.72, keypoints={"right_wrist": (0.42, -0.12, 1.05)})
scene = Scene(
    (
        Obstacle("worker", worker, Pose((0.95, 0.0, -0.85), (0.0, 0.0, 1.0, 0.0))),
        Obstacle("table", Box((0.8, 1.4, 0.03)), Pose((0.1, 0.0, -0.03))),
    )
)
setup = SafeSetup(Robot.from_example("panda"), scene)
setup.setConfigurations([1.3, 0.1, 0, -2.0, 0, 2.2, 0.785], [-1.3, 0.1, 0, -2.0, 0, 2.2, 0.785])

for planner in ("ClassicRRTConnect", "SafeRRTConnect"):
    result = setup.plan(planner, time=10.0, seed=0)
    assert result, result.status
    danger, clearance = result.report.danger, result.report.clearance
    print(f"{planner}: danger mean {danger.mean:.2f}, peak {danger.max:.2f}; ", end="")
    print(f"{1e3 * clearance.min:.0f} mm from {clearance.link} to {clearance.obstacle}")

shortened = setup.plan("SafeRRTConnect", time=10.0, seed=0, simplify=True)
print(f"simplified: danger mean {shortened.report.danger.mean:.2f}, {shortened.report.length:.2f} rad")
# safe_ompl.view(result) shows it in the browser (pip install 'safe-ompl[viewer]').
