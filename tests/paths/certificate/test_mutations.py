"""Random mutations of every field of certificates: each is refused, or what is still claimed is true.

"True" is asked of plain code: coal's distances at many places of each edge, the danger field there, and the scene with
its moving obstacle where it may go. What is refused is so by one clear line, whatever the mutation.
"""

import copy
import json
import random
from itertools import pairwise

import numpy as np
import pytest

from safe_ompl.danger.field import DangerField
from safe_ompl.errors import CertificateError, InputError
from safe_ompl.paths.certificate.issue import certificate
from safe_ompl.paths.certificate.schema import digest
from safe_ompl.paths.certificate.verifier.verify import verify
from safe_ompl.scene.obstacle import Obstacle

PATH = np.array([[0.0, -1.5, 0.5, 0, 0, 0], [0.5, -1.4, 0.5, 0, 0, 0], [0.8, -1.5, 0.6, 0.2, 0, 0]])
REFUSALS = (CertificateError, InputError)
MUTATIONS = 250  # per seed, half of them with the digest that belongs to them
SEEDS = (0, 1)


@pytest.fixture(scope="module")
def scene(clutter):
    ball = clutter["ball"]
    return clutter.without("ball").with_obstacles(Obstacle("ball", ball.shape, ball.pose, weight=1.0))


@pytest.fixture(scope="module")
def written(ur5, scene):
    """Return a certificate that claims all that can be claimed."""
    points, weights, _ = scene.danger_points(0.1)
    content = certificate(
        PATH,
        ur5,
        scene,
        field=DangerField(ur5, points, weights),
        spacing=0.1,
        clearance={"distance": 0.02, "obstacles": ["ball", "table"], "exempt": [["upper_arm_link", "table"]]},
        moving_obstacles={"speeds": {"ball": 0.1, "post": 0.02}, "time": 0.5},
        also_sampled="your checker, sampled at 0.05 rad",
        source={"scenario": "clutter.yaml", "robot": None},
    )
    return json.loads(json.dumps(content))


def places(value, at=()):
    """Yield the way to every value of a document; of long lists only to the first three and the last."""
    yield at
    if isinstance(value, dict):
        for key in value:
            yield from places(value[key], (*at, key))
    elif isinstance(value, list):
        for k in sorted({*range(min(3, len(value))), len(value) - 1} - {-1}):
            yield from places(value[k], (*at, k))


def mutated(rng, value):
    """Return something else instead of a value: of the same kind a little or much different, or of another kind."""
    others = [None, True, "", "0.1", -1, 0, 1, 2.5, 1e-9, -1e-9, 1e308, float("nan"), float("inf"), 10**400]
    choices = [lambda: rng.choice(others), lambda: rng.choice([[], {}, [[]], [None], {"": 0}])]
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        choices += [
            lambda: value + rng.choice([-1, 1]) * 10 ** rng.uniform(-12, 2),
            lambda: value * rng.choice([-1, 0.5, 0.99, 1.01, 2]),
        ]
    elif isinstance(value, str):
        choices += [
            lambda: value[:-1],
            lambda: value + "x",
            value.upper,
            lambda: rng.choice(["ball", "post", "x"]),
        ]
    elif isinstance(value, list) and value:
        k = rng.randrange(len(value))
        choices += [
            lambda: value[:k] + value[k + 1 :],
            lambda: [*value, value[k]],
            lambda: rng.sample(value, len(value)),
        ]
    elif isinstance(value, dict) and value:
        key = rng.choice(sorted(value))
        choices += [
            lambda: {k: v for k, v in value.items() if k != key},
            lambda: {**value, "new": value[key]},
            lambda: {**value, key: value[rng.choice(sorted(value))]},
        ]
    return rng.choice(choices)()


def replaced(content, at, change):
    """Return a copy of a document with `change` of what is at a place there."""
    if not at:
        return change(content)
    changed = copy.copy(content)
    changed[at[0]] = replaced(content[at[0]], at[1:], change)
    return changed


def verified(*arguments):
    """Return what `verify` does, or None where it refuses, in one line."""
    try:
        return verify(*arguments)
    except REFUSALS as error:
        message = str(error)
    assert message
    assert "\n" not in message
    return None


def assert_true(content, robot, scene, plain):
    """Assert what a certificate claims at many places of its path."""
    path = np.array(content["path"], dtype=float)
    dense = np.concatenate([a + np.linspace(0, 1, 15)[:, None] * (b - a) for a, b in pairwise(path)] + [path])
    clear = content["clearance"] or {"distance": 0, "obstacles": [], "exempt": []}
    moving = content["moving_obstacles"] or {"speeds": {}, "time": 0}
    least = np.array(
        [
            clear["distance"] * (o in clear["obstacles"] and [link, o] not in clear["exempt"])
            + moving["speeds"].get(o, 0) * moving["time"]
            for link, o in plain.pairs
        ]
    )
    assert all((plain.distances(q) > least - 1e-9).all() for q in dense)
    if content["danger"] is not None:
        kind = dict(content["danger"])
        bound, spacing = kind.pop("bound"), kind.pop("spacing")
        points, weights, _ = scene.danger_points(spacing)
        assert DangerField(robot, points, weights, **kind).values(dense).max() <= bound * (1 + 1e-5)


@pytest.mark.parametrize("seed", SEEDS)
def test_random_mutations_are_refused_or_claim_nothing_false(written, ur5, scene, plain_check, seed):
    rng, plain, ways = random.Random(seed), plain_check(ur5, scene), list(places(written))
    original, accepted = verify(written, ur5, scene), 0
    for _ in range(MUTATIONS):
        at = rng.choice(ways)
        content = replaced(written, at, lambda value: mutated(rng, value))
        unchanged = json.dumps(content, sort_keys=True) == json.dumps(written, sort_keys=True)
        if isinstance(content, dict) and rng.random() < 0.5:
            content = {**content, "digest": digest(content)}
        elif not unchanged:
            with pytest.raises(REFUSALS):
                verify(content, ur5, scene)
            continue
        found = verified(content, ur5, scene)
        if found is None:
            continue
        accepted += 1
        if found.claims != original.claims or content["path"] != written["path"]:
            assert_true(content, ur5, scene, plain)
        said = set(found.claims) ^ set(original.claims)
        assert said or found.not_claimed == original.not_claimed, "what is withdrawn is said"
    assert 0 < accepted < MUTATIONS / 2


@pytest.mark.parametrize("key", ["robot", "scene"])
def test_mutations_of_what_is_carried(written, ur5, scene, key):
    """Without a robot and a scene that are given, those that are carried are the ones of the hashes."""
    rng, ways = random.Random(0), [at for at in places(written) if at[:1] == (key,) and len(at) > 1]
    original = verify(written, ur5, scene)
    for _ in range(30):
        at = rng.choice(ways)
        content = replaced(written, at, lambda value: mutated(rng, value))
        found = verified({**content, "digest": digest(content)})
        assert found in (None, original)
