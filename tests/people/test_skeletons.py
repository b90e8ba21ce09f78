"""Tables of skeletons: names in the trackers' order, units and axes, and what is assumed where nothing is seen."""

import numpy as np
import pytest

from safe_ompl import InputError, UnknownNameError
from safe_ompl.geometry import LIMBS, STANDING
from safe_ompl.geometry.person import Body
from safe_ompl.people import KEYPOINTS, TrackedBody, find_skeleton
from safe_ompl.people.skeletons import SKELETONS, skeleton_of

# As the vendors number them.
NUMBERED = {
    "coco17": {
        0: "nose",
        5: "left_shoulder",
        8: "right_elbow",
        9: "left_wrist",
        12: "right_hip",
        16: "right_ankle",
    },
    "body25": {
        1: "neck",
        2: "right_shoulder",
        7: "left_wrist",
        8: "mid_hip",
        10: "right_knee",
        22: "right_big_toe",
    },
    "mediapipe33": {
        11: "left_shoulder",
        16: "right_wrist",
        20: "right_index",
        27: "left_ankle",
        32: "right_foot_index",
    },
    "azure_kinect32": {
        0: "pelvis",
        9: "left_handtip",
        12: "right_shoulder",
        18: "left_hip",
        25: "right_foot",
        26: "head",
    },
    "smpl24": {1: "left_hip", 11: "right_foot", 12: "neck", 15: "head", 18: "left_elbow", 23: "right_hand"},
    "recording12": {0: "hip", 5: "left_upper_arm", 11: "right_hand"},
}
SIZES = {"coco17": 17, "body25": 25, "mediapipe33": 33, "azure_kinect32": 32, "smpl24": 24, "recording12": 12}
# A point 1 m forward, 2 m to the left and 3 m up, as each of them gives it.
FORWARD_LEFT_UP = {
    "coco17": (1, 2, 3),
    "body25": (1, 2, 3),
    "mediapipe33": (-2, -3, 1),
    "azure_kinect32": (-2000, -3000, 1000),
    "smpl24": (2, 3, 1),
    "recording12": (1, 2, 3),
}


@pytest.mark.parametrize("name", SKELETONS)
def test_tables_are_those_of_the_vendors(name):
    skeleton = find_skeleton(name)
    assert len(skeleton.points) == len(set(skeleton.points)) == SIZES[name]
    assert {k: skeleton.points[k] for k in NUMBERED[name]} == NUMBERED[name]
    assert all(source in skeleton.points for sources in skeleton.sources.values() for source in sources)
    assert set(skeleton.sources) <= set(KEYPOINTS)
    assert skeleton_of(skeleton.points) is skeleton
    found = skeleton.keypoints(np.tile(FORWARD_LEFT_UP[name], (SIZES[name], 1)))
    seen = np.isfinite(found).all(axis=1)
    np.testing.assert_allclose(found[seen], np.tile([1.0, 2.0, 3.0], (seen.sum(), 1)))
    unseen = {KEYPOINTS[k] for k in np.flatnonzero(~seen)} - {"pelvis"}
    assert unseen == set(skeleton.unseen)


@pytest.mark.parametrize("name", SKELETONS)
def test_left_is_left(name):
    skeleton = find_skeleton(name)
    for ours, theirs in skeleton.sources.items():
        side = ours.partition("_")[0]
        if side in ("left", "right"):
            assert all(source.startswith(side) for source in theirs)


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


def test_what_is_no_skeleton_is_refused():
    with pytest.raises(UnknownNameError, match="unknown skeleton 'coco18'; known: coco17"):
        find_skeleton("coco18")
    with pytest.raises(InputError, match="no skeleton has the 2 key points a, b"):
        skeleton_of(["a", "b"])
    points = np.zeros((17, 3))
    points[9, 1] = np.nan
    with pytest.raises(InputError, match="key point 'left_wrist' of coco17 must be finite, or NaN"):
        find_skeleton("coco17").keypoints(points)
    points[9] = np.inf
    with pytest.raises(InputError, match="left_wrist"):
        find_skeleton("coco17").keypoints(points)
    with pytest.raises(InputError, match=r"key points of coco17 must have shape \(17, 3\)"):
        find_skeleton("coco17").keypoints(np.zeros((25, 3)))
    with pytest.raises(UnknownNameError, match="unknown limb 'tail'"):
        TrackedBody(only=("tail",))
    with pytest.raises(InputError, match="height"):
        TrackedBody(17.5)
    with pytest.raises(InputError, match="nothing is known of the trunk"):
        TrackedBody().completed(np.full((18, 3), np.nan))
