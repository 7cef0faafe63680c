"""Recording of one episode of a policy."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from cablebot_gym.envs import check_robot
from cablebot_gym.evaluation.constraints import DLCCMonitor, Verdict
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import as_policy, load_policy, name_of
from cablebot_gym.policies.protocol import checked_actions, reset_policy
from cablebot_gym.task import Task
from cablebot_gym.utils.files import atomic_write

SUFFIXES = (".npz", ".csv")
"""File name suffixes of recordings."""


def record_rollout(
    policy: Any,
    env_id: str,
    *,
    payload: float = 0.0,
    seed: int = 0,
    name: str | None = None,
    on_step: Callable[[DLCCMonitor], None] = lambda env: None,
    progress: Callable[[int, int], None] = lambda done, expected: None,
    **keywords: Any,
) -> Rollout:
    """Records one episode over the full motion, or until the environment terminates it.

    Args:
        policy: an object with ``predict``, a callable, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        payload: payload on the platform [kg].
        seed: seed of the environment.
        name: name of the policy in messages; None for its own name.
        on_step: callback with the environment after the reset and after every step.
        progress: callback with the number of finished and of expected control steps, after the reset and after every
            step.
        keywords: keywords of the environment.

    Raises:
        ValueError: if an argument is invalid.
        cablebot_gym.policies.protocol.PolicyError: if the policy raises or returns anything but finite actions.
    """
    check_robot(env_id, keywords.get("robot"))
    env = DLCCMonitor(gym.make(env_id, max_episode_steps=-1, payload=payload, **keywords))
    try:
        observation, info = env.reset(seed=seed)
        on_step(env)
        task: Task = env.get_wrapper_attr("task")
        loaded = load_policy(policy, task.robot) if isinstance(policy, str) else as_policy(policy)
        task.check_motion()
        progress(0, task.steps)
        label = name or name_of(policy)
        reset_policy(loaded, label, lambda: (task,))
        layout = env.get_wrapper_attr("layout")
        rows: list[dict[str, Any]] = []
        state, start, terminated = None, np.ones(1, np.bool_), False
        while len(rows) < task.steps and not terminated:
            action, state = checked_actions(
                loaded,
                label,
                observation[None],
                state,
                start,
                cables=task.robot.cables,
                payloads=np.array([payload]),
                time=len(rows) / task.control_frequency,
            )
            start = np.zeros(1, np.bool_)
            observation, reward, terminated, _, info = env.step(action[0])
            on_step(env)
            blocks = layout.split(observation)
            motion = {name: blocks[name].copy() for name in ("pose", "velocity", "reference_pose")}
            numbers = {name: value for name, value in info.items() if not isinstance(value, str)}
            rows.append({"time": numbers.pop("time")} | motion | numbers | {"reward": reward})
            progress(len(rows), task.steps)
        arrays = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return Rollout(arrays=arrays, verdict=env.verdict, reason=str(info["termination_reason"]))
    finally:
        env.close()


class Rollout:
    """A recorded episode.

    Args:
        arrays: arrays by name, with the control steps as first axis, in SI units and radians. Pose, velocity, reference
            and errors are those at ``time``, the end of the step. Commanded action, torques, tensions and motor speeds
            are those at ``action_time``, the start of the step.
        verdict: verdict under the task criterion.
        reason: reason of an early termination, or "".
    """

    def __init__(self, *, arrays: dict[str, Array], verdict: Verdict, reason: str) -> None:
        self.arrays, self.verdict, self.reason = arrays, verdict, reason

    def save(self, path: Path) -> None:
        """Writes ``.npz`` (the arrays by name) or ``.csv`` (one column per number, vectors as name_1, name_2, …).

        Raises:
            ValueError: if the path has another suffix.
        """
        check_suffix(path)
        atomic_write(path, self._write_npz if path.suffix == ".npz" else self._write_csv)

    def _write_npz(self, path: Path) -> None:
        np.savez_compressed(path, allow_pickle=False, **self.arrays)

    def _write_csv(self, path: Path) -> None:
        names, columns = [], []
        for name, array in self.arrays.items():
            flat = array.reshape(len(array), -1).astype(float)
            names += [name] if array.ndim == 1 else [f"{name}_{index + 1}" for index in range(flat.shape[1])]
            columns.append(flat)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(names)
            writer.writerows(np.concatenate(columns, axis=1).tolist())


def check_suffix(path: Path) -> None:
    """Checks the suffix of a recording's path.

    Raises:
        ValueError: if the suffix is unknown. The message lists the valid ones.
    """
    if path.suffix not in SUFFIXES:
        raise ValueError(f"cannot record to {str(path)!r}: the file name must end in {' or '.join(SUFFIXES)}")
