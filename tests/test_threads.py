"""Threads that share a model get the answers that one thread gets alone."""

import sys
import threading
from time import sleep

import numpy as np
import pinocchio as pin
import pytest
from ompl import geometric as og

from safe_ompl import Box, CertifiedDanger, DangerField, KinetostaticField, Obstacle, Pose, Scene
from safe_ompl.collision import CollisionChecker, MotionProver, PairDistances, PairSet
from safe_ompl.geometry import DISTANCE_ERROR
from safe_ompl.planning.ompl import CertifiedMotionValidator, CollisionFreeValidity
from safe_ompl.robot import StateBridge, joint_space

THREADS, NUMBER = 3, 60


@pytest.fixture
def restless(monkeypatch):
    """Let other threads run wherever a query has written what it is to read again."""
    switch = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)

    def with_pauses(holder, name):
        function = getattr(holder, name)

        def paused(*args, **kwargs):
            sleep(0)
            found = function(*args, **kwargs)
            sleep(0)
            return found

        monkeypatch.setattr(holder, name, paused)

    with_pauses(pin, "updateGeometryPlacements")
    with_pauses(PairSet, "touching")
    with_pauses(MotionProver, "_by_bounds")
    yield
    sys.setswitchinterval(switch)


@pytest.fixture(scope="module")
def scene():
    post = Obstacle("post", Box((0.1, 0.1, 1.0)), Pose((0.45, 0.0, 0.5)))
    return Scene([post, Obstacle("shelf", Box((0.6, 0.3, 0.05)), Pose((0.0, 0.6, 0.6)), weight=1.0)])


def questions(scene, robot):
    """Return questions by the name of what is asked; each takes a configuration and its neighbour."""
    checker = CollisionChecker(robot, scene)
    motion, field = MotionProver(checker), DangerField.of_scene(robot, scene)
    proven, proximity = CertifiedDanger(field), PairDistances(checker, 0.3)
    setup = og.SimpleSetup(joint_space(robot))
    si, bridge = setup.getSpaceInformation(), StateBridge(setup.getStateSpace())
    validity, validator = CollisionFreeValidity(si, checker), CertifiedMotionValidator(si, checker)
    setup.setStateValidityChecker(validity)
    si.setMotionValidator(validator)
    qd = np.ones(robot.n)

    def states(*configurations):
        made = [setup.getStateSpace().allocState() for _ in configurations]
        for q, state in zip(configurations, made, strict=True):
            bridge.write(q, state)
        return made

    return {
        "in_collision": lambda a, b: checker.in_collision(a),
        "within_margins": lambda a, b: checker.pairs.within_margins(a, checker.pairs.margins(0.05)),
        "colliding_pair": lambda a, b: checker.colliding_pair(a),
        "clearance": lambda a, b: checker.clearance(a).distance,
        "pair_distances": lambda a, b: checker.pair_distances(a).tolist(),
        "is_free": motion.is_free,
        "is_free with margins": lambda a, b: motion.is_free(a, b, float(abs(a[0])) / 50),
        "check": lambda a, b: motion.check(a, b).verdict.value,
        "least distance": lambda a, b: proximity.least(np.array([a, b]), 0.3),
        "witnesses": lambda a, b: proximity.near(np.array([a, b]), 0.3).pairs.tolist(),
        "danger": lambda a, b: field.value(a),
        "gradient": lambda a, b: field.gradient(a).tolist(),
        "danger in motion": lambda a, b: KinetostaticField(field).value(a, qd),
        "proven danger": lambda a, b: proven.of_path(np.array([a, b])).upper,
        "isValid": lambda a, b: validity.isValid(*states(a)),
        "checkMotion": lambda a, b: validator.checkMotion(*states(a, b)),
        "tip_pose": lambda a, b: robot.tip_pose(a).homogeneous.tolist(),
    }


def same(answer, other):
    """Return whether two answers are the same, but for what coal is off, which depends on what it was asked before."""
    if isinstance(answer, bool | str | tuple | None):
        return answer == other
    return np.shape(answer) == np.shape(other) and np.allclose(answer, other, atol=2 * DISTANCE_ERROR)


def in_threads(function, number=THREADS):
    """Return what a function of the thread's number returns in each of some threads."""
    found, errors = [None] * number, []

    def run(k):
        try:
            found[k] = function(k)
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=run, args=(k,)) for k in range(number)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        raise errors[0]
    return found


@pytest.mark.parametrize("name", ["panda", "kinova"])
def test_one_model_answers_several_threads_as_it_answers_one(robot_named, scene, restless, name):
    """Scratch memory that threads shared made one in a hundred verdicts false, and some of them FREE."""
    robot = robot_named(name)
    rng = np.random.default_rng(0)
    reach = np.where(robot.continuous, np.pi, 1.0)
    Q = rng.uniform(np.maximum(robot.lower, -reach), np.minimum(robot.upper, reach), (NUMBER, robot.n))
    edges = [(a, a + 0.2 * (b - a)) for a, b in zip(Q, np.roll(Q, 1, axis=0), strict=True)]
    asked = questions(scene, robot)
    alone = {key: [ask(a, b) for a, b in edges] for key, ask in asked.items()}
    assert {True, False} <= set(alone["in_collision"]) & set(alone["is_free"])

    def run(k):  # each starts elsewhere, so that no two ask the same
        order = np.roll(np.arange(NUMBER), k * NUMBER // THREADS).tolist()
        return {
            key: [(i, answer) for i in order if not same(answer := ask(*edges[i]), alone[key][i])]
            for key, ask in asked.items()
        }

    for wrong in in_threads(run):
        assert not {key: found for key, found in wrong.items() if found}


def test_a_proof_is_of_one_scene_though_another_thread_moves_the_obstacle(panda, monkeypatch):
    """The obstacle changes sides in the middle of a proof: each half of the edge would be free when it is looked at."""
    start, end = np.array([-1.2, 0.6, 0, -1.5, 0, 2.0, 0]), np.array([1.2, 0.6, 0, -1.5, 0, 2.0, 0])
    box = Obstacle("box", Box((0.1, 0.1, 1.6)), Pose((0.35, 0.35, 0.4)))
    left = Scene([box])
    right = left.moved({"box": Pose((0.35, -0.35, 0.4))})
    checker = CollisionChecker(panda, right, movable=["box"])
    assert not MotionProver(checker).is_free(start, end)
    checker.move(left)
    motion = MotionProver(checker)
    assert not motion.is_free(start, end)
    bounds_of, moves = PairSet.bounds.fget, iter([right])

    class MovedMeanwhile:
        """Proves an edge in one scene, and finds the other one when the proof has ended."""

        def __init__(self, bounds):
            self._bounds = bounds

        def __getattr__(self, name):
            return getattr(self._bounds, name)

        def prove_edge(self, *args):
            found = self._bounds.prove_edge(*args)
            scene = next(moves, None)
            if scene is not None:
                in_threads(lambda k: checker.move(scene), 1)
            return found

    far = left.moved({"box": Pose((3.0, 3.0, 0.4))})
    checker.move(far)
    monkeypatch.setattr(PairSet, "bounds", property(lambda pairs: MovedMeanwhile(bounds_of(pairs))))
    assert not motion.is_free(start, end), "free where the box was, and not where it is"
    assert not motion.is_free(start, end)


def test_threads_ask_while_another_one_moves_obstacles(panda, restless):
    """Every answer is that of one of the two scenes."""
    near = Scene([Obstacle("box", Box((0.2, 0.2, 0.2)), Pose((0.4, 0.1, 0.5)), weight=1.0)])
    scenes = near, near.moved({"box": Pose((2.0, 2.0, 2.0))})
    rng = np.random.default_rng(1)
    Q = rng.uniform(-1, 1, (20, panda.n)).clip(panda.lower, panda.upper)
    alone = []
    for scene in scenes:
        checker, field = CollisionChecker(panda, scene, movable=["box"]), DangerField.of_scene(panda, scene)
        bounds = CertifiedDanger(field)
        alone.append([(checker.in_collision(q), bounds.of_path(q[None]).upper) for q in Q])
    checker, field = CollisionChecker(panda, near, movable=["box"]), DangerField.of_scene(panda, near)
    bounds, asking = CertifiedDanger(field), threading.Event()

    def run(k):
        if k:
            found = [(i, checker.in_collision(Q[i]), bounds.of_path(Q[i][None]).upper) for i in range(len(Q))]
            asking.set()
            return found
        while not asking.is_set():
            for scene in reversed(scenes):
                checker.move(scene)
                field.move(scene)
        return []

    for answers in in_threads(run):
        for i, touches, danger in answers:
            assert touches in {found[i][0] for found in alone}
            assert danger in {found[i][1] for found in alone}
