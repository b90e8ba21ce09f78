"""A point cloud, as a depth camera gives it, as an obstacle: every point with a ball around it, nothing missed."""

import numpy as np

from safe_ompl import Obstacle, PointCloud, Robot, SafeSetup, Scene

rng = np.random.default_rng(0)
angles = rng.uniform(0.0, 2.0 * np.pi, 5000)
heights = rng.uniform(0.0, 0.9, 5000)
column = np.column_stack([0.5 + 0.08 * np.cos(angles), 0.08 * np.sin(angles), heights])
column[rng.integers(0, 5000, 100)] = np.nan  # what a camera does not see; such points are left out

# Points of PLY and NumPy files: PointCloud(radius=0.01, file="cloud.ply")
cloud = PointCloud(radius=0.01, points=column[np.isfinite(column).all(axis=1)])
scene = Scene((Obstacle("scan", cloud, weight=1.0),))
setup = SafeSetup(Robot.from_example("ur5"), scene)
setup.setConfigurations([0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0])
result = setup.plan("SafeRRTConnect", time=10.0, simplify=True)

assert result, result.status
print(f"{len(cloud.centres)} points, {len(scene.danger_points()[0])} of them danger points")
print(f"clearance {1e3 * result.report.clearance.min:.0f} mm, certified: {result.report.certified}")
