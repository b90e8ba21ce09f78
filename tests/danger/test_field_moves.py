"""Danger fields whose obstacles move, against fields made anew."""

import numpy as np
import pytest

from safe_ompl import Box, CertifiedDanger, DangerField, InputError, Obstacle, Person, Pose, Scene
from safe_ompl.geometry import STANDING

SCENE = Scene(
    (
        Obstacle("table", Box((1.2, 0.8, 0.05)), Pose((0.4, 0.0, -0.2))),
        Obstacle("box", Box((0.1, 0.2, 0.3)), Pose((0.5, 0.3, 0.4)), weight=0.5),
        Obstacle("colleague", Person(), Pose((0.9, 0.2, -0.8))),
    )
)


def key_points(rng):
    """All key points of someone who stands somewhere, each of them shaken."""
    place = np.array([*rng.uniform(-1.5, 1.5, 2), -0.8])
    return {name: 1.75 * point + place + rng.normal(0.0, 0.03, 3) for name, point in STANDING.items()}


@pytest.mark.parametrize(("aggregate", "spacing"), [("max", None), ("softmax", 0.2)])
def test_after_any_moves_the_danger_is_that_of_a_field_made_anew(panda, rng, aggregate, spacing):
    scene = SCENE
    field = DangerField.of_scene(panda, scene, spacing, aggregate=aggregate)
    proof, changes = CertifiedDanger(field), 0
    for k in range(12):
        places = {
            "colleague": key_points(rng),
            "box": Pose(tuple(rng.uniform(-1, 1, 3))),
            "table": Pose((0, 0, -k / 9)),
        }
        names = rng.choice(list(places), rng.integers(1, 3), replace=False)
        scene = scene.moved({str(name): places[str(name)] for name in names})
        before = field.minimum
        field.move(scene)
        anew = DangerField.of_scene(panda, scene, spacing, aggregate=aggregate)
        Q = rng.uniform(panda.lower, panda.upper, (5, panda.n))
        np.testing.assert_array_equal(field.values(Q), anew.values(Q))
        np.testing.assert_array_equal(field.gradients(Q), anew.gradients(Q))
        assert field.minimum == anew.minimum
        changes += field.minimum != before
        assert proof.of_edge(*Q[:2]) == CertifiedDanger(anew).of_edge(*Q[:2])
    assert changes > 3


def test_the_revision_counts_moves_of_what_is_dangerous(panda):
    field = DangerField.of_scene(panda, SCENE)
    field.move(SCENE.moved({"table": Pose()}))
    assert field.revision == 0, "a table that is not dangerous moves no danger point"
    field.move(SCENE.moved({"box": Pose()}))
    assert field.revision == 1


def test_only_places_may_differ(panda):
    field = DangerField.of_scene(panda, SCENE)
    before = field.points
    heavier = Scene((*list(SCENE)[:2], Obstacle("colleague", Person(), weight=2.0)))
    for other in (SCENE.without("box"), heavier, Scene(SCENE.obstacles, spacing=0.3)):
        with pytest.raises(InputError, match=r"must have the same|not become another"):
            field.move(other)
    assert field.points is before


def test_a_field_of_points_cannot_move(panda):
    with pytest.raises(InputError, match=r"DangerField\.of_scene"):
        DangerField(panda, [[1.0, 0.0, 0.0]]).move(SCENE)
