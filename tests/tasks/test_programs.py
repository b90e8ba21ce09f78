"""Programs: what is planned is closed, free by plain Pinocchio and coal, and the best of what can be finished."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import Box, InputError, plan_program
from safe_ompl.robot import Attachment
from safe_ompl.scene import Attach, Detach, Gripper, Scenario, list_scenarios
from safe_ompl.tasks import program_robot
from safe_ompl.tasks.workcell import Workcell

PATIENCE = 300.0  # [s], for a machine that does much else
DOWN = {"rpy": [np.pi, 0.0, 0.0]}
CUP = [["link7", "red"]]
TABLE, RED = {"size": [0.7, 1.2, 0.06]}, {"size": [0.08, 0.08, 0.08]}
STEPS = [
    {"move": {"grasp": "red", "back": 0.08}},
    {"line": {"grasp": "red", "touching": CUP}},
    {"attach": "red"},
    {"line": {"up": 0.1, "touching": [["red", "table"]]}},
    {"move": {"place": "red", "up": 0.06}},
    {"line": {"place": "red", "touching": [["red", "table"]]}},
    {"detach": "red"},
    {"wait": {"time": 0.2, "touching": CUP}},
    {"line": {"back": 0.08, "touching": CUP}},
]
PLACES = [{"position": [0.45, -0.25, 0.03]}, {"position": [0.55, -0.3, 0.03]}]


def scenario(steps=STEPS, places=PLACES, grasps=({"position": [0.0, 0.0, 0.04], **DOWN},), more=(), **keys):
    obstacles = [
        {"name": "table", "box": TABLE, "position": [0.45, 0.0, -0.04]},
        {"name": "red", "box": RED, "position": [0.4, 0.3, 0.03]},
    ]
    program = {"grasps": {"red": list(grasps)}, "places": {"red": list(places)}, "steps": list(steps)}
    scene = {"obstacles": [*obstacles, *more]}
    start = [0.0, -0.6, 0.0, 0.9, 0.0, 1.5, 0.0]
    return Scenario.from_mapping(
        {"name": "try", "robot": "xarm7", "start": start, "scene": scene, "program": program, **keys}
    )


@cache
def planned(name=None):
    given = scenario() if name is None else Scenario.load(list_scenarios(programs=True)[name])
    found = plan_program(given, time=PATIENCE)
    assert found, found.why
    return found


@pytest.fixture(params=[None, "panda_kitting", "pandas_handover"])
def result(request):
    return planned(request.param)


def judged(result):
    """Yield step, what is held by which tip, and penetrations [m] by pair of bodies, at many instants.

    Plain Pinocchio and coal find them.
    """
    scenario, robot = result.scenario, result.stretches[0].robot
    model, bodies = robot.shared.model, robot.shared.collision_model
    data, placed = model.createData(), bodies.createData()
    links = robot.shared.body_links
    poses = {item.name: item.pose.se3 for item in scenario.scene}
    parts = {item.name: item.shape.parts() for item in scenario.scene}
    held, q, left = {}, result.stretches[0].motion.knots[0], list(result.stretches)

    def at(values):
        pin.forwardKinematics(model, data, robot.pinocchio_configuration(values))
        pin.updateFramePlacements(model, data)
        pin.updateGeometryPlacements(model, data, bodies, placed)

    for k, step in enumerate(scenario.program.steps):
        at(q)
        if isinstance(step, Attach):
            tip = robot.tip if step.arm is None else f"{step.arm}_panda_hand_tcp"
            held[step.object] = tip, data.oMf[model.getFrameId(tip)].inverse() * poses[step.object]
        elif isinstance(step, Detach):
            del held[step.object]
        while left and left[0].step == k:
            motion = left.pop(0).motion
            for values in motion.at(np.linspace(0.0, motion.duration, 80)):
                at(values)
                for name, (tip, grasp) in held.items():
                    poses[name] = data.oMf[model.getFrameId(tip)] * grasp
                things = [(name, part.geometry, poses[name] * part.placement) for name in parts for part in parts[name]]
                robots = [
                    (link, body.geometry, place)
                    for link, body, place in zip(links, bodies.geometryObjects, placed.oMg, strict=True)
                ]
                pairs = [(a, b) for a in robots for b in things if not fixed(bodies, links, a[0])]
                pairs += [(a, b) for i, a in enumerate(things) for b in things[:i] if {a[0], b[0]} & set(held)]
                yield (
                    k,
                    {name: tip for name, (tip, _) in held.items()},
                    {(a[0], b[0]): -apart(a, b) for a, b in pairs if apart(a, b) < 0},
                )
            q = motion.knots[-1]
    assert not left


def fixed(bodies, links, link):
    return bodies.geometryObjects[links.index(link)].parentJoint == 0


def apart(a, b):
    request, found = coal.DistanceRequest(), coal.DistanceResult()
    return coal.distance(a[1], as_coal(a[2]), b[1], as_coal(b[2]), request, found)


def as_coal(pose):
    return coal.Transform3s(pose.rotation, pose.translation)


def test_stretches_meet(result):
    for before, after in pairwise(result.stretches):
        assert after.begin == pytest.approx(before.begin + before.motion.duration)
        assert np.abs(before.motion.knots[-1] - after.motion.knots[0]).max() < 1e-9
    assert result.motion.duration == pytest.approx(result.duration)
    assert all(stretch.check for stretch in result.stretches)


def test_nothing_touches_but_what_may(result):
    """Steps say which pairs may touch, and how deep; hands touch what they hold, or are about to let go of."""
    steps = result.scenario.program.steps
    for k, held, found in judged(result):
        said = {frozenset(pair) for pair in getattr(steps[k], "touching", ())}
        for (link, thing), depth in found.items():
            fingers = "finger" in link and thing in held and held[thing].startswith(link.partition("panda")[0])
            grasping = thing in held and link in ("link7", "left_panda_hand", "right_panda_hand", "panda_hand")
            assert fingers or grasping or frozenset((link, thing)) in said, (k, link, thing, depth)
            assert grasping or depth < getattr(steps[k], "depth", 1e-3) + 1e-6, (k, link, thing, depth)


def test_objects_are_where_places_say():
    found = planned()
    places = [place.se3.translation for place in found.scenario.program.places["red"]]
    where = found.stretches[-1].scene["red"].pose.se3.translation
    assert min(np.abs(where - place).max() for place in places) < 1e-3
    assert found.choices == ("place 1 of red",) or found.choices == ("place 2 of red",)
    assert found.motion.n == found.stretches[0].robot.n


def test_what_was_let_go_may_be_placed_elsewhere():
    found = plan_program(scenario([*STEPS, *STEPS]), time=PATIENCE)
    assert found, found.why
    assert len(found.choices) == 2


def test_a_choice_that_cannot_be_finished_is_not_taken():
    """A bar above the nearer place leaves room for the end of the move before it, not for the line down."""
    free = plan_program(scenario(places=PLACES[:1]))
    bar = {"name": "bar", "box": {"size": [0.03, 0.03, 0.005]}, "position": [0.45, -0.25, 0.0]}
    blocked = plan_program(scenario(more=[bar], places=PLACES[:1]))
    assert free
    assert not blocked
    assert blocked.why.startswith("step 6 (line place red)")
    assert "bar" in blocked.why
    assert max(stretch.step for stretch in blocked.stretches) == 4
    found = plan_program(scenario(more=[bar]))
    assert found
    assert found.choices == ("place 2 of red",)


FAR_PLACE = {"position": [3.0, 0.0, 0.03]}


def test_a_choice_out_of_reach_does_not_hide_others():
    found = plan_program(scenario(places=[FAR_PLACE, PLACES[0]]))
    assert found
    assert found.choices == ("place 2 of red",)


NOT_SOLVED = [
    (
        [*STEPS[:3], {"wait": 0.2}],
        "step 4 (wait time 0.2): 'red' touches 'table' where it begins: "
        "if they may touch on this step, give it `touching: [[red, table]]`",
    ),
    ([*STEPS[2:4], {"move": {"place": "red"}}], "step 3 (move place red): no configuration has its tip there"),
    ([STEPS[4]], "step 1 (move place red up 0.06): 'red' is not held"),
    ([STEPS[6]], "step 1 (detach object red): 'red' is not held"),
    ([STEPS[2], STEPS[2]], "step 2 (attach object red): 'red' is held already"),
    ([STEPS[2], STEPS[0]], "step 2 (move grasp red back 0.08): 'red' is held already"),
]


@pytest.mark.parametrize(("steps", "why"), NOT_SOLVED, ids=range(len(NOT_SOLVED)))
def test_why_a_step_cannot_be_planned(steps, why):
    found = plan_program(scenario(steps, places=[FAR_PLACE]), time=PATIENCE)
    assert found.why == why
    assert f"not solved: {why}" in str(found)


def test_a_contact_of_a_step_leaves_the_fingers_as_deep_as_they_were():
    given = scenario([STEPS[2], {"wait": {"time": 0.1, "touching": [["link6", "red"]], "depth": 0.002}}])
    cell = Workcell(given)
    held = Attachment("red", Box(RED["size"]), cell.robot.tip, touch_links=("link7",), touch_depth=0.01)
    (item,) = cell.during(given.program.steps[1], cell.begin._replace(held=(held,))).held
    assert (item.touch_links, item.touch_depth) == (("link7", "link6"), 0.01)


CHOICES = {  # the first arm holds what the other one grasps; only the third grasp fits the place
    "pandas_handover": ("grasp 1 of rod", "grasp 2 of rod"),
    "panda_kitting": ("grasp 3 of part",),
}


@pytest.mark.parametrize("name", CHOICES)
def test_grasps_that_fit_are_taken(name):
    assert planned(name).choices[: len(CHOICES[name])] == CHOICES[name]


def test_same_seed_same_motion():
    again = plan_program(scenario())
    assert np.array_equal(again.motion.coefficients, planned().motion.coefficients)


def test_a_tube_by_joint_may_name_joints_of_grippers():
    given = Scenario.load(list_scenarios(programs=True)["panda_pick_place"])
    joints = {f"panda_joint{k}": 0.001 for k in range(1, 8)}
    steps = tuple(
        replace(step, depth=0.01) if getattr(step, "touching", ()) else step for step in given.program.steps[:4]
    )
    given = replace(given, program=replace(given.program, steps=steps))
    given = replace(given, limits=replace(given.limits, tube={**joints, "panda_finger_joint1": 0.0005}))
    found = plan_program(given, time=PATIENCE)
    assert found, found.why
    assert isinstance(steps[2], Gripper)
    assert found.stretches[2].check.separation.tube[-1] == 0.0005


WRONG = [
    ({"steps": [{"attach": "blue"}]}, "program.steps[0].attach.object: unknown object 'blue'"),
    ({"steps": [{"line": {"place": "red"}}], "places": ()}, "program.places.red: "),
    ({"steps": [{"line": {"up": 0.1, "touching": [["red", "table"]]}}]}, "program.steps[0].line.touching: unknown"),
    ({"steps": [STEPS[2], {"line": {"up": 0.1, "touching": [["red", "red"]]}}]}, "program.steps[1].line.touching: "),
    ({"steps": [STEPS[2], STEPS[6], STEPS[3]]}, "program.steps[2].line.touching: unknown link or object 'red'"),
    (
        {"steps": [{"line": {"up": 0.1, "touching": [["link7", "table"]], "depth": 0.03}}]},
        "program.steps[0].line.touching: 'table', 30 mm deep: size: must be",
    ),
    ({"steps": [{"move": {"position": [0.4, 0, 0.4], "arm": "left"}}]}, "program.steps[0].move.arm: unknown robot"),
    ({"steps": [{"gripper": {"joints": {"finger": 0.1}}}]}, "program.steps[0].gripper.joints: unknown joint"),
    ({"steps": [{"move": {}}]}, "give exactly one target; found none"),
    ({"steps": [{"wait": -1.0}]}, "program.steps[0].wait.time: "),
    ({"steps": [{"walk": 1.0}]}, "program.steps[0].walk: unknown key; valid keys: move"),
    ({"limits": {"tool": {"angle": 0.1}}}, "limits.tool.axis: missing"),
]


@pytest.mark.parametrize(("given", "said"), WRONG, ids=range(len(WRONG)))
def test_bad_input_is_one_line(given, said):
    for use in (plan_program, program_robot):
        with pytest.raises(InputError) as caught:
            use(scenario(**given))
        assert said in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_gripper_stays_within_its_limits():
    given = Scenario.load(list_scenarios(programs=True)["panda_pick_place"])
    steps = (replace(given.program.steps[2], joints={"panda_finger_joint1": 0.05}),)
    with pytest.raises(InputError, match=r"gripper\.joints: joint 'panda_finger_joint1' = 0\.05"):
        plan_program(replace(given, program=replace(given.program, steps=steps)))


def test_shipped_programs_are_read_as_they_are_written(tmp_path):
    for name, file in list_scenarios(programs=True).items():
        read = Scenario.load(file)
        assert 8 <= len(read.program.steps) <= 15
        assert read.name == name
        read.save(tmp_path / "again.yaml")
        assert Scenario.load(tmp_path / "again.yaml") == read
