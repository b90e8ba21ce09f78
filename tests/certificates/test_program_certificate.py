"""The certificate of a program: it holds, and what is changed in it is refused, signed anew or not."""

import copy
import dataclasses

import pytest
from hypothesis import given, strategies as st
from signing import signed

from safe_ompl import Box, Capsule, CertificateError, InputError, Obstacle, PlanningError, Scenario, Scene, plan_program
from safe_ompl.certificates import program_certificate, terms_of, verify_program
from safe_ompl.certificates.verifier.program import _without_contact
from safe_ompl.io import built_robot
from safe_ompl.robot import robot_hash
from safe_ompl.scene import MotionLimits
from safe_ompl.scene.constraints import PathLimits
from safe_ompl.tasks import program_robot

TEXT = """
name: lift
robot: panda
start: [0.0, -0.35, 0.0, -2.3, 0.0, 1.95, 0.785]
scene:
  obstacles:
    - {name: table, box: {size: [0.4, 0.4, 0.04]}, position: [0.5, 0, 0.18]}
    - {name: cube, box: {size: [0.05, 0.05, 0.05]}, position: [0.5, 0, 0.225]}
    - {name: pole, cylinder: {radius: 0.02, length: 1.0}, position: [0.2, 0.7, 0.5], weight: 1.0}
program:
  grasps: {cube: [{rpy: [3.141592653589793, 0, 0]}]}
  steps:
    - move: {grasp: cube, back: 0.08}
    - line: {grasp: cube}
    - gripper:
        joints: {panda_finger_joint1: 0.0245}
        touching: [[panda_leftfinger, cube], [panda_rightfinger, cube]]
    - attach: cube
    - line: {up: 0.05, touching: [[cube, table]]}
"""


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    file = tmp_path_factory.mktemp("program") / "lift.yaml"
    file.write_text(TEXT)
    return Scenario.load(file)


@pytest.fixture(scope="module")
def result(scenario):
    found = plan_program(scenario)
    assert found, found
    return found


@pytest.fixture(scope="module")
def content(result):
    return program_certificate((stretch.begin, stretch.check) for stretch in result.stretches)


def test_it_holds_for_its_scenario_and_says_what_may_touch(content, scenario, result):
    found = verify_program(content, program_robot(scenario), scenario.scene)
    assert not found.own
    assert f"one motion of {result.duration:.3f} s" in str(found)
    assert "contact of cube with table" in found.not_covered
    assert "and the scene that the file itself carries" in verify_program(content).claims[0]


def begin_later(content):
    content["stretches"][1]["begin"] += 0.01


def take_elsewhere(content):
    pose = content["robots"][1]["recipe"]["attached"][0]["position"]
    pose[2] -= 0.002


def leave_out_the_core(content):
    for scene in content["scenes"]:
        obstacles = scene["content"]["obstacles"]
        scene["content"]["obstacles"] = [o for o in obstacles if not o["name"].startswith("table, ")]


def make_the_core_small(content):
    for scene in content["scenes"]:
        for obstacle in scene["content"]["obstacles"]:
            if obstacle["name"].startswith("table, "):
                obstacle["box"]["size"] = [0.1, 0.1, 0.01]


def forget_the_cube(content):
    scene = content["scenes"][0]["content"]
    scene["obstacles"] = [o for o in scene["obstacles"] if o["name"] != "cube"]


def skip_a_stretch(content):
    del content["stretches"][1]


def use_another_scene(content):
    content["stretches"][0]["certificate"]["scene"] = content["stretches"][-1]["certificate"]["scene"]


def use_no_scene(content):
    content["stretches"][0]["certificate"]["scene"] = 17


def hold_from_the_beginning(content):
    content["stretches"][0]["certificate"]["robot"] = 1


def name_a_core_without_a_depth(content):
    for scene in content["scenes"]:
        for obstacle in scene["content"]["obstacles"]:
            if obstacle["name"].startswith("table, "):
                obstacle["name"] = "table, some mm deep"


def let_the_pole_be_harmless_later(content):
    for scene in content["scenes"][1:]:
        for obstacle in scene["content"]["obstacles"]:
            obstacle.pop("weight", None)


def keep_a_distance_from_what_is_touched(content):
    content["stretches"][-1]["certificate"]["clearance"] = {"distance": 0.0001, "obstacles": ["table"]}


def keep_a_margin_from_all(content):
    content["stretches"][-1]["certificate"]["margin"] = 0.00001


def resigned(content):
    """Return the content with all hashes and digests that belong to it: whoever tampers can compute them."""
    for robot in content["robots"]:
        robot["hash"] = robot_hash(built_robot(robot))
    for scene in content["scenes"]:
        scene["hash"] = Scene.from_mapping(scene["content"]).content_hash()
    for stretch in content["stretches"]:
        numbers = {name: stretch["certificate"][name] for name in ("robot", "scene")}
        if max(numbers.values()) < len(content["scenes"]):
            whole = {name: content[f"{name}s"][number] for name, number in numbers.items()}
            stretch["certificate"] = {**signed({**stretch["certificate"], **whole}), **numbers}
    return signed(content)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (begin_later, "stretch 1: it begins at .* but the one before ends at"),
        (take_elsewhere, "'cube' is 2 mm or mrad from where it was"),
        (leave_out_the_core, "cube may touch 'table', to any depth"),
        (make_the_core_small, "is not what is so deep in 'table'"),
        (forget_the_cube, "'cube' is in one of this stretch and the one before"),
        (skip_a_stretch, "stretch 1: it begins"),
        (use_another_scene, "'cube' is in one of this stretch and the one before"),
        (use_no_scene, "stretch 0: scene: must be a number from 0 to"),
        (hold_from_the_beginning, "'cube' is held, and an obstacle, too"),
        (name_a_core_without_a_depth, "malformed: ValueError"),
        (let_the_pole_be_harmless_later, "'pole' is not as dangerous as in the stretch before"),
        (keep_a_distance_from_what_is_touched, "clearance.obstacles: 'table' may be touched"),
        (keep_a_margin_from_all, "margin: .* may be touched"),
    ],
)
def test_what_is_changed_is_refused(content, change, words):
    forged = copy.deepcopy(content)
    change(forged)
    with pytest.raises((CertificateError, InputError)):
        verify_program(forged)
    with pytest.raises((CertificateError, InputError), match=words):
        verify_program(resigned(forged))


@given(st.floats(0.1, 90.0), st.floats(1e-5, 0.04), st.floats(2e-9, 0.01), st.sampled_from((-1, 1)), st.booleans())
def test_cores_are_as_deep_as_they_say_however_large_the_obstacle_is(size, depth, wrong, sign, round_):
    shape = Capsule(size / 2, 1.0) if round_ else Box([size, 1.0, size])
    scene = Scene([Obstacle("block", shape)]).touched([("hand", "block")], depth)
    assert [obstacle.name for obstacle in _without_contact(scene)] == ["block"]
    core, block = scene.obstacles
    other = Scene([dataclasses.replace(core, shape=shape.core(depth + sign * min(wrong, 0.9 * depth))), block])
    with pytest.raises(CertificateError, match="is not what is so deep in 'block'"):
        _without_contact(other)


@pytest.mark.parametrize("name", ["robot", "scene"])
def test_what_it_must_begin_with_is_that_of_the_first_stretch(content, scenario, name):
    """Another one that stands first among robots and scenes, where no stretch uses it, is of no use."""
    forged = copy.deepcopy(content)
    true = copy.deepcopy(forged[f"{name}s"][0])
    if name == "scene":
        for scene in forged["scenes"]:
            obstacles = scene["content"]["obstacles"]
            scene["content"]["obstacles"] = [o for o in obstacles if o["name"] != "pole"]
    else:
        for robot in forged["robots"]:
            held = {"name": "rod", "link": "panda_hand_tcp", "sphere": {"radius": 0.001}, "position": [0.15, 0, -0.05]}
            robot["recipe"]["attached"] = [*robot["recipe"].get("attached", []), held]
    forged[f"{name}s"].insert(0, true)
    for stretch in forged["stretches"]:
        stretch["certificate"][name] += 1
    forged = resigned(forged)
    with pytest.raises(CertificateError, match=f"the {name} has changed"):
        verify_program(forged, program_robot(scenario), scenario.scene)


def test_whatever_may_touch_what_is_held_is_said(content):
    forged = copy.deepcopy(content)
    forged["robots"][1]["recipe"]["attached"][0]["touch_links"].append("panda_link5")
    said = "contact of panda_leftfinger and panda_rightfinger and panda_link5 with cube"
    assert said in verify_program(resigned(forged)).not_covered


def test_limits_must_be_those_of_the_scenario(content, scenario):
    slower = dataclasses.replace(scenario, motion=MotionLimits(velocity=0.5))
    robot = program_robot(slower)
    assert verify_program(content, robot, scenario.scene, terms=terms_of(scenario, robot))
    with pytest.raises(CertificateError, match="stretch 0: motion: velocity is"):
        verify_program(content, robot, scenario.scene, terms=terms_of(slower, robot))


def test_no_clearance_is_claimed_of_what_may_be_touched(scenario):
    limits = PathLimits(min_clearance=0.002, obstacles=("table", "pole"))
    kept = dataclasses.replace(scenario, limits=limits)
    found = plan_program(kept)
    assert found, found
    stretches = [(stretch.begin, stretch.check) for stretch in found.stretches]
    last = [stretch["certificate"]["clearance"] for stretch in program_certificate(stretches)["stretches"]][-1]
    assert last == {"distance": 0.002, "obstacles": ["pole"]}


def test_stretches_that_do_not_follow_each_other_are_not_certified(result):
    parts = [(stretch.begin, stretch.check) for stretch in result.stretches]
    with pytest.raises(PlanningError, match="not one program: stretch 1"):
        program_certificate([parts[0], (parts[1][0], parts[2][1])])
