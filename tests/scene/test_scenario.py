"""Scenarios: reading, checking against the robot, and the ones that ship with the package."""

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from safe_ompl import CollisionChecker, InputError, MotionProver, Pose, Robot, Scenario, Scene, UnknownNameError
from safe_ompl.robot import RobotSpec
from safe_ompl.scene import Goal, find_scenario, list_scenarios

FOLDER = Path(__file__).resolve().parents[2] / "scenarios"
SHIPPED = sorted(file.stem for file in FOLDER.glob("*.yaml"))
HAZARD = {
    "panda_shelf": "operator",
    "ur5_handover": "colleague",
    "paper_1": "machine",
    "paper_2": "machine",
    "planar2": "person",
    "planar3": "person",
    "xarm7_pillars": "operator",
}

MINIMAL = """
robot: {urdf: planar3.urdf, tip: tip}
start: [0, 0, 0]
goal: {configuration: [1, 0, 0]}
"""

ANGLE = st.floats(-3.0, 3.0)
POINT = st.tuples(ANGLE, ANGLE, ANGLE)
NAME = st.text(min_size=1).filter(lambda name: name.strip() and name.isprintable())
PARAMETERS = st.dictionaries(NAME, st.one_of(st.floats(-1e9, 1e9), st.integers(), st.booleans(), st.text()), max_size=3)
CONFIGURATIONS = st.one_of(
    st.lists(ANGLE, min_size=1, max_size=7).map(tuple), st.dictionaries(NAME, ANGLE, min_size=1, max_size=3)
)
GOALS = st.one_of(
    st.builds(Goal, st.lists(CONFIGURATIONS, min_size=1, max_size=3).map(tuple)),
    st.builds(Goal, position=POINT, tolerance=st.floats(1e-6, 1.0)),
    st.builds(
        Goal,
        st.lists(CONFIGURATIONS, max_size=2).map(tuple),
        position=POINT,
        quaternion_xyzw=st.just((0.0, 0.6, 0.0, 0.8)),
    ),
)
SPECS = st.builds(
    RobotSpec,
    example=st.text(min_size=1).filter(str.strip),
    tip=st.none() | st.just("tool0"),
    locked=st.none() | st.dictionaries(NAME, ANGLE, max_size=2),
)
SCENARIOS = st.builds(
    Scenario,
    name=st.text(min_size=1).filter(str.strip),
    robot=SPECS,
    scene=st.just(Scene()),
    start=CONFIGURATIONS,
    goal=GOALS,
    description=st.text(),
    danger=PARAMETERS,
    planners=st.dictionaries(NAME, PARAMETERS, max_size=2),
    frames=st.dictionaries(NAME, st.builds(Pose.from_rpy, POINT, POINT), max_size=2),
    time=st.floats(1e-3, 1e6),
)


@pytest.fixture
def folder(tmp_path):
    for file in (FOLDER / "robots").iterdir():
        shutil.copy(file, tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def arm():
    return Robot.from_urdf(FOLDER / "robots/planar3.urdf", FOLDER / "robots/planar3.srdf", tip="tip")


def write(folder, text):
    file = folder / "case.yaml"
    file.write_text(text)
    return file


# ------------------------------------------------------------------------------------------------ documents


@settings(max_examples=25)
@given(scenario=SCENARIOS)
def test_a_file_gives_back_exactly_what_was_saved(scenario, tmp_path_factory):
    file = tmp_path_factory.mktemp("scenario") / "case.yaml"
    scenario.save(file)
    assert Scenario.load(file) == scenario


def test_defaults_and_pickling(folder):
    scenario = Scenario.load(write(folder, MINIMAL))
    assert scenario.name == "case"
    assert scenario.time == 5.0
    assert scenario.scene == Scene()
    assert pickle.loads(pickle.dumps(scenario)) == scenario
    assert scenario.build_robot().joint_names == ("joint1", "joint2", "joint3")
    assert Scenario.load(write(folder, MINIMAL + "planners:\nframes:\n")) == scenario, "empty sections hold nothing"


def test_robot_files_are_relative_to_the_document(folder):
    scenario = Scenario.load(write(folder, MINIMAL))
    (folder / "deeper").mkdir()
    scenario.save(folder / "deeper" / "case.yaml")
    assert "urdf: ../planar3.urdf" in (folder / "deeper" / "case.yaml").read_text()
    assert Scenario.load(folder / "deeper" / "case.yaml") == scenario


def test_goals_of_all_kinds():
    assert Goal.from_mapping({"configurations": [[0], [1]]}).configurations == ((0.0,), (1.0,))
    place = Goal.from_mapping({"position": [1, 2, 3], "tolerance": 0.02})
    assert (place.position, place.quaternion_xyzw, place.tolerance) == ((1.0, 2.0, 3.0), None, 0.02)
    pose = Goal.from_mapping({"position": [0, 0, 0], "rpy": [0, 0, np.pi]})
    assert pose.quaternion_xyzw == pytest.approx((0, 0, 1, 0))
    both = Goal.from_mapping({"configuration": {"a": 1}, "position": [0, 0, 0]})
    assert both.configurations == ({"a": 1.0},)


MALFORMED = [
    (("start:", "strat:"), "strat: unknown key; did you mean 'start'?"),
    (("start: [0, 0, 0]", ""), "start: missing, but needed"),
    (("start: [0, 0, 0]", "start: 7"), "start: must be a list, got int 7"),
    (("[0, 0, 0]", "{joint1: fast}"), "start.joint1: must be a finite number, got 'fast'"),
    (("{configuration: [1, 0, 0]}", "{}"), "goal.configuration: missing: give configuration, "),
    (("{configuration: [1, 0, 0]}", "{configuration: [1], configurations: [[1]]}"), "only one of"),
    (("{configuration: [1, 0, 0]}", "{rpy: [0, 0, 0]}"), "goal.position: missing"),
    (("{configuration: [1, 0, 0]}", "{position: [0, 0]}"), "goal.position: must be 3 numbers"),
    (("{configuration: [1, 0, 0]}", "{position: [0, 0, 0], tolerance: 0}"), "goal.tolerance: must be a positive"),
    (("planar3.urdf", "planar9.urdf"), "robot.urdf: "),
    (("urdf: planar3.urdf,", ""), "robot.example: give either example or urdf"),
    (("tip: tip", "locked: {joint3: stiff}"), "robot.locked.joint3: must be a finite number"),
    (("tip: tip", "group: 7"), "robot.group: must be"),
    (("start:", "people: {reach: reach.yaml}\nstart:"), "people.reach: unknown key; valid keys: who, "),
    (("start:", "time: -1\nstart:"), "time: must be a positive number, got -1"),
    (("start:", "frames: {camera: {position: [1, 0]}}\nstart:"), "frames.camera.position: must be 3 numbers"),
    (("start:", "danger: 3\nstart:"), "danger: must be a mapping"),
    (("start:", "danger: {spacing: .nan}\nstart:"), "danger.spacing: must be a finite number"),
    (("start:", "planners: {SafePRM: {alpha: .inf}}\nstart:"), "planners.SafePRM.alpha: must be a finite"),
]
UNFIT = [
    (("[0, 0, 0]", "[0, 0]"), "start: has 2 values, but the robot has 3 joints to move: joint1, "),
    (("[0, 0, 0]", "{joint1: 0, elbow: 0}"), "start: unknown joint 'elbow'; known: joint1"),
    (("[0, 0, 0]", "{joint1: 0}"), "start: no value for 'joint2', 'joint3'"),
    (("[0, 0, 0]", "[0, 3, 0]"), "start: joint 'joint2' = 3 is outside its limits [-2.6, 2.6]"),
    (("[1, 0, 0]", "[1, 0]"), "goal.configuration: has 2 values"),
    (
        ("configuration: [1, 0, 0]", "configurations: [[1, 0, 0], [9, 0, 0]]"),
        "goal.configurations[1]: joint 'joint1' = 9 is outside its limits",
    ),
    (("configuration: [1, 0, 0]", "position: [1, 0, 0]"), "goal.configuration: missing: this planner"),
    (("{urdf: planar3.urdf, tip: tip}", "pandda"), "robot: unknown example robot 'pandda'; did you mean 'panda'"),
    (("tip: tip", "tip: hand"), "robot: "),
    (("tip: tip", "locked: {elbow: 0}"), "robot: "),
]


def ends(scenario):
    robot = scenario.build_robot()
    return scenario.start_configuration(robot), scenario.goal_configurations(robot)


@pytest.mark.parametrize(
    ("change", "message", "fits"), [*((*row, None) for row in MALFORMED), *((*row, ends) for row in UNFIT)]
)
def test_errors_name_file_key_and_value(folder, change, message, fits):
    """Of the document when it is loaded, and of what does not fit the robot when that is asked for."""
    file = write(folder, MINIMAL.replace(*change))
    scenario = Scenario.load(file) if fits else None
    with pytest.raises(InputError) as caught:
        fits(scenario) if fits else Scenario.load(file)
    assert str(caught.value).startswith(f"{file}:")
    assert message in str(caught.value)


# --------------------------------------------------------------------------------------- against the robot


def test_configurations_by_order_or_by_name(folder, arm):
    text = MINIMAL.replace("[0, 0, 0]", "{joint3: 3e-1, joint1: 1, joint2: 2}")
    text = text.replace("{configuration: [1, 0, 0]}", "{configurations: [[1, 0, 0], [0, 1, 0]]}")
    scenario = Scenario.load(write(folder, text))
    assert scenario.start_configuration(arm).tolist() == [1, 2, 0.3]
    assert scenario.goal_configurations(arm).tolist() == [[1, 0, 0], [0, 1, 0]]


# --------------------------------------------------------------------------------------- those that ship


def test_scenarios_are_found_by_name_and_by_path(folder, monkeypatch):
    file = write(folder, MINIMAL)
    assert find_scenario(file) == file
    assert set(HAZARD) <= set(list_scenarios())
    assert find_scenario("planar3").name == "planar3.yaml"
    assert Scenario.load("planar3").file == find_scenario("planar3")
    with pytest.raises(UnknownNameError, match=r"unknown scenario file or name 'planar33'; did you mean 'planar3'"):
        Scenario.load("planar33")

    (folder / "scenarios").mkdir()
    shutil.copy(file, folder / "scenarios" / "planar3.yaml")
    monkeypatch.chdir(folder)
    assert find_scenario("planar3").resolve() == folder / "scenarios" / "planar3.yaml"


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenarios_are_sound_and_worth_planning(name):
    """Start and goal are free and away from what is dangerous; the straight way between them runs into it."""
    scenario = Scenario.load(FOLDER / f"{name}.yaml")
    robot = scenario.build_robot()
    checker = CollisionChecker(robot, scenario.scene)
    start = scenario.start_configuration(robot)
    goals = scenario.goal_configurations(robot)
    for q in (start, *goals):
        assert checker.colliding_pair(q) is None
    if scenario.goal.position is not None:
        tips = [np.linalg.norm(robot.tip_pose(q).translation - scenario.goal.position) for q in goals]
        assert min(tips) < scenario.goal.tolerance

    if name in HAZARD:
        assert not MotionProver(checker).is_free(start, goals[0])
        to_hazard = np.array([obstacle == HAZARD[name] for _, obstacle in checker.distance_names])
        at_ends = [checker.distances(q)[to_hazard].min() for q in (start, goals[0])]
        way = start + np.linspace(0, 1, 60)[:, None] * robot.difference(start, goals[0])
        assert min(at_ends) > 0.2
        assert min(checker.distances(q)[to_hazard].min() for q in way) < 0.02
