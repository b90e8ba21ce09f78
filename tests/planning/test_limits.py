"""Hard limits of whole paths: what setups and scenarios refuse, and why."""

import json

import numpy as np
import pytest
from ball import densely

from safe_ompl import CollisionError, InputError, Scenario
from safe_ompl.planning import SafeSetup, setup_scenario

START, GOAL, DANGEROUS = [1.25, -0.35, 0.2], [-1.2, 0.3, -0.25], [0.3, 0.9, -1.8]
LIMIT = 8.0  # planar3: paths without a limit reach 6.7 to 15, start and goal 4.3
UP, DOWN = [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]
CLEARANCE = 0.12  # [m] from the person; start and goal keep 0.6


@pytest.fixture(scope="module")
def scenario():
    return Scenario.load("planar3")


@pytest.fixture
def setup(scenario):
    return setup_scenario(scenario)


def danger_of(setup, path):
    return setup.field.values(densely(setup.robot, path)).max()


# ------------------------------------------------------------------------------------------------------ danger


def test_a_limit_needs_a_danger(scenario):
    setup = SafeSetup(scenario.build_robot(), scenario.scene, danger=None)
    with pytest.raises(InputError, match="max danger needs a danger field"):
        setup.setMaxDanger(9.0)


# --------------------------------------------------------------------------------------- what is refused is not set

TOO_NEAR = "start is too near: '.*' keeps less than 700 mm from 'person'"


REFUSED_LIMITS = [
    ("setMaxDanger", (4.0,), CollisionError, r"start: danger 4\.277 is above the limit 4"),
    *(("setMaxDanger", (bad,), InputError, "must be a finite number >= 0") for bad in (-1.0, np.nan, "9")),
    ("setMinClearance", (0.7,), CollisionError, TOO_NEAR),
    ("setMinClearance", (-1.0,), InputError, "-1"),
    ("setMinClearance", (0.1, ["nobody"]), InputError, "nobody"),
    ("setMinClearance", (0.1, None, [("nose", "person")]), InputError, "nose"),
    ("setMovingObstacles", ({"person": 1.0}, 1.0), CollisionError, "'person' may move 1000 mm, and come to"),
    ("setMovingObstacles", ({"nobody": 1.0}, 1.0), InputError, "nobody"),
    ("setTube", ([0.1, 0.1],), InputError, "tube"),
    ("setTipBounds", ([-2, -2, -1], [0, 2, 1]), CollisionError, r"start: the tip is \d+\.\d+ mm outside of its bounds"),
    ("setTipBounds", ([-1, -1, -1],), InputError, "give both corners"),
    ("setToolConstraint", (UP, DOWN, 0.5), CollisionError, "start: the tool is 180° from its direction, 28.6"),
    ("setToolConstraint", (UP,), InputError, "give the angle"),
]


@pytest.mark.parametrize(("limit", "arguments", "error", "message"), REFUSED_LIMITS)
def test_a_limit_that_is_refused_leaves_those_before(setup, limit, arguments, error, message):
    dangerous = setup.plan("ClassicRRTConnect", time=20.0, seed=0).path
    assert danger_of(setup, dangerous) > LIMIT
    setup.setMaxDanger(LIMIT)
    setup.setMinClearance(CLEARANCE)
    before = setup.getConstraints()
    with pytest.raises(error, match=message):
        getattr(setup, limit)(*arguments)
    assert setup.getConstraints() is before
    assert not setup.is_free(dangerous)
    assert setup.plan(time=20.0).report.danger.max <= LIMIT


def test_goals_above_the_limit_and_exempt_links(setup):
    setup.setMaxDanger(LIMIT)
    with pytest.raises(CollisionError, match=r"goal.*above the limit 8"):
        setup.setConfigurations(START, DANGEROUS)
    setup.setConfigurations(START, [DANGEROUS, GOAL])
    with pytest.raises(InputError, match="exempt must leave a moving link that keeps away from 'person'"):
        setup.setMinClearance(0.7, exempt=[(f"link{k}", "person") for k in (1, 2, 3)])
    exempt = [("link2", "person"), ("link3", "person")]
    setup.setMinClearance(0.3, exempt=exempt)
    assert setup.getConstraints().separation.min_clearance.exempt == set(exempt)


# ---------------------------------------------------------------------------------------------------- scenarios


BAD_KEYS = [
    ({"max_danger": -1}, "limits.max_danger: must be a finite number >= 0, got -1"),
    ({"min_clearance": "far"}, "limits.min_clearance: must be a finite number >= 0"),
    ({"exempt": [["link1"]]}, "limits.exempt: must be pairs of a link and an obstacle"),
    ({"exempt": "link1"}, "limits.exempt"),
    ({"danger": 3}, "limits.*danger"),
    ({"tool": {}}, r"limits\.tool\.angle: missing"),
    ({"tool": {"angle": 30}}, r"limits\.tool\.angle: must be a finite number in \(0, 3.14"),
    ({"tool": {"angle": 0.5, "axis": [0, 0, 0]}}, r"limits\.tool\.axis: must be a vector"),
    ({"tool": {"angle": 0.5, "direct": [0, 0, 1]}}, r"limits\.tool\.direct: unknown key"),
    ({"tip": {"z": [1, 0]}}, r"limits\.tip\.z: must be \[low, high\] with low < high"),
    ({"tip": {}}, r"limits\.tip\.x: missing"),
]


@pytest.mark.parametrize(("limits", "message"), BAD_KEYS)
def test_limits_are_checked(scenario, tmp_path, limits, message):
    scenario.save(tmp_path / "s.yaml")
    with (tmp_path / "s.yaml").open("a") as stream:
        stream.write(f"limits: {json.dumps(limits)}\n")
    with pytest.raises(InputError, match=message):
        Scenario.load(tmp_path / "s.yaml")
