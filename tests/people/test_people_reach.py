"""Reach models: who keeps to a model never leaves its sets, and who does not is seen."""

import numpy as np
import pytest

from safe_ompl import InputError, People, Tracker
from safe_ompl.geometry import LIMBS, STANDING
from safe_ompl.people import (
    AccelerationReach,
    IntersectedReach,
    LimbLengthReach,
    SpeedReach,
    TrackedBody,
    find_skeleton,
)
from safe_ompl.people.tracking import PersonTrack

SMPL = find_skeleton("smpl24")
OURS = find_skeleton("coco17")
PEOPLE = People(speed=1.0, speeds={"left_hand": 2.0, "left_forearm": 2.0})


def standing():
    """Return the key points of COCO of a body that stands."""
    names = {"left_ear": "head", "right_ear": "head", "nose": "head"}
    return np.array([1.75 * STANDING.get(names.get(n, n), STANDING["head"]) for n in OURS.points])


def track(reach=None, *, noise=0.0, only=(), people=PEOPLE):
    return PersonTrack("anna", Tracker(OURS, TrackedBody(only=only), noise=noise), people, reach)


SEEN = tuple(
    name for name in LIMBS if not name.endswith(("foot", "head", "neck"))
)  # their ends are, but hands


@pytest.mark.parametrize("seed", range(5))
def test_limbs_that_keep_to_their_speeds_stay_in_their_sets(seed):
    rng = np.random.default_rng(seed)
    anna, body = track(noise=0.01, only=SEEN), TrackedBody(only=SEEN)
    points, time = standing(), 0.0
    anna.observe(points, time)
    for _ in range(30):
        step, sets = rng.uniform(0.01, 0.2), anna.sets()
        away = rng.normal(size=points.shape)
        away *= step * rng.choice([1.0, 0.3]) / np.linalg.norm(away, axis=1, keepdims=True)
        points, time = points + away, time + step
        true = body.completed(OURS.keypoints(points))[0]
        assert sets.excess(body.ends(true), step).max() <= 1e-9
        seen = points + rng.uniform(-0.005, 0.005, points.shape)
        seen[rng.random(len(seen)) < 0.3] = np.nan  # some are not seen
        assert anna.observe(seen, time) is None


def track_assumed(anna):
    return ("left_hand", "left_toe", "right_hand", "right_toe")


@pytest.mark.parametrize("seed", range(5))
def test_limbs_that_keep_to_their_acceleration_stay_in_their_sets(seed):
    rng, a, step = np.random.default_rng(seed), 8.0, 0.005
    anna, body = track(AccelerationReach(a)), TrackedBody()
    points, velocity = standing(), rng.normal(size=3)
    sets, since = None, 0.0
    for k in range(200):  # the whole body moves as one
        if k % 10 == 0:
            anna.observe(points, k * step)
            sets, since = anna.sets(), 0.0
        push = rng.normal(size=3)
        push *= a / np.linalg.norm(push)
        points, velocity = points + step * velocity + 0.5 * step**2 * push, velocity + step * push
        since += step
        excess = sets.excess(body.ends(body.completed(OURS.keypoints(points))[0]), since)
        assert excess.max() <= 1e-9
    assert sets.growth[0, 0] == 0


def test_arms_stay_within_their_length_of_the_shoulder():
    rng, anna = np.random.default_rng(3), track(LimbLengthReach())
    body, points = TrackedBody(), standing()
    anna.observe(points, 0.0)
    sets = anna.sets()
    upper, fore = (np.linalg.norm(points[i] - points[j]) for i, j in ((5, 7), (7, 9)))
    for _ in range(100):
        turns = rng.normal(size=(2, 3))
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        moved = points.copy()
        moved[5] = points[5] + 0.1 * turns[0]  # 0.1 s at 1 m/s
        moved[7] = moved[5] + upper * turns[0]
        moved[9] = moved[7] + fore * turns[1]
        excess = sets.excess(body.ends(body.completed(OURS.keypoints(moved))[0]), 0.1)
        assert excess.max() <= 1e-9
    moved[9] = moved[5] + 2 * (upper + fore) * turns[0]
    excess = sets.excess(body.ends(body.completed(OURS.keypoints(moved))[0]), 0.1)
    assert excess[body.limbs.index("left_forearm")] > 0


def test_an_intersection_is_in_all_of_them():
    models = SpeedReach(), AccelerationReach(), LimbLengthReach()
    both = track(IntersectedReach(models))
    for k in range(3):
        both.observe(standing(), 0.05 * k)
    sets = both.sets()
    assert (np.diff(sets.owners) >= 0).all()
    assert len(sets) == 3 * len(sets.names)
    singles = [model.sets(both.measured(), PEOPLE) for model in models]
    ends = list(TrackedBody().ends(both.keypoints) + 0.2)
    worst = np.max([single.excess(ends, 0.1) for single in singles], axis=0)
    np.testing.assert_allclose(sets.excess(ends, 0.1), worst)
    with pytest.raises(InputError, match="one model"):
        IntersectedReach(())


def test_who_is_faster_than_promised_is_seen():
    anna = track()
    anna.observe(standing(), 0.0)
    moved = standing()
    moved[9] += [0.0, 0.19, 0.0]  # the left wrist, at 2 m/s in 0.1 s
    moved[7] += [0.0, 0.09, 0.0]
    assert anna.observe(moved, 0.1) is None
    moved[11] += [0.0, 0.12, 0.0]
    found = anna.observe(moved, 0.2)
    assert found is not None
    assert (found.who, found.limb) in {
        ("anna", limb) for limb in ("left_thigh", "hips", "left_flank", "torso")
    }
    assert found.excess == pytest.approx(0.02)
    assert "'anna' (" in str(found)
    assert "20 mm farther than promised" in str(found)
    noisy = track(noise=0.02)
    noisy.observe(standing(), 0.0)
    moved = standing()
    moved[11] += [0.0, 0.13, 0.0]
    assert noisy.observe(moved, 0.1) is None


def test_what_is_not_seen_keeps_its_place_and_grows():
    anna = track()
    anna.observe(standing(), 0.0)
    hidden = standing() + 0.01
    hidden[13:] = np.nan  # legs behind a table
    anna.observe(hidden, 0.3)
    body, sets = TrackedBody(), anna.sets()
    shank = sets.names.index(("anna", "left_shank"))
    assert sets.growth[shank, 0] == pytest.approx(0.3)
    np.testing.assert_allclose(sets.points[2 * shank], standing()[13])
    assert sets.growth[sets.names.index(("anna", "left_upper_arm")), 0] == 0
    assert anna.age == pytest.approx(0.3)
    anna.observe(None, 0.5)
    assert anna.sets().growth[shank, 0] == pytest.approx(0.5)
    assert anna.assumed == track_assumed(anna)
    assert len(body.limbs) == len(sets.names)


def test_a_track_refuses_what_cannot_be():
    anna = track()
    with pytest.raises(InputError, match="anna: was never seen"):
        anna.sets()
    anna.observe(standing(), 1.0)
    with pytest.raises(InputError, match=r"anna: time must not go backwards: 0\.9 s after 1 s"):
        anna.observe(standing(), 0.9)
    with pytest.raises(InputError, match="longer"):
        LimbLengthReach(0.5)
    with pytest.raises(InputError, match="acceleration"):
        AccelerationReach(0.0)
