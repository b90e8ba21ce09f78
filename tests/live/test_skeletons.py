"""Tables of skeletons: names in the trackers' order, units and axes, and what is assumed where nothing is seen."""

import numpy as np
import pytest

from safe_ompl import InputError, Obstacle, People, Pose, Scene, Sphere, Surroundings, Tracker
from safe_ompl.geometry import LIMBS, STANDING
from safe_ompl.geometry.person import Body
from safe_ompl.live import KEYPOINTS, TrackedBody, find_skeleton
from safe_ompl.live.skeletons import SKELETONS, skeleton_of
from safe_ompl.live.tracking import PersonTrack

# Number of points, some of them as the vendors number them, and a point 1 m forward, 2 m to the left and 3 m up.
TABLES = {
    "coco17": (17, "0 nose 5 left_shoulder 8 right_elbow 9 left_wrist 12 right_hip 16 right_ankle", (1, 2, 3)),
    "body25": (25, "1 neck 2 right_shoulder 7 left_wrist 8 mid_hip 10 right_knee 22 right_big_toe", (1, 2, 3)),
    "mediapipe33": (
        33,
        "11 left_shoulder 16 right_wrist 20 right_index 27 left_ankle 32 right_foot_index",
        (-2, -3, 1),
    ),
    "azure_kinect32": (32, "0 pelvis 9 left_handtip 12 right_shoulder 18 left_hip 26 head", (-2000, -3000, 1000)),
    "smpl24": (24, "1 left_hip 11 right_foot 12 neck 15 head 18 left_elbow 23 right_hand", (2, 3, 1)),
    "recording12": (12, "0 hip 5 left_upper_arm 11 right_hand", (1, 2, 3)),
}


@pytest.mark.parametrize("name", SKELETONS)
def test_tables_are_those_of_the_vendors(name):
    skeleton, (size, numbered, given) = find_skeleton(name), TABLES[name]
    words = numbered.split()
    assert len(skeleton.points) == len(set(skeleton.points)) == size
    assert [skeleton.points[int(k)] for k in words[::2]] == words[1::2]
    assert skeleton_of(skeleton.points) is skeleton
    found = skeleton.keypoints(np.tile(given, (size, 1)))
    seen = np.isfinite(found).all(axis=1)
    np.testing.assert_allclose(found[seen], np.tile([1.0, 2.0, 3.0], (seen.sum(), 1)))
    assert {KEYPOINTS[k] for k in np.flatnonzero(seen)} == set(skeleton.sources)
    for ours, theirs in skeleton.sources.items():  # left is left
        side = ours.partition("_")[0]
        assert side not in ("left", "right") or all(source.startswith(side) for source in theirs)


def test_what_is_not_seen_is_assumed_as_in_a_standing_body():
    body = TrackedBody(1.8)
    whole = {name: 1.8 * point for name, point in STANDING.items()}
    points = np.array([*whole.values(), [np.nan] * 3])
    for hidden in (["left_knee", "left_ankle", "left_toe"], ["left_hip", "right_hip"], ["head"]):
        seen = points.copy()
        seen[[KEYPOINTS.index(name) for name in hidden]] = np.nan
        found, rests = body.completed(seen)
        np.testing.assert_allclose(found[:17], points[:17], atol=0.02)
        for name in hidden:
            assert KEYPOINTS[rests[KEYPOINTS.index(name)]] not in hidden
    seen = points.copy()
    seen[KEYPOINTS.index("left_hand")] = np.nan
    ends = body.ends(body.completed(seen)[0])
    hand = body.limbs.index("left_hand")
    np.testing.assert_allclose(ends[hand], np.tile(points[KEYPOINTS.index("left_wrist")], (2, 1)))
    span = np.linalg.norm(points[KEYPOINTS.index("left_hand")] - points[KEYPOINTS.index("left_wrist")])
    assert body.radii(ends)[hand] == pytest.approx(1.8 * LIMBS["left_hand"][2] + span)
    turned = points @ np.array([[0, 1.0, 0], [-1, 0, 0], [0, 0, 1]])  # the person faces y
    seen = turned.copy()
    seen[[KEYPOINTS.index("left_knee"), KEYPOINTS.index("left_toe")]] = np.nan
    np.testing.assert_allclose(body.completed(seen)[0][:17], turned[:17], atol=1e-9)


def test_limbs_are_those_of_the_person_of_scenes():
    body, given = TrackedBody(1.7), {name: tuple(1.7 * point) for name, point in STANDING.items()}
    own = Body(1.7, given)
    points = np.array([*given.values(), (np.nan,) * 3])
    ends = body.ends(points)
    for name, (start, end), radius in zip(body.limbs, ends, body.radii(ends), strict=True):
        first, last, share = LIMBS[name]
        np.testing.assert_allclose(start, own.point(first), atol=1e-12)
        np.testing.assert_allclose(end, own.point(last), atol=1e-12)
        assert radius == pytest.approx(1.7 * share)
    assert TrackedBody(only=("left_hand",)).limbs == ("left_hand",)


BROKEN = np.zeros((17, 3))
BROKEN[9, 1] = np.nan


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: find_skeleton("coco18"), "unknown skeleton 'coco18'; did you mean 'coco17'"),
        (lambda: skeleton_of(["a", "b"]), "no skeleton has the 2 key points a, b"),
        (lambda: OURS.keypoints(BROKEN), "key point 'left_wrist' of coco17 must be finite, or NaN"),
        (lambda: OURS.keypoints(np.full((17, 3), np.inf)), "nose"),
        (lambda: OURS.keypoints(np.zeros((25, 3))), r"key points of coco17: must have shape \(17, 3\)"),
        (lambda: TrackedBody(only=("tail",)), "unknown limb 'tail'"),
        (lambda: TrackedBody(17.5), "height"),
        (lambda: TrackedBody().completed(np.full((18, 3), np.nan)), "the trunk is not known"),
    ],
)
def test_what_is_no_skeleton_is_refused(made, message):
    with pytest.raises(InputError, match=message):
        made()


# ----------------------------------------------------------------------------------------------------- tracks


OURS = find_skeleton("coco17")
PEOPLE = People(speed=1.0, speeds={"left_hand": 2.0, "left_forearm": 2.0})


def standing():
    """Return the key points of COCO of a body that stands."""
    names = {"left_ear": "head", "right_ear": "head", "nose": "head"}
    return np.array([1.75 * STANDING.get(names.get(n, n), STANDING["head"]) for n in OURS.points])


def track(noise=0.0, only=()):
    return PersonTrack("anna", Tracker(OURS, TrackedBody(only=only), noise=noise), PEOPLE)


SEEN = tuple(name for name in LIMBS if not name.endswith(("foot", "head", "neck")))  # their ends are, but hands


@pytest.mark.parametrize("seed", range(3))
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
    assert (found.who, found.limb) in {("anna", limb) for limb in ("left_thigh", "hips", "left_flank", "torso")}
    assert found.excess == pytest.approx(0.02)
    assert "'anna' (" in str(found)
    assert "20 mm farther than promised" in str(found)
    noisy = track(noise=0.02)
    noisy.observe(standing(), 0.0)
    moved = standing()
    moved[11] += [0.0, 0.13, 0.0]
    assert noisy.observe(moved, 0.1) is None


def test_a_track_refuses_what_cannot_be():
    anna = track()
    with pytest.raises(InputError, match="anna: was never seen"):
        anna.sets()
    anna.observe(standing(), 1.0)
    with pytest.raises(InputError, match=r"anna: time must not go backwards: 0\.9 s after 1 s"):
        anna.observe(standing(), 0.9)


def test_who_is_not_seen_for_longer_than_allowed_is_lost():
    around = Surroundings(Scene(), {"anna": Tracker(OURS)})
    assert around.trouble(0.0, 0.5) == "'anna' was not seen yet"
    around.update({"anna": standing()}, {}, 1.0)
    assert around.trouble(1.49, 0.5) is None
    assert around.trouble(1.51, 0.5) == "'anna' was not seen for 0.51 s"


def test_an_object_may_have_moved_since_it_was_seen_last():
    around = Surroundings(Scene([Obstacle("ball", Sphere(0.1))]), objects={"ball": 1.6})
    for time, x, violated in ((0.0, 0.0, False), (0.4, None, False), (0.5, 0.8, False), (0.6, 1.0, True)):
        seen = {} if x is None else {"ball": Pose((x, 0.0, 0.0))}
        assert bool(around.update({}, seen, time)) == violated
        assert around.sets.growth[0].tolist() == pytest.approx([0.64 if x is None else 0.0, 1.6])
