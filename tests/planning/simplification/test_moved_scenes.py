"""What was made of paths before obstacles moved: it follows, stays what it was, or says that it is stale."""

import numpy as np
import pytest

from safe_ompl import CollisionChecker, DangerField, Scene
from safe_ompl.geometry import Obstacle, Pose, Sphere
from safe_ompl.planning.simplification import PathReport, Simplifier

SCENE = Scene((Obstacle("ball", Sphere(0.08), Pose((0.8, 0.6, 0.6)), weight=1.0),))
MOVED = SCENE.moved({"ball": Pose((0.7, -0.3, 0.4))})


@pytest.fixture
def models(panda):
    return CollisionChecker(panda, SCENE, movable=["ball"]), DangerField.of_scene(panda, SCENE)


@pytest.fixture
def path(panda):
    middle = (panda.lower + panda.upper) / 2
    return middle + np.outer([-1.0, 0.0, 1.0], [0.6, 0.2, 0.3, -0.2, 0.3, 0.2, 0.1])


def move(models):
    for model in models:
        model.move(MOVED)


def test_a_simplifier_follows(models, path):
    simplifier = Simplifier(*models)
    before = simplifier.danger.reference
    move(models)
    anew = Simplifier(CollisionChecker(models[0].robot, MOVED), DangerField.of_scene(models[0].robot, MOVED))
    assert simplifier.danger.reference == anew.danger.reference != before
    assert simplifier.cost.of(path) == anew.cost.of(path)
    np.testing.assert_allclose(simplifier.simplify(path, lambda: False), anew.simplify(path, lambda: False), atol=1e-6)


def test_a_report_is_of_the_scene_in_which_its_path_was_validated(models, path):
    checker, field = models
    report = PathReport.of(path, checker, field)
    expected = PathReport.of(path, CollisionChecker(checker.robot, SCENE), DangerField.of_scene(checker.robot, SCENE))
    move(models)
    assert report.clearance == expected.clearance
    assert report.danger.max == expected.danger.max
    now = PathReport.of(path, checker, field)
    assert now.clearance != expected.clearance
    assert now.danger.max != expected.danger.max
