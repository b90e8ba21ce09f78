"""Calibrated reach: its quantile, gate, growth and files."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from safe_ompl import InputError, People, Scenario
from safe_ompl.apps.cli.program import main
from safe_ompl.people import (
    GATE,
    CalibratedReach,
    Recording,
    TrackedBody,
    Tracker,
    calibrate,
    find_skeleton,
    without_glitches,
)
from safe_ompl.people.calibration import Windows, conformal_quantile, measured_limbs
from safe_ompl.people.tracking import Gate, PersonTrack

SKELETON = find_skeleton("recording12")
STANDING = np.array(
    [[0, 0, 0.2], [0, 0, 0.4], [0, 0, 0.6], [0, 0, 0.8]]
    + [[0, side * away, 0.6] for side in (1, -1) for away in (0.05, 0.2, 0.5, 0.75)]
)
LENGTHS = {"torso": (0.1, 0.12, 0.5), "right_hand": (0.4, 0.45, 1.0)}
STATES = {limb: (tuple(0.5 * length for length in lengths), lengths) for limb, lengths in LENGTHS.items()}
REACH = CalibratedReach("recording12", 3.0, 0.9, 20, (0.1, 0.2, 0.5), (0.2,), STATES, ("a",), ("b",), 5.0, 0.01)


def recording(rng, frames=12, name="walk", scale=None):
    """Return a person whose key points walk at random, as fast as a draw says."""
    scale = rng.lognormal(-4.5, 0.5) if scale is None else scale
    return Recording(SKELETON, 20.0, STANDING + np.cumsum(rng.normal(scale=scale, size=(frames, 12, 3)), axis=0), name)


# ------------------------------------------------------------------------------------------------- the quantile


@pytest.mark.parametrize("level", [0.5, 0.8, 0.9, 0.95])
def test_the_quantile_is_the_smallest_score_that_enough_units_keep_to(level):
    rng = np.random.default_rng(0)
    for count in range(1, 60):
        scores, needed = rng.normal(size=count), (count + 1) * Fraction(str(level))
        enough = [s for s in scores if int((scores <= s).sum()) >= needed]
        if enough:
            assert conformal_quantile(scores, level) == min(enough)
        else:
            with pytest.raises(InputError, match=rf"{level:g} needs more than the {count} units"):
                conformal_quantile(scores, level)


def test_new_recordings_keep_to_the_reach_as_often_as_the_level_says():
    """Recordings differ by much from each other: windows of several are far from exchangeable."""
    rng, level, kept, count = np.random.default_rng(1), 0.8, 0, 0
    for _ in range(6):
        reach = calibrate([recording(rng, 8, f"walk {k:02d}") for k in range(15)], level)
        assert (reach.units, len(reach.shaped_with)) == (12, 3)
        for _ in range(10):
            windows = Windows.of(recording(rng, 8), 0.5, GATE)
            kept += windows.ratios([reach.lines[limb] for limb in windows.limbs], reach.speeds).max() <= 1
            count += 1
    assert level - 4 * np.sqrt(level * (1 - level) / count) <= kept / count < 1


def test_blocks_are_units_and_the_split_follows_from_the_names():
    rng = np.random.default_rng(2)
    walks = [recording(rng, 45, f"walk {k}") for k in range(4)]
    reach = calibrate(walks, 0.5, block=0.5)
    assert (reach.units, reach.block) == (3 * 4, 0.5)  # 45 frames are four blocks of ten and a rest
    assert sorted([*reach.shaped_with, *reach.calibrated_with]) == [walk.source for walk in walks]
    assert calibrate(walks[::-1], 0.5, block=0.5) == reach


WALK = Recording(SKELETON, 20.0, np.tile(STANDING, (3, 1, 1)), "walk")


@pytest.mark.parametrize(
    ("recordings", "options", "message"),
    [
        ([WALK], {}, "two recordings at least, got 1"),
        ([WALK, replace(WALK, rate=10.0)], {}, "walk: must have 20 frames per second at least, got 10"),
        (
            [WALK, Recording(find_skeleton("coco17"), 20.0, np.zeros((3, 17, 3)), "xx")],
            {},
            "xx: the skeleton is 'coco17', that of walk is 'recording12'",
        ),
        ([WALK] * 2, {"level": 1.0}, "level must be between"),
        ([WALK] * 2, {"gate": -1.0}, "gate: must be a positive number"),
        ([WALK] * 2, {"block": 0.0}, "block: must be a positive number"),
    ],
)
def test_what_cannot_be_calibrated_is_refused(recordings, options, message):
    with pytest.raises(InputError, match=message):
        calibrate(recordings, **{"level": 0.5, **options})


# ----------------------------------------------------------------------------------------------------- the gate


def test_the_gate_does_not_see_what_is_too_fast_until_it_may_be_there():
    gate = Gate(Tracker(SKELETON, gate=2.0))
    far = STANDING.copy()
    far[3] += [0.5, 0, 0]  # the head, which may come so far in 0.25 s
    assert np.isfinite(gate.passed(STANDING, 0.0)).all()
    for k in range(1, 5):
        passed = gate.passed(far, 0.05 * k)
        assert np.isnan(passed[3]).all()
        assert np.isfinite(np.delete(passed, 3, axis=0)).all()
    assert np.isfinite(gate.passed(far, 0.2501)).all()
    assert (gate.seen, gate.refused) == (6 * 12, 4)
    millimetres = find_skeleton("azure_kinect32")
    counted = Gate(Tracker(millimetres, gate=2.0))
    counted.passed(np.zeros((32, 3)), 0.0)
    assert np.isfinite(counted.passed(np.full((32, 3), 50.0), 0.05)).all()  # 87 mm


def test_a_tracker_with_a_gate_grows_older_where_it_refuses():
    person = PersonTrack("anna", Tracker(SKELETON, gate=2.0), People(speed=1.0))
    person.observe(STANDING, 0.0)
    jumped = STANDING.copy()
    jumped[11] += [0.0, 0.0, 0.4]  # the right wrist
    assert person.observe(jumped, 0.1) is None
    hand = person.sets().names.index(("anna", "right_hand"))
    assert person.sets().grown(0.0)[hand] == pytest.approx(0.1)
    assert person.gate.refused == 1
    open_to_all = PersonTrack("anna", Tracker(SKELETON), People(speed=1.0))
    open_to_all.observe(STANDING, 0.0)
    assert open_to_all.observe(jumped, 0.1) is not None
    with pytest.raises(InputError, match="must be finite"):
        PersonTrack("anna", Tracker(SKELETON, gate=2.0), People()).observe(np.full((12, 3), np.inf), 0.0)


def test_without_glitches_people_move_straight_between_what_passed():
    rng = np.random.default_rng(5)
    clean = recording(rng, 30, scale=0.004)
    frames = clean.frames.copy()
    frames[10:12, 7] += 2.0
    found, gate = without_glitches(replace(clean, frames=frames), Tracker(SKELETON, gate=3.0))
    assert gate.refused == 2
    straight = clean.frames[9, 7] + np.array([[1], [2]]) / 3 * (clean.frames[12, 7] - clean.frames[9, 7])
    np.testing.assert_allclose(found.frames[10:12, 7], straight)
    keep = np.ones((30, 12), dtype=bool)
    keep[10:12, 7] = False
    np.testing.assert_array_equal(found.frames[keep], clean.frames[keep])
    # What is true never leaves a reach that is as fast as the gate.
    windows = Windows.of(replace(clean, frames=frames), 0.5, 3.0)
    assert windows.ratios([np.array([[[0.0, 3.0]]])] * len(windows.limbs)).max() <= 1 + 1e-9
    raw = Windows.of(replace(clean, frames=frames), 0.5, 3.0, glitches=True)
    assert raw.ratios([np.array([[[0.0, 3.0]]])] * len(windows.limbs)).max() > 2


# ------------------------------------------------------------------------------------------------------- growth


def test_growth_is_concave_and_no_smaller_than_the_lengths_nor_larger_than_the_gate():
    times = np.linspace(0.0, 2.0, 401)
    for limb, lengths in LENGTHS.items():
        growth = np.array([REACH.grown(limb, t) for t in times])
        assert growth[0] == 0
        assert (np.diff(growth) > 0).all()
        assert (np.diff(growth, 2) <= 1e-12).all()
        for h, length in zip(REACH.horizons, lengths, strict=True):
            assert REACH.grown(limb, h) >= min(length, 3.0 * h) - 1e-12
        assert (growth <= 3.0 * times + 1e-12).all()
        beyond = np.diff(growth[times >= 0.5]) / np.diff(times[times >= 0.5])
        np.testing.assert_allclose(beyond, lengths[-1] / 0.5)
    assert REACH.grown("torso", 0.1) == pytest.approx(0.1)  # lengths that are concave already: nothing is added
    assert REACH.grown("torso", 0.2) == pytest.approx(0.2)
    assert REACH.grown("right_hand", 0.1) == pytest.approx(0.3)


@pytest.mark.parametrize("age", [0.0, 0.07])
def test_sets_hold_all_places_within_the_growth_and_no_others(age):
    rng, body = np.random.default_rng(6), TrackedBody(only=("torso", "left_upper_arm", "right_hand"))
    person = PersonTrack("anna", Tracker(SKELETON, body, gate=3.0), People(speed=1.2), REACH)
    person.observe(STANDING, 0.0)
    person.observe(None, age)
    sets, (ends, _) = person.sets(), person.measured()
    for since in age + rng.uniform(0.0, 1.0, 50):
        allowed = [REACH.grown(k, since) if k in LENGTHS else 1.2 * since for k in body.limbs]
        ways = rng.normal(size=(3, 2, 3))
        ways *= np.array(allowed)[:, None, None] / np.linalg.norm(ways, axis=2, keepdims=True)
        assert sets.excess(ends + ways, since - age).max() <= 1e-9
        assert (sets.excess(ends + 1.001 * ways, since - age) > 0).all()


def walked(person, speeds, step=0.05):
    """Let a tracked person go along x, at a speed [m/s] for each step [s]; return what was violated."""
    ways = np.cumsum([0.0, *(step * np.array(speeds))])[:, None, None] * [1.0, 0.0, 0.0]
    return [person.observe(STANDING + way, step * k) for k, way in enumerate(ways)]


def test_growth_depends_on_the_speed_of_the_last_tenth_of_a_second():
    person = PersonTrack("anna", Tracker(SKELETON, TrackedBody(only=("torso",)), gate=3.0), People(), REACH)
    person.observe(STANDING, 0.0)
    assert person.sets().grown(0.1)[0] == pytest.approx(REACH.grown("torso", 0.1))  # unknown: as fast as can be
    walked(person := PersonTrack("anna", person.tracker, People(), REACH), [0.1, 0.1, 0.1])
    assert person.speed == pytest.approx(0.1)
    assert person.sets().grown(0.1)[0] == pytest.approx(REACH.grown("torso", 0.1, 0.1)) == pytest.approx(0.05)
    walked(person := PersonTrack("anna", person.tracker, People(), REACH), [0.1, 0.1, 0.4])
    assert person.speed == pytest.approx(0.25)
    assert person.sets().grown(0.1)[0] == pytest.approx(0.1)


def test_who_leaves_the_reach_too_often_is_held_to_bounds_of_speeds(caplog):
    people = People(speed=2.0)
    person = PersonTrack("anna", Tracker(SKELETON, TrackedBody(only=("torso",)), gate=3.0), people, REACH)
    found = walked(person, [0.0, 0.0, 0.0, 2.9] * 60)  # from rest, farther than such people went
    assert sum(violation is not None for violation in found) > 2 * 0.1 * 200
    assert person.doubted
    assert person.sets().grown(0.1)[0] == pytest.approx(0.2)
    assert "anna' left the calibrated reach in 40 of" in caplog.text
    steady = PersonTrack("anna", person.tracker, people, REACH)
    walked(steady, [0.5] * 240)
    assert not steady.doubted


def test_still_people_are_calibrated_apart_from_fast_ones():
    rng, walks = np.random.default_rng(3), []
    for k in range(12):  # each stands, then walks
        steps = np.repeat([0.0005, 0.03], [200, 40])[:, None, None] * rng.normal(size=(240, 12, 3))
        walks.append(Recording(SKELETON, 20.0, STANDING + np.cumsum(steps, axis=0), f"walk {k:02d}"))
    reach = calibrate(walks, 0.9, block=0.05)
    slow, fast = (reach.grown("torso", 0.1, speed) for speed in (0.0, 10.0))
    assert slow < 0.5 * fast
    windows = Windows.of(recording(rng, 60, scale=0.0005), 0.5, GATE)
    kept = windows.ratios([reach.lines[limb] for limb in windows.limbs], reach.speeds).max(axis=1) <= 1
    assert kept[3:].mean() > 0.9


def test_limbs_are_calibrated_whose_place_is_seen():
    assert set(measured_limbs(SKELETON)) == {"head", "neck", "shoulders", "torso"} | {
        f"{side}_{part}" for side in ("left", "right") for part in ("upper_arm", "forearm", "hand")
    }
    assert set(measured_limbs(find_skeleton("azure_kinect32"))) == set(TrackedBody().limbs)


@pytest.mark.parametrize(("skeleton", "gate"), [("recording12", None), ("recording12", 2.0), ("coco17", 3.0)])
def test_the_tracker_must_have_the_gate_and_the_skeleton(skeleton, gate):
    tracker = Tracker(find_skeleton(skeleton), gate=gate)
    with pytest.raises(InputError, match="anna: the reach was calibrated with the skeleton 'recording12'"):
        PersonTrack("anna", tracker, People(), REACH)


# -------------------------------------------------------------------------------------------------------- files


def test_a_reach_comes_back_from_its_file(tmp_path):
    REACH.save(tmp_path / "reach.yaml")
    found = CalibratedReach.load(tmp_path / "reach.yaml")
    assert found == REACH
    assert found.lines.keys() == LENGTHS.keys()
    assert "90 % of the blocks of 5 s (20 calibrated)" in str(found)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("gate: 3.0", "gate: 0", r"reach.yaml:2: gate: must be a positive number"),
        ("level: 0.9", "level: 1", r"reach.yaml:3: level: must be between 0 and 1, got 1"),
        ("units: 20", "unit: 20", r"reach.yaml:4: unit: unknown key; did you mean 'units'"),
        ("[0.1, 0.2, 0.5]", "[0.1, 0.5, 0.5]", r"reach.yaml:5: horizons: must not fall or stay, got 0.5 after 0.5"),
        ("[0.1, 0.12, 0.5]", "[0.1, 0.09, 0.5]", r"growth.torso\[1\]: must not fall, got 0.09 after 0.1"),
        ("[0.1, 0.12, 0.5]", "[0.1, 0.12]", r"reach.yaml:10: growth.torso\[1\]: must be 3 numbers, got 2"),
        ("torso:", "tail:", r"reach.yaml:8: growth.tail: unknown key"),
        ("recording12", "recording13", r"reach.yaml:1: skeleton: unknown skeleton 'recording13'"),
    ],
)
def test_files_that_are_none_are_refused_by_file_key_and_value(tmp_path, old, new, message):
    file = tmp_path / "reach.yaml"
    REACH.save(file)
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message):
        CalibratedReach.load(file)


def test_a_scenario_names_its_reach_relative_to_itself(tmp_path):
    scenario = Scenario.load("scenarios/panda_shelf.yaml")
    REACH.save(tmp_path / "reach.yaml")
    people = replace(scenario.people or People(), reach=tmp_path / "reach.yaml")
    replace(scenario, people=people).save(tmp_path / "scenario.yaml")
    assert "reach: reach.yaml" in (tmp_path / "scenario.yaml").read_text()
    found = Scenario.load(tmp_path / "scenario.yaml")
    assert found.people.reach == (tmp_path / "reach.yaml").resolve()
    (tmp_path / "reach.yaml").unlink()
    with pytest.raises(InputError, match=r"scenario.yaml:\d+: people.reach: .*reach.yaml' does not exist"):
        Scenario.load(tmp_path / "scenario.yaml")


def test_the_command_writes_a_file_and_refuses_a_level_in_one_line(tmp_path, capsys):
    rng = np.random.default_rng(7)
    clips = {f"clip_{k}": recording(rng).frames for k in range(10)}
    np.savez(tmp_path / "walks.npz", names=np.array(SKELETON.points), rate=20.0, **clips)
    words = ["people", "calibrate", str(tmp_path / "walks.npz"), "-o", str(tmp_path / "reach.yaml"), "--level"]
    assert main([*words, "0.9"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "90 % of the recordings (9 calibrated); a gate of 4 m/s refused 0 %" in shown
    reach = CalibratedReach.load(tmp_path / "reach.yaml")
    assert (reach.skeleton, reach.gate, reach.level, reach.units) == ("recording12", 4.0, 0.9, 9)
    assert all(name.startswith("walks.npz:clip_") for name in reach.calibrated_with)
    (tmp_path / "reach.yaml").unlink()
    assert main([*words, "0.91"]) == 2
    assert capsys.readouterr().err == (
        "safe-ompl: level: 0.91 needs more than the 9 units that there are: they allow 0.9 at most\n"
    )
    assert not (tmp_path / "reach.yaml").exists()
