"""Mutated certificates, by the means of `python -m bench mutations`, are refused or claim nothing false."""

import json
import logging
from collections import Counter

import pytest
from signing import signed

from bench import mutations
from safe_ompl import CertificateError, verify
from safe_ompl.certificates.claims import Certificate
from safe_ompl.robot import robot_hash

NUMBER = 24


@pytest.fixture(autouse=True)
def quiet(caplog):
    caplog.set_level(logging.ERROR)


def test_what_is_not_mutated_is_accepted_and_true():
    for case in mutations.cases():
        assert mutations.judged(case, case.content) == {"given": "true", "carried": "true"}


def test_random_mutations_are_refused_or_claim_nothing_false():
    found = Counter()
    for k in range(NUMBER):
        case = mutations.cases()[k % len(mutations.cases())]
        content = mutations.mutation(case, 1, k)
        assert json.dumps(content, sort_keys=True) == json.dumps(mutations.mutation(case, 1, k), sort_keys=True)
        for mode, result in mutations.judged(case, content).items():
            assert result in ("refused", "true"), (k, case.name, mode, result)
            found[mode, result] += 1
    assert min(found.values()) > NUMBER / 50, found


@pytest.mark.parametrize(
    ("number", "at", "factor"),
    [
        (0, ("danger", "bound"), 0.9),
        (0, ("clearance", "distance"), 20),
        (0, ("moving_obstacles", "time"), 30),
        (0, ("tool", "position", "y", 0), 0.2),
        (0, ("motion", "coefficients", 0, 1, 1), -1),
        (2, ("trajectory", "velocity", 0), 0.5),
        (2, ("trajectory", "tool_speed"), 0.1),
        (2, ("trajectory", "stops", "speed"), 5),
        (2, ("trajectory", "danger", "bound"), 0.9),
        (2, ("trajectory", "jerk", 1), 0.1),
        (3, ("tube", 1), 30),
        (4, ("margin",), 30),
        (4, ("motion", "velocity", 0), 0.5),
        (4, ("motion", "jerk", 0), 0.05),
        (4, ("motion", "coefficients", 1, 0, 0), 1.1),
        (5, ("motion", "coefficients", 20, 0, 0), 1.1),
        (6, ("stretches", 1, "contacts", 0, "depth"), 0.1),
        (6, ("stretches", 1, "motion", "coefficients", 0, 3, 0), 0.5),
        (6, ("stretches", 2, "motion", "coefficients", 0, 0, 0), 1.1),
        (7, ("contacts", 0, "depth"), 0.1),
    ],
)
def test_the_judge_finds_what_is_false_and_so_does_the_verifier(number, at, factor):
    """Sentences that are made of a claim that does not hold are false, and nobody but the verifier looks at it."""
    case = mutations.cases()[number]
    place = at if at[0] == "stretches" else ("stretches", 0, *at)
    content = mutations.replaced(case.content, place, lambda value: factor * value if value else 0.5)
    claims = Certificate.read(signed(content)).sentences("")
    judge = mutations.Judge(case.robot, case.scene)
    assert not judge.true(claims, content, ())
    assert judge.true(Certificate.read(case.content).sentences(""), case.content, ())
    with pytest.raises(CertificateError):
        verify(signed(content), case.robot, case.scene)


def test_a_forged_robot_is_the_files_own_or_refused():
    """Thinner shapes, the fingerprint of these, and a proof for them: what is said is said of the file's robot."""
    case = mutations.cases()[0]
    thinner = case.content["robot"]["recipe"]["urdf"]["text"].replace('radius="0.04"', 'radius="0.001"')
    recipe = {**case.content["robot"]["recipe"], "urdf": {"name": "planar2.urdf", "text": thinner}}
    robot = mutations.built_robot({**case.content["robot"], "recipe": recipe})
    document = {**case.content["robot"], "recipe": recipe, "hash": robot_hash(robot)}
    forged = mutations.issued_anew(case, document, robot, case.scene)
    assert forged["robot"]["hash"] != case.content["robot"]["hash"]
    with pytest.raises(CertificateError, match="the robot has changed"):
        verify(forged, case.robot, case.scene)
    said = verify(forged, scene=case.scene)
    assert said.own == ("robot",)
    assert said.claims[0] == "every motion is free, for the robot that the file itself carries"
