"""The certificate of a program: it holds, and what is changed in it is refused, signed anew or not."""

import copy
import dataclasses
import zlib
from base64 import b64encode

import numpy as np
import pytest
from crank import CRANK
from signing import replaced, signed

from safe_ompl import CertificateError, InputError, PlanningError, SafeSetup, Scenario, Scene, plan_program
from safe_ompl.certificates import program_certificate, terms_of, verify
from safe_ompl.geometry import Box, Obstacle, Pose
from safe_ompl.io import built_robot
from safe_ompl.motions import Motion, RateLimits
from safe_ompl.robot import Robot, robot_hash
from safe_ompl.scene import MotionLimits, list_scenarios
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


@pytest.fixture(scope="module")
def about(scenario):
    robot = program_robot(scenario)
    return {"robot": robot, "scene": scenario.scene, "terms": terms_of(scenario, robot)}


def test_it_holds_for_its_scenario_and_says_what_may_touch(content, about, result):
    found = verify(content, **about)
    assert not found.own
    assert found.claims[:6] == (
        "every motion of 4 stretches is free",
        f"they are one motion of {result.duration:.3f} s, without jumps of velocity",
        "panda_hand_tcp holds cube, where it took it, in stretch 3",
        "panda_leftfinger and panda_rightfinger may touch cube, no deeper than 1 mm, in stretches 2 to 3",
        "cube may touch table, no deeper than 1 mm, in stretch 3",
        "nothing else touches, but what is held and the links that do not move against its tip",
    )
    assert "and the scene that the file itself carries" in verify(content).claims[0]


# ---------------------------------------------------------------------------------------------------- what is forged


TIP, FIRST, LAST = "panda_hand_tcp", ("stretches", 1), ("stretches", 3)
ON_TABLE, IN_HAND = ((*LAST, "contacts", k) for k in (0, 1))
FINGERS = ["panda_leftfinger", "panda_rightfinger", "panda_link5"]
POLE = {"links": ["panda_link5"], "object": "pole", "depth": 0.001}
NEAR = {"distance": 0.0001, "obstacles": ["table"]}
ROD = {"name": "rod", "link": TIP, "sphere": {"radius": 0.001}, "position": [0.15, 0, -0.05]}
PAIRS = "".join(f'<disable_collisions link1="panda_link0" link2="panda_link{k}"/>' for k in range(1, 8))
FEWER = {"name": "own.srdf", "text": f'<robot name="panda">{PAIRS}</robot>'}


def put(value, *at):
    """Return a change that puts a value at a place; None takes out what is there."""
    return replaced(*at, by=value)


def early(content):
    """Take the cube before the fingers close."""
    closes, lifts = content["stretches"][2:]
    closes["attach"] = lifts.pop("attach")
    closes["contacts"] = copy.deepcopy(lifts["contacts"])


def jump(content):
    for rows in content["stretches"][1]["motion"]["coefficients"]:
        rows[0][0] += 1e-5


FORGED = {
    "touch the table deeper": (put(0.01, *ON_TABLE, "depth"), "'cube' may touch 'table' 10 mm deep: .* allows 1 mm"),
    "touch what is held deeper": (put(0.01, *IN_HAND, "depth"), "'panda_leftfinger' may touch 'cube' 10 mm deep: the"),
    "touch with another link": (put(FINGERS, *IN_HAND, "links"), "'panda_link5' may touch 'cube' .* allows 0 mm"),
    "touch something else": (put([POLE], *LAST, "contacts"), "'panda_link5' may touch 'pole' .* allows 0 mm"),
    "touch without a depth": (put(None, *ON_TABLE, "depth"), "contacts.*depth: missing"),
    "touch what is not there": (put("bench", *ON_TABLE, "object"), "'bench'"),
    "touch to no depth": (put(0.0, *ON_TABLE, "depth"), "depth: must be"),
    "forget that the cube is held": (put(None, *LAST, "attach"), "stretch 3: "),
    "take it twice": (put({"cube": TIP}, *FIRST, "attach"), "is at 0.04 when cube changes hands: .* to 0.0245 by then"),
    "take it before the fingers close": (early, "is at 0.04 .* program has moved it to 0.0245 by then"),
    "take the pole": (put(TIP, *LAST, "attach", "pole"), "'pole' taken by 'panda_hand_tcp': .* differs"),
    "take it with the elbow": (put("panda_link4", *LAST, "attach", "cube"), "'panda_link4', which is the tip"),
    "put down what is not held": (put(["cube"], *FIRST, "detach"), "stretch 1: 'cube' is put down, but not held"),
    "skip a stretch": (put(None, *FIRST), "stretch 1: it begins .* from where the one before ends"),
    "jump": (jump, "stretch 1: it begins 1e-05 rad or m from where the one before ends"),
    "claim a distance from what is touched": (put(NEAR, *LAST, "clearance"), "clearance.obstacles: 'table' may be"),
    "claim a margin": (put(0.00001, *LAST, "margin"), "margin: .* may be touched"),
    "be elsewhere": (put(0.17, "scene", "content", "obstacles", 0, "position", 2), "the scene has changed"),
    "hold a rod": (put([ROD], "robot", "recipe", "attached"), "the robot has changed"),
    "check fewer pairs": (put(FEWER, "robot", "recipe", "srdf"), "the robot has changed"),
}


def resigned(content):
    """Return the content with all hashes and digests that belong to it: whoever tampers can compute them."""
    content["robot"]["hash"] = robot_hash(built_robot(content["robot"]))
    content["scene"]["hash"] = Scene.from_mapping(content["scene"]["content"]).content_hash()
    return signed(content)


@pytest.mark.parametrize(("change", "words"), FORGED.values(), ids=FORGED)
def test_what_is_changed_is_refused(content, about, change, words):
    forged = copy.deepcopy(content)
    change(forged)
    with pytest.raises((CertificateError, InputError)):
        verify(forged)
    with pytest.raises((CertificateError, InputError), match=words):
        verify(resigned(forged), **about)


def test_meshes_of_the_file_are_not_those_of_the_robot(tmp_path, data_folder):
    """A file whose robot has the scenario's recipe and hash, and meshes of another size beside it, has no say."""
    about, check = lone_robot(tmp_path, data_folder)
    found = program_certificate([(0.0, check)])
    forged = copy.deepcopy(found)
    small = (
        "\n".join(f"v {x} {y} {z}" for x, y, z in np.eye(3) * 0.01) + "\nv 0 0 0\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
    )
    forged["robot"]["meshes"] = {"wedge.obj": b64encode(zlib.compress(small.encode())).decode()}
    with pytest.raises((CertificateError, InputError)):
        verify(signed(forged))
    assert verify(found, package_dirs=[tmp_path])
    assert verify(signed(forged), *about).claims == verify(found, *about).claims


def lone_robot(folder, data):
    """Return robot and scene of a URDF with a mesh of its own, and a proven motion."""
    (folder / "wedge.obj").write_bytes((data / "wedge.obj").read_bytes())
    (folder / "arm.urdf").write_text(CRANK.replace('<sphere radius="0.05"/>', '<mesh filename="wedge.obj"/>'))
    robot = Robot.from_urdf(folder / "arm.urdf")
    scene = Scene([Obstacle("ball", Box((0.1, 0.1, 0.1)), Pose((5.0, 0.0, 0.0)))])
    setup = SafeSetup(robot, scene, danger=None)
    return (robot, scene), setup.check(Motion.hermite([0.0, 2.0], [[0.0], [0.5]], [[0.0], [0.0]]))


# ----------------------------------------------------------------------------------------------------------- joints


@pytest.fixture(scope="module")
def setup(about):
    return SafeSetup(about["robot"], about["scene"])


def polynomial(setup, positions, velocities, times=(0.0, 1.0), accelerations=None, **options):
    """Return what is proven of a motion of the first joint, with its position and rates at both ends."""
    robot = setup.robot
    given = [np.tile(START, (2, 1))] + [np.zeros((2, robot.n)) for _ in range(2)]
    for rows, values in zip(given, (positions, velocities, accelerations or (0.0, 0.0)), strict=True):
        rows[:, 0] += values
    motion = Motion.hermite(times, *given[: 2 + (accelerations is not None)])
    limits = RateLimits.of(robot, 2.0, 20.0, options.get("jerk"))
    return setup.check(motion, None if options.get("bare") else limits)


START = [0.0, -0.35, 0.0, -2.3, 0.0, 1.95, 0.785, 0.04]


@pytest.mark.parametrize("deep", [0.0, 0.02])
def test_what_is_held_from_the_beginning_may_be_in_its_hand_to_any_depth_which_is_said(deep):
    robot = Robot.from_example("panda").with_attached("rod", Box((0.02, 0.02, 0.1)), pose=(0.0, 0.0, 0.07 - deep))
    setup = SafeSetup(robot, Scene([Obstacle("ball", Box((0.1, 0.1, 0.1)), Pose((5.0, 0.0, 0.0)))]), danger=None)
    q = np.array([0.0, -0.35, 0.0, -2.3, 0.0, 1.95, 0.785])
    found = verify(program_certificate([(0.0, setup.check(Motion.hermite([0, 1], [q, q + 0.01], [0 * q, 0 * q])))]))
    said = "contact of rod, which panda_hand_tcp holds from the beginning, with what does not move against it"
    assert said in found.not_covered


def test_stretches_are_joined_at_their_velocities(setup):
    parts = [polynomial(setup, (0.0, 0.1), (0.0, 0.2)), polynomial(setup, (0.1, 0.2), (0.2, 0.0))]
    assert program_certificate([(0.0, parts[0]), (1.0, parts[1])])
    slow = polynomial(setup, (0.1, 0.2), (0.1, 0.0))
    with pytest.raises(PlanningError, match=r"stretch 1: its velocity begins 0.1 rad/s"):
        program_certificate([(0.0, parts[0]), (1.0, slow)])
    with pytest.raises(PlanningError, match=r"stretch 1 begins at 1.100000 s, but the one before ends at 1.0"):
        program_certificate([(0.0, parts[0]), (1.1, parts[1])])


def test_accelerations_do_not_jump_where_the_jerk_is_limited(setup):
    def part(positions, velocities, accelerations):
        return polynomial(setup, positions, velocities, accelerations=accelerations, jerk=300.0)

    first = part((0.0, 0.1), (0.0, 0.2), (0.0, 0.1))
    assert program_certificate([(0.0, first), (1.0, part((0.1, 0.2), (0.2, 0.0), (0.1, 0.0)))])
    with pytest.raises(PlanningError, match=r"stretch 1: its acceleration begins"):
        program_certificate([(0.0, first), (1.0, part((0.1, 0.2), (0.2, 0.0), (-0.1, 0.0)))])


def test_jumps_of_position_count_as_motion(setup):
    """A jump of less than a micrometre in a piece of a microsecond is fast."""
    first = polynomial(setup, (0.0, 0.1), (0.0, 0.0))
    after = polynomial(setup, (0.1 + 9e-7, 0.1 + 9e-7), (0.0, 0.0), times=(0.0, 1e-7))
    with pytest.raises(PlanningError, match=r"stretch 1: motion: velocity of joint 'panda_joint1' above its limit"):
        program_certificate([(0.0, first), (1.0, after)])


def untimed(setup, *positions):
    rows = np.tile(START, (len(positions), 1))
    rows[:, 0] += positions
    return setup.check(Motion.through(rows))


def test_stretches_that_are_not_in_time_take_none(setup):
    path, rest = untimed(setup, 0.0, 0.1), polynomial(setup, (0.1, 0.2), (0.0, 0.0))
    whole = verify(program_certificate([(0.0, path), (0.009, untimed(setup, 0.1, 0.2))]))
    assert whole.claims[1] == "they are one path"
    assert {"velocity", "acceleration", "jerk"} <= set(whole.not_claimed)
    mixed = verify(program_certificate([(0.0, path), (1.0, rest)]))
    assert mixed.claims[1] == "they are one motion, 1 stretches of which are not in time"
    assert {"velocity", "acceleration", "jerk"} <= set(mixed.not_claimed)
    with pytest.raises(PlanningError, match="not in time, but does not rest there"):
        program_certificate([(0.0, path), (1.0, polynomial(setup, (0.1, 0.2), (0.1, 0.0)))])


def test_obstacles_do_not_drift(about):
    """Each scene is compared with what the program makes of the first one, not with the scene before."""
    robot, scene = about["robot"], about["scene"]
    parts = []
    for k in range(3):
        pole = scene["pole"]
        moved = pole.moved(Pose(np.add(pole.pose.position, (k * 9e-7, 0.0, 0.0))))
        there = Scene([moved if o.name == "pole" else o for o in scene], scene.spacing)
        parts.append((float(k), polynomial(SafeSetup(robot, there), (0.0, 0.0), (0.0, 0.0))))
    assert program_certificate(parts[:2])
    with pytest.raises(PlanningError, match=r"stretch 2: 'pole' is 0.0018 mm or mrad from where it was"):
        program_certificate(parts)


def test_limits_must_be_those_of_the_scenario(content, scenario):
    slower = dataclasses.replace(scenario, motion=MotionLimits(velocity=0.5))
    robot = program_robot(slower)
    assert verify(content, robot, scenario.scene, terms=terms_of(scenario, robot))
    with pytest.raises(CertificateError, match=r"stretch 0: motion: velocity is"):
        verify(content, robot, scenario.scene, terms=terms_of(slower, robot))


def test_no_clearance_is_claimed_of_what_may_be_touched(scenario):
    limits = PathLimits(min_clearance=0.002, obstacles=("table", "pole"))
    kept = dataclasses.replace(scenario, limits=limits)
    found = plan_program(kept)
    assert found, found
    stretches = [(stretch.begin, stretch.check) for stretch in found.stretches]
    last = [stretch["clearance"] for stretch in program_certificate(stretches)["stretches"]][-1]
    assert last == {"distance": 0.002, "obstacles": ["pole"]}


def test_a_rod_is_handed_over():
    """Two hands touch the rod on the stretches before and after it changes hands, each as a step says."""
    given = Scenario.load(list_scenarios(programs=True)["pandas_handover"])
    found, robot = plan_program(given), program_robot(given)
    assert found, found
    parts = [(stretch.begin, stretch.check) for stretch in found.stretches]
    content = program_certificate(parts, begin=(robot, given.scene))
    claims = verify(content, robot, given.scene, terms=terms_of(given, robot)).claims
    assert "left_panda_hand_tcp holds rod, where it took it, in stretches 3 to 6" in claims
    assert "right_panda_hand_tcp holds rod, where it took it, in stretches 7 to 10" in claims
    taken = content["stretches"][7]
    assert (taken["detach"], taken["attach"]) == (["rod"], {"rod": "right_panda_hand_tcp"})


def test_what_a_carried_robot_holds_at_first_is_put_down():
    """The files of a robot that travels are gone when it is to be without what it holds."""
    bare = Robot.from_urdf(list_scenarios()["planar2"].parent / "robots" / "planar2.urdf", tip="tip")
    robot = bare.with_attached("rod", Box((0.1, 0.02, 0.02)), "tip", Pose((0.1, 0.0, 0.0)))
    place = robot.tip_pose(np.array([0.5, 0.0])) * Pose((0.1, 0.0, 0.0)).se3
    put = Scene([Obstacle("rod", Box((0.1, 0.02, 0.02)), Pose.of(place))])
    parts = []
    for k, (holder, scene) in enumerate(((robot, Scene()), (bare, put))):
        motion = Motion.hermite([0.0, 2.0], [[0.5 * k, 0.0], [0.5 - 0.5 * k, 0.0]], np.zeros((2, 2)))
        parts.append((2.0 * k, SafeSetup(holder, scene, danger=None).check(motion)))
    content = program_certificate(parts)
    assert content["stretches"][1]["detach"] == ["rod"]
    assert verify(content).own == ("robot", "scene")
