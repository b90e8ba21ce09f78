"""People who walk about at random: no faster than promised, always the same, and where they should be."""

import numpy as np
import pytest

from safe_ompl import InputError, People, Tracker
from safe_ompl.geometry import STANDING
from safe_ompl.people import TrackedBody, find_skeleton
from safe_ompl.people.simulation import ALL_KEYPOINTS, Walker
from safe_ompl.people.tracking import PersonTrack

CENTRE = np.array([0.2, -0.1, -0.75])
SLOW_HAND = People(speed=1.6, speeds={"left_hand": 0.4})


def walker(people=SLOW_HAND, **options):
    return Walker(people, CENTRE, np.array([1.0, 0.0]), **options)


@pytest.mark.parametrize("people", [People(speed=1.6), SLOW_HAND, People(speed=0.3)])
def test_no_limb_is_faster_than_it_may_be(people):
    for seed in range(2):
        one = walker(people, seed=seed)
        track = PersonTrack("anna", one.tracker, people)
        for time in np.cumsum(np.random.default_rng(seed).uniform(0.005, 0.12, 200)):
            assert track.observe(one.at(time), time) is None


def test_who_is_faster_than_promised_is_seen():
    one = walker(People(speed=1.6), speed=4.0)
    track = PersonTrack("anna", one.tracker, People(speed=1.6))
    assert any(track.observe(one.at(time), time) for time in np.arange(0, 10, 0.05))


def test_a_walker_walks_and_reaches_out_within_the_sector():
    one = walker(People(speed=1.6))
    points = np.array([one.at(time) for time in np.arange(0, 60, 0.05)])
    index = list(STANDING).index
    hips = 0.5 * (points[:, index("left_hip")] + points[:, index("right_hip")])
    away = np.linalg.norm((hips - CENTRE)[:, :2], axis=1)
    assert away.min() > 0.5
    assert away.max() < 1.7
    assert np.ptp(away) > 0.4
    assert np.linalg.norm(np.diff(hips, axis=0), axis=1).max() > 0.5 * 1.6 * 0.05
    hand = points[:, index("right_hand")] - points[:, index("right_shoulder")]
    assert np.ptp(hand[:, 2]) > 0.4
    np.testing.assert_allclose(np.ptp(points[:, index("left_toe"), 2]), 0, atol=1e-9)


def test_limbs_keep_their_lengths():
    one = walker(People(speed=1.6), tracker=Tracker(ALL_KEYPOINTS, TrackedBody(1.6)))
    index = list(STANDING).index
    arm = [index(f"left_{name}") for name in ("shoulder", "elbow", "wrist", "hand")]
    standing = 1.6 * np.linalg.norm(np.diff(np.array(list(STANDING.values()))[arm], axis=0), axis=1)
    for k in range(100):  # at its steps; in between it goes straight on
        np.testing.assert_allclose(np.linalg.norm(np.diff(one.at(0.02 * k)[arm], axis=0), axis=1), standing, rtol=1e-6)


def test_a_seed_is_one_walk_and_the_past_may_be_asked_for():
    first, same, other = walker(seed=1), walker(seed=1), walker(seed=2)
    late = first.at(25.0)
    np.testing.assert_array_equal(late, same.at(25.0))
    np.testing.assert_array_equal(first.at(24.5), same.at(24.5))
    assert np.abs(late - other.at(25.0)).max() > 0.05
    assert late.shape == (len(ALL_KEYPOINTS.points), 3)


def test_only_a_sensor_that_sees_all_of_the_body_in_the_world_will_do():
    with pytest.raises(InputError, match="tracker: must have the skeleton ALL_KEYPOINTS"):
        walker(tracker=Tracker(find_skeleton("coco17")))
