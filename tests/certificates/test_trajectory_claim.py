"""Certificates of timed motions: limits, freedom of the curve, stops; and that no mutation claims what is false."""

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from signing import claimed, replaced, tampered, travelled

from safe_ompl import CertificateError, DangerField, InputError, KinetostaticField, Obstacle, People, Robot
from safe_ompl.certificates import certificate, verify
from safe_ompl.certificates.claims import ClaimedTrajectory, at_most
from safe_ompl.certificates.verifier.bodies import Budget, PlainSpeeds
from safe_ompl.certificates.verifier.motion import RecordedLaw, RecordedMotion, RecordedPiece, derivatives
from safe_ompl.certificates.verifier.verify import AskedTerms
from safe_ompl.collision import CollisionChecker, MotionProver
from safe_ompl.motions import RateLimits, time_path

PATH = np.array([[0.0, -1.5, 0.5, 0, 0, 0], [0.5, -1.4, 0.5, 0, 0, 0], [0.8, -1.5, 0.6, 0.2, 0, 0]])
PEOPLE = People(who=("ball",), speed=1.2, reaction_time=0.05, clearance=0.01)


@pytest.fixture(scope="module")
def scene(clutter):
    return clutter


@pytest.fixture(scope="module", autouse=True)
def coarse():
    """Have trajectories of fewer cells: what is tested takes less time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("safe_ompl.motions.timing.CELLS", 40)
        yield


@pytest.fixture(scope="module")
def made(ur5, scene):
    """Return a trajectory beside a ball that may move."""
    motion = MotionProver(CollisionChecker(ur5, scene))
    return time_path(PATH, ur5, RateLimits.of(ur5, 2.0, 4.0), motion=motion, people=PEOPLE)


@pytest.fixture(scope="module")
def written(ur5, scene, made):
    return travelled(certificate(PATH, ur5, scene, trajectory=made))


def again(written, change):
    """Return the certificate with a change of its trajectory, and the digest that belongs to it."""
    return tampered(written, lambda content: change(claimed(content)["trajectory"]))


def test_a_timed_motion_is_claimed_and_verified(written, ur5, scene, made):
    found = verify(written, ur5, scene)
    assert found.claims[-2].startswith(f"driven in {made.duration:.3f} s")
    assert "anyone of ball who moves no faster than 1.2 m/s comes nearer than 10 mm" in found.claims[-1]
    assert "stops" not in found.not_claimed


def test_what_is_not_claimed_is_said(ur5, scene):
    motion = MotionProver(CollisionChecker(ur5, scene))
    plain = time_path(PATH, ur5, RateLimits.of(ur5, 0.5, 4.0), motion=motion)  # slower than 1 rad of the way a second
    assert "stops" in verify(certificate(PATH, ur5, scene, trajectory=plain), ur5, scene).not_claimed
    assert "stops" not in verify(certificate(PATH, ur5, scene), ur5, scene).not_claimed


def test_contact_is_no_claim(ur5, scene, made):
    made = replace(made, people=replace(PEOPLE, contact=True))
    with pytest.raises(InputError, match=r"people\.contact: a certificate states that the robot stops"):
        certificate(PATH, ur5, scene, trajectory=made)


@pytest.fixture(scope="module", params=["max", "softmax"])
def endangering(request, ur5, scene):
    """Return a certificate that claims the danger in motion, and the field."""
    ball = scene["ball"]
    weighed = scene.without("ball").with_obstacles(Obstacle("ball", ball.shape, ball.pose, weight=1.0))
    field = DangerField.of_scene(ur5, weighed, aggregate=request.param)
    made = time_path(PATH, ur5, RateLimits.of(ur5, 2.0, 4.0))
    content = certificate(PATH, ur5, weighed, trajectory=made, field=field)
    return travelled(content), field, weighed, made


def asked(field, scene):
    kind = ("aggregate", "weighting", "k1", "sharpness", "k2", "gamma")
    return AskedTerms(danger={"spacing": scene.spacing, **{name: getattr(field, name) for name in kind}})


def test_danger_in_motion_is_claimed_and_verified(endangering, ur5):
    content, field, scene, made = endangering
    found = verify(content, ur5, scene, terms=asked(field, scene))
    claim = claimed(content)["trajectory"]["danger"]
    assert found.claims[-1].startswith(f"danger in motion at most {at_most(claim['bound'])}")
    assert "danger in motion" not in found.not_claimed
    state = made.at(np.linspace(0, made.duration, 500))
    peak = KinetostaticField(field).values(state.q, state.qd).max()
    assert peak < claim["bound"] < 1.06 * peak
    assert field.values(state.q).max() < 0.9 * peak  # it is the motion that makes it so large


@pytest.mark.parametrize(("key", "factor"), [("bound", 0.9), ("k2", 1.2), ("gamma", 1.3), ("k1", 1.2)])
def test_a_smaller_danger_in_motion_is_refused(endangering, ur5, key, factor):
    content, _, scene, _ = endangering
    with pytest.raises(CertificateError, match="danger in motion is not below"):
        verify(again(content, lambda t: t["danger"].update({key: factor * t["danger"][key]})), ur5, scene)


def test_danger_in_motion_of_another_kind_is_refused(endangering, ur5):
    content, field, scene, _ = endangering
    weaker = again(content, lambda t: t["danger"].update(k2=0.1))
    verify(weaker, ur5, scene)
    with pytest.raises(CertificateError, match=r"danger in motion: k2 is 0\.1"):
        verify(weaker, ur5, scene, terms=asked(field, scene))
    for change in ({"gamma": -1}, {"more": 1}, {"k2": None}):
        with pytest.raises(InputError, match="danger"):
            verify(again(content, lambda t, change=change: t["danger"].update(change)), ur5, scene)


def test_the_limit_of_the_danger_is_what_is_claimed(endangering, ur5):
    content, field, scene, made = endangering
    if field.aggregate != "max":
        return
    limit = 0.9 * claimed(content)["trajectory"]["danger"]["bound"]
    slow = time_path(PATH, ur5, RateLimits.of(ur5, 2.0, 4.0), danger=KinetostaticField(field), max_danger=limit)
    assert slow.duration > made.duration
    capped = certificate(PATH, ur5, scene, trajectory=slow)
    assert claimed(capped)["trajectory"]["danger"]["bound"] == limit
    verify(capped, ur5, scene)


def test_corners_in_which_it_stops(ur5, scene):
    trajectory = time_path(PATH, ur5, RateLimits.of(ur5, 2.0, 4.0), people=None)
    content = certificate(PATH, ur5, scene, trajectory=trajectory)
    verify(content, ur5, scene)
    with pytest.raises(CertificateError, match="begins in another direction"):
        verify(again(content, lambda t: t["corners"].clear()), ur5, scene)


def scaled(key, factor):
    def change(claim):
        value = claim[key]
        claim[key] = [factor * x for x in value] if isinstance(value, list) else factor * value

    return change


def faster(claim):
    claim["squares"] = [1.05 * x for x in claim["squares"]]
    claim["duration"] /= 1.05**0.5


def stronger(**claims):
    return lambda claim: claim["stops"].update(claims)


def bent(claim):
    claim["coefficients"][1][2] = [1.01 * x for x in claim["coefficients"][1][2]]


def leaping(claim):
    """Far and back within what counts as one grid point, where it stands."""
    start, size, still = np.array(claim["coefficients"][0][0]), 2e-10, np.zeros((2, 6))
    far = np.array([-0.05, 0, 0, 0, 0, 0])
    there, back = np.array([start, far, *still]), np.array([start + far, -far, *still])
    claim["coefficients"] = [there.tolist(), back.tolist(), *claim["coefficients"]]
    claim["times"] = [0.0, size, *(t + 2 * size for t in claim["times"])]
    claim["corners"] = [1, 2, *(k + 2 for k in claim["corners"])]


def stepping(claim):
    """Put steps to and fro into the first piece, each no farther than what counts as the same place."""
    count, size, (start, slope) = 20, 1.5e-9, np.array(claim["coefficients"][0][:2])
    length = claim["times"][1]
    begin = 0.3 * length
    knots = begin + size * np.arange(count + 1)
    places = [start, *(start + np.outer(knots / length, slope))]
    for k in range(2, count + 1, 2):
        places[k] = places[k] + 0.9e-9
    times = [0.0, *knots.tolist(), *claim["times"][1:]]
    rows = [
        [q, slope * span / length, 0 * q, 0 * q] for q, span in zip(places, np.diff(times[: count + 3]), strict=True)
    ]
    claim["coefficients"] = [*np.array(rows).tolist(), *claim["coefficients"][1:]]
    claim["times"] = times
    claim["corners"] = [k + count + 1 for k in claim["corners"]]
    edges, squares = np.array(claim["edges"]), claim["squares"]
    more = np.union1d(edges, knots)
    brakes = np.array(claim["stops"]["brakes"])[np.searchsorted(edges, more[:-1], side="right") - 1]
    claim["edges"], claim["squares"] = more.tolist(), np.interp(more, edges, squares).tolist()
    claim["stops"]["brakes"] = brakes.tolist()


def shortened(claim):
    claim["coefficients"].pop()
    claim["times"].pop()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (faster, "its limit|apart near|goes beyond"),
        (scaled("duration", 0.999), "are claimed"),
        (scaled("velocity", 0.3), "is faster than its limit"),
        (scaled("acceleration", 0.9), "accelerates more than its limit"),
        (stronger(speed=1.25), "are needed"),
        (stronger(reaction_time=0.06), "are needed"),
        (stronger(clearance=0.02), "are needed"),
        (stronger(who=["ball", "table"]), "are needed"),
        (stronger(who=[]), "must contain at least one obstacle"),
        (stronger(who=["nobody"]), "unknown obstacle"),
        (stronger(speed=-0.1), "speed: must be"),
        (lambda claim: claim["stops"].update(brakes=[1.5 * b for b in claim["stops"]["brakes"]]), "in a stop joint"),
        (lambda claim: claim["stops"].update(brakes=[0.2 * b for b in claim["stops"]["brakes"]]), "stop|are needed"),
        (lambda claim: claim["stops"]["brakes"].__setitem__(5, 0.0), "does not decelerate"),
        (bent, "neither a line|begins where|does not begin|another direction"),
        (replaced("coefficients", 0, 0, 0, by=lambda q: q + 1e-6), "begin where the path does|the one before ends"),
        (shortened, "does not end where the path does|not corners"),
        (lambda claim: claim.update(coefficients=[]), "must contain at least one piece"),
        (lambda claim: claim["times"].pop(), r"times: must be \d+ numbers that increase"),
        (lambda claim: claim.update(timed=True), "timed: must be false"),
        (lambda claim: claim.update(slack=[[0.0] * 6] * len(claim["coefficients"])), "slack: must be left out"),
        (lambda claim: claim.pop("acceleration"), "acceleration: missing"),
        (lambda claim: claim["corners"].append(1), "does not stand at"),
        (lambda claim: claim["corners"].append(99), "are not corners"),
        (lambda claim: claim["squares"].__setitem__(0, 0.1), "does not stand at"),
        (lambda claim: claim["squares"].__setitem__(7, -0.1), "do not cover"),
        (lambda claim: claim["edges"].__setitem__(7, claim["edges"][9]), "not in order"),
        (lambda claim: claim.pop("squares"), "squares"),
        (lambda claim: claim.update(more=1), "more"),
        (lambda claim: claim.update(velocity=[0.0] * 6), "velocity"),
        (scaled("velocity", 1e3), r"velocity: must be 6 numbers in \[0\.0001, 999\]"),
        (scaled("acceleration", 1e300), "acceleration: must be 6 numbers in"),
        (lambda claim: claim.update(jerk=[1e9] * 6), "jerk: must be 6 numbers in"),
        (lambda claim: claim.update(tool_speed=1e308), "tool_speed: must be a finite number in"),
        (leaping, "does not begin at a grid point"),
        (stepping, "is too short for the jump where it begins"),
    ],
)
def test_what_does_not_hold_is_refused(written, ur5, scene, change, message):
    with pytest.raises((CertificateError, InputError), match=message):
        verify(again(written, change), ur5, scene)


def test_a_curve_through_an_obstacle_is_refused(ur5, scene):
    """A motion that was timed elsewhere: its blends are not free."""
    low = np.array([PATH[0], [0.4, 0.3, 0.5, 0, 0, 0], PATH[-1]])
    trajectory = time_path(low, ur5, RateLimits.of(ur5, 2.0, 4.0))
    with pytest.raises(CertificateError, match=r"apart near .* of the trajectory"):
        verify(certificate(PATH, ur5, scene, trajectory=trajectory), ur5, scene)


@pytest.fixture(scope="module")
def smooth(ur5, scene):
    """Return the certificate of a trajectory with limits of jerk, tool and links."""
    motion = MotionProver(CollisionChecker(ur5, scene))
    limits = RateLimits.of(ur5, 2.0, 4.0, 500.0)
    made = time_path(PATH, ur5, limits, motion=motion, people=PEOPLE, tool_speed=0.2, link_speed=0.22)
    assert {"tool speed", "link speed"} & set(made.binding())
    return travelled(certificate(PATH, ur5, scene, trajectory=made))


def test_jerk_and_speeds_of_tool_and_links_are_claimed(smooth, ur5, scene):
    found = verify(smooth, ur5, scene)
    assert "accelerations of (4, 4, 4, 4, 4, 4), jerks of (500, 500, 500, 500, 500, 500)" in found.claims[-4]
    assert found.claims[-3] == "the tip is no faster than 0.2 m/s"
    assert found.claims[-2] == "no point of a link, nor the tip, is faster than 0.22 m/s"
    assert not {"stops", "jerk", "tool speed", "link speed"} & set(found.not_claimed)
    assert "danger in motion" in found.not_claimed
    without = again(smooth, lambda claim: [claim.pop(key) for key in ("tool_speed", "jerk")])
    assert {"tool speed", "jerk"} <= set(verify(without, ur5, scene).not_claimed)


def test_no_place_within_a_long_cell_is_faster_than_claimed(ur5):
    slope = np.full(6, 6**-0.5)
    piece = RecordedPiece("edge", derivatives(np.array([PATH[0], 3.0 * slope]), Fraction(3)), 3.0)
    motion = SimpleNamespace(fastest=np.ones(1), starts=[0.0], of=[0], pieces=[piece], edges=np.array([0.0, 3.0]))
    speeds = [np.linalg.norm(ur5.tip_jacobian(piece.at(s))[:3] @ slope) for s in np.linspace(0.0, 3.0, 600)]
    assert speeds[300] < 0.99 * max(speeds), "what is looked at first is not the fastest"
    assert PlainSpeeds(ur5, Budget(60.0)).exceeded(motion, 1.001 * max(speeds), tool=True) is None
    assert PlainSpeeds(ur5, Budget(60.0)).exceeded(motion, 0.999 * max(speeds), tool=True) is not None


def law_of(claim):
    read = ClaimedTrajectory.from_mapping(claim)
    curve = RecordedMotion(read)
    return RecordedLaw(read, curve, curve, Robot.from_example("ur5"))


@pytest.mark.parametrize("windowed", [False, True])
def test_no_rate_within_a_cell_is_outside_its_bounds(written, smooth, windowed):
    law = law_of(claimed(smooth if windowed else written)["trajectory"])
    for cell, (begin, end) in enumerate(pairwise(law.edges)):
        low, high = law.rates_between(cell, begin, end)
        inside = [law.rates_between(cell, s, s) for s in np.linspace(begin, end, 9)]
        assert (low <= np.array(inside) * (1 + 1e-12)).all()
        assert (np.array(inside) <= high * (1 + 1e-12)).all()


def again_long(claim):
    """Claim the duration that the motion has."""
    claim["duration"] = law_of(claim).duration


def swung(claim):
    piece = next(piece for piece in claim["coefficients"] if any(piece[3]))
    piece[3] = [1.01 * x for x in piece[3]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (scaled("tool_speed", 0.9), "the tool is faster than 0.18 m/s"),
        (scaled("link_speed", 0.9), "a link is faster than 0.198 m/s"),
        (scaled("jerk", 0.7), "has more jerk than its limit"),
        (scaled("acceleration", 0.3), "accelerates more than its limit"),
        (scaled("velocity", 0.1), "is faster than its limit"),
        (scaled("duration", 0.999), "are claimed"),
        (lambda claim: claim.pop("window"), "are claimed|accelerates more|the jerk is not limited"),
        (scaled("window", 0.9), "are claimed"),
        (scaled("window", -1), "window: must be"),
        (lambda claim: (scaled("window", 0.7)(claim), again_long(claim)), "has more jerk"),
        (lambda claim: (scaled("window", 6)(claim), again_long(claim)), "are needed|is faster|accelerates"),
        (swung, "does not begin|begins in another|acceleration jumps"),
        (lambda claim: claim.update(jerk=[0.0] * 6), "jerk"),
        (lambda claim: claim.update(tool_speed=-1), "tool_speed: must be"),
        (stronger(speed=2.5), "are needed"),
        (lambda claim: claim["stops"].update(brakes=[1.2 * b for b in claim["stops"]["brakes"]]), "in a stop"),
    ],
)
def test_what_does_not_hold_of_jerk_and_speeds_is_refused(smooth, ur5, scene, change, message):
    with pytest.raises((CertificateError, InputError), match=message):
        verify(again(smooth, change), ur5, scene)


def test_a_motion_whose_acceleration_jumps_has_no_window(written, ur5, scene):
    with pytest.raises(CertificateError, match="the acceleration jumps"):
        verify(again(written, lambda claim: claim.update(window=0.01)), ur5, scene)
