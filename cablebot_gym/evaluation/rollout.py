"""Recording of episodes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs import TERMINATION_REASONS
from cablebot_gym.envs.vector import CableBotVectorEnv
from cablebot_gym.evaluation.batch import Batch, EpisodeSpec, StepCount
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.evaluation.judge import Verdict
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import Wrapper
from cablebot_gym.rendering.moment import Moment
from cablebot_gym.robots import COORDINATE_NAMES
from cablebot_gym.task import Task
from cablebot_gym.utils.checks import number
from cablebot_gym.utils.console import Progress, chosen_progress
from cablebot_gym.utils.csv_table import column_name
from cablebot_gym.utils.files import atomic_write, write_csv
from cablebot_gym.utils.results import Printed

SUFFIXES = (".npz", ".csv")
"""File name suffixes of recordings."""

_POSES = ("pose", "true_pose", "reference_pose", "velocity")

_UNITS = {
    "s": "time action_time",
    "kg": "payload",
    "m": "tracking_error tracking_error_peak",
    "rad": "rotation_error rotation_error_peak motor_angle orientation",
    "rad/s": "motor_speeds motor_speed angular_rate",
    "m/s²": "specific_force",
    "N": "tensions least_tensions largest_tensions",
    "N·m": "torques torque_margin",
}
"""Names of arrays by unit."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Rollout(Printed):
    """A recorded episode. It has a moment at the start and one after every control step; ``len`` is
    their number."""

    task: Task
    """Public task of the episode."""
    payload: float
    """True payload [kg]."""
    stall_torque: Array
    """True stall torques τ_s, (m,) [N·m]."""
    start: Mapping[str, Array]
    """State after the reset, by name."""
    arrays: Mapping[str, Array]
    """Arrays by name, with the control steps as first axis, in SI units and radians. Pose,
    velocity, reference and errors are those at ``time``, the end of the step. ``pose`` and
    ``velocity`` are measured, ``true_pose`` is exact. Flexible robots have the measured
    ``motor_angle``, too. Commanded action, torques, tensions and motor speeds are those at
    ``action_time``, the start of the step."""
    verdict: Verdict
    """Verdict under the criterion."""
    reason: str
    """Reason of an early termination by the environment, one of
    :data:`~cablebot_gym.envs.TERMINATION_REASONS`."""

    def __len__(self) -> int:
        return 1 + len(self.arrays["time"])

    def __str__(self) -> str:
        robot = self.task.robot.name
        motion = self.task.trajectory.name
        return (
            f"{robot}, {motion}, {self.payload:g} kg, {len(self)} moments: {self.verdict.outcome}"
        )

    def moment(self, index: int) -> Moment:
        """Moment 0 is the start; moment k is the end of control step k; moment −1 is the last
        one."""
        index = range(len(self))[index]
        state = (
            {name: values[index - 1] for name, values in self.arrays.items()}
            if index
            else self.start
        )
        return Moment.from_info(self.task.robot, self.stall_torque, state["true_pose"], state)

    def save(self, path: str | Path) -> None:
        """Writes ``.npz`` (the arrays by name) or ``.csv``: one column per number with its unit,
        vectors as ``tensions_1 [N]``, poses as ``pose_x [m]``, and the codes of
        ``termination_reason`` in place of a unit.

        Raises:
            ValueError: if the path has another suffix.
        """
        path = Path(path)
        check_suffix(path)
        if path.suffix == ".csv":
            self._write_csv(path)
            return
        arrays = self.arrays
        atomic_write(path, lambda file: np.savez_compressed(file, allow_pickle=False, **arrays))

    def _write_csv(self, path: Path) -> None:
        head: list[str] = []
        columns = []
        for name, array in self.arrays.items():
            flat = array.reshape(len(array), -1).astype(float)
            head += self._columns(name, array)
            columns.append(flat)
        write_csv(path, [head, *np.concatenate(columns, axis=1).tolist()])

    def _columns(self, name: str, array: Array) -> list[str]:
        """Names of the columns of an array, with their units."""
        robot = self.task.robot
        if name in _POSES:
            units = ["m"] * robot.dimensions + ["rad"] * 3
            per_time = ""
            if name == "velocity":
                per_time = "/s"
            return [
                f"{name}_{column_name(letter)} [{unit}{per_time}]"
                for letter, unit in zip(COORDINATE_NAMES[robot.kind], units, strict=False)
            ]
        unit = ""
        for candidate, names in _UNITS.items():
            if name.removeprefix("measured_") in names.split():
                unit = f" [{candidate}]"
        if name == "termination_reason":
            codes = [f"{code}={reason}" for code, reason in enumerate(TERMINATION_REASONS) if code]
            unit = f" [{' '.join(codes)}]"
        if array.ndim == 1:
            return [f"{name}{unit}"]
        return [f"{name}_{index + 1}{unit}" for index in range(array.shape[1])]


class Recorder:
    """Observer that records some episodes of a batch.

    Args:
        indices: indices of the recorded environments, which are the rows of the batch.
        names: names of the recorded arrays; None for all.
    """

    def __init__(self, indices: Sequence[int], names: Collection[str] | None = None) -> None:
        self._indices = list(indices)
        self._names = names
        self._states: list[dict[str, Array]] = []
        self._running: list[NDArray[np.bool_]] = []
        self._reason = np.zeros(len(self._indices), np.int64)

    def start(self, env: CableBotVectorEnv, observation: Array, info: dict[str, Any]) -> None:
        """Records the state after the reset."""
        self._env = env
        tasks = env.tasks
        self._tasks = [tasks[index] for index in self._indices]
        self._stall_torque = env.truth["motor_strength"]
        self._record(observation, np.zeros(len(observation)), info)

    def step(
        self, observation: Array, reward: Array, info: dict[str, Any], running: NDArray[np.bool_]
    ) -> None:
        """Records a step of the episodes that are running."""
        self._running.append(running[self._indices])
        self._reason = np.where(
            self._running[-1], info["termination_reason"][self._indices], self._reason
        )
        self._record(observation, reward, info)

    def _record(self, observation: Array, reward: Array, info: dict[str, Any]) -> None:
        slices = self._env.layout.slices()
        measurement = self._env.settings.measurement
        robot = self._env.settings.robot
        motion = {"reference_pose": observation[:, slices["reference_pose"]]}
        if measurement.winches:  # "tensions" are the true ones of the info
            motion |= {
                f"measured_{name}": observation[:, slices[name]]
                for name in measurement.sizes(robot)
            }
        else:
            motion = {name: observation[:, slices[name]] for name in ("pose", "velocity")} | motion
            if robot.flexible:
                motion["motor_angle"] = observation[:, slices["motor_angle"]]
        state = {
            "time": info["time"],
            **motion,
            **info,
            "reward": reward,
            "true_pose": self._env.pose,
        }
        names = state.keys() if self._names is None else self._names
        self._states.append(
            {name: values[self._indices] for name, values in state.items() if name in names}
        )

    def rollouts(self, verdicts: Sequence[Verdict]) -> list[Rollout]:
        """The recorded episodes.

        Args:
            verdicts: verdicts of all rows.
        """
        running = np.array(self._running).reshape(-1, len(self._indices))
        series = {
            name: np.array([state[name] for state in self._states]) for name in self._states[0]
        }
        rollouts = []
        for row, index in enumerate(self._indices):
            steps = slice(1, 1 + np.count_nonzero(running[:, row]))
            rollouts.append(
                Rollout(
                    task=self._tasks[row],
                    payload=verdicts[index].payload,
                    stall_torque=self._stall_torque[index],
                    start={name: values[0, row] for name, values in series.items()},
                    arrays={name: values[steps, row] for name, values in series.items()},
                    verdict=verdicts[index],
                    reason=TERMINATION_REASONS[self._reason[row]],
                )
            )
        return rollouts


def record(
    batch: Batch,
    rows: Sequence[EpisodeSpec],
    names: Collection[str] | None = None,
    count: StepCount | None = None,
) -> list[Rollout]:
    """Records episodes over the full motion.

    Args:
        batch: policy and conditions.
        rows: the episodes.
        names: names of the recorded arrays; None for all.
        count: counts the finished or skipped control steps.
    """
    groups = [rows]
    if batch.policy.alone:
        groups = [[row] for row in rows]
    rollouts = []
    for group in groups:
        recorder = Recorder(range(len(group)), names)
        verdicts = batch.run(group, observer=recorder, count=count, full_motion=True)
        rollouts += recorder.rollouts(verdicts)
    return rollouts


def record_rollout(
    policy: Any,
    env_id: str,
    *,
    payload: float = 0.0,
    name: str | None = None,
    wrappers: Sequence[Wrapper] = (),
    progress: Progress | bool | None = None,
    noise_seed: int | None = None,
    **conditions: Any,
) -> Rollout:
    """Records one episode over the full motion, or until the environment terminates it.

    Args:
        policy: an object with ``predict``, a callable, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        payload: nominal payload [kg].
        name: name of the policy in messages; None for its own name.
        wrappers: wrappers of the training of the policy, the innermost first, see
            :data:`cablebot_gym.policies.wrappers.Wrapper`.
        progress: callback after the reset and after every control step; True shows it on standard
            error.
        noise_seed: seed of the sensor noise and the wrench; None for that of an evaluation,
            :func:`~cablebot_gym.evaluation.batch.noise_seed`.
        conditions: ``criterion`` of the verdict, ``seed`` of the environment, ``uncertainty``,
            ``error_bounds``, ``robot`` and keywords of the environment, see
            :class:`~cablebot_gym.evaluation.conditions.Conditions`.

    Raises:
        ValueError: if an argument is invalid.
        cablebot_gym.policies.protocol.PolicyError: if the policy raises or returns anything but
            finite actions.
    """
    payload = number("payload", payload, least=0, unit="kg")
    shared = Conditions.of(env_id, record_rollout, draws=1, **conditions)
    batch = Batch(policy, shared, name=name, wrappers=wrappers)
    with chosen_progress(progress, f"{batch.policy.name} on {env_id}", "steps") as step:
        count = StepCount(step, batch.task.steps)
        count.add(0)
        rows = [EpisodeSpec(payload, shared.seed, noise_seed=noise_seed)]
        (rollout,) = record(batch, rows, count=count)
    return rollout


def check_suffix(path: str | Path, suffixes: Sequence[str] = SUFFIXES) -> None:
    """Checks the suffix of a recording's path.

    Raises:
        ValueError: if the suffix is unknown. The message lists the valid ones.
    """
    if Path(path).suffix not in suffixes:
        raise ValueError(
            f"cannot record to {str(path)!r}: the file name must end in {' or '.join(suffixes)}"
        )
