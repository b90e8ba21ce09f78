"""A path on its way to a controller: CSV, JSON, and the shape of a JointTrajectory."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from safe_ompl import Motion, Obstacle, Pose, Robot, SafeSetup, Scene, Sphere, load, read_motion, save

scene = Scene((Obstacle("ball", Sphere(0.15), Pose((0.5, 0.0, 0.4)), weight=1.0),))
setup = SafeSetup(Robot.from_example("ur5"), scene)
setup.setConfigurations([0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0])
result = setup.plan("SafeRRTConnect", time=10.0, simplify=True)
assert result, result.status

path = Motion.of(result)
with TemporaryDirectory() as folder:
    save(path, Path(folder) / "path.csv")
    save(path, Path(folder) / "path.yaml")  # a message: it says where, not when: times are still to come
    save(result, Path(folder) / "result.json")  # the path, its report, its robot and its scene
    print((Path(folder) / "path.csv").read_text().splitlines()[0])
    print((Path(folder) / "path.yaml").read_text().splitlines()[0])
    assert read_motion(Path(folder) / "path.csv").joint_names == path.joint_names
    again = load(Path(folder) / "result.json")
    assert np.array_equal(again.path, result.path)
    assert again.scene == scene
