"""A path on its way to a controller: CSV, JSON, and the shape of a JointTrajectory."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from safe_ompl import JointPath, Obstacle, Pose, Robot, SafeSetup, Scene, Sphere, load, save

scene = Scene((Obstacle("ball", Sphere(0.15), Pose((0.5, 0.0, 0.4)), weight=1.0),))
setup = SafeSetup(Robot.from_example("ur5"), scene)
setup.setConfigurations([0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0])
result = setup.plan("SafeRRTConnect", time=10.0, simplify=True)
assert result, result.status

path = JointPath.of(result)
with TemporaryDirectory() as folder:
    path.to_csv(Path(folder) / "path.csv")
    save(result, Path(folder) / "result.json")  # the path, its report, its robot and its scene
    print((Path(folder) / "path.csv").read_text().splitlines()[0])
    assert JointPath.from_csv(Path(folder) / "path.csv") == path
    again = load(Path(folder) / "result.json")
    assert np.array_equal(again.path, result.path)
    assert again.scene == scene

message = path.to_joint_trajectory()  # a path says where, not when: times are still to come
print(f"{len(message['points'])} points for {', '.join(message['joint_names'])}")
