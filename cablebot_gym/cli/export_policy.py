"""``cablebot export-policy``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cablebot_gym.cli.options import EnvId, PolicyName, TaskOptions, robot_of
from cablebot_gym.utils.console import print_table

if TYPE_CHECKING:
    from cablebot_gym.evaluation.rollout import Rollout
    from cablebot_gym.policies import LoadedPolicy
    from cablebot_gym.policies.onnx import OnnxPolicy
    from cablebot_gym.policies.onnx_export import ExportableModel


def export_policy(
    *,
    env_id: EnvId,
    policy: PolicyName,
    out: Annotated[Path, "File to write, ending in .onnx."],
    normalize: Annotated[
        str | None,
        "File with the statistics of VecNormalize. The default is vecnormalize.pkl beside the model.",
    ] = None,
    tolerance: Annotated[
        float, "Largest difference of positions between the file and the model in float64 [mm]."
    ] = 1e-3,
    task: TaskOptions,
) -> None:
    """Export a model of Stable-Baselines3 as one ONNX file with its scaling inside.

    The file takes the observation of the environment and returns the deterministic action, in
    float64. The command simulates one motion with the file, with the model in float64, and with the
    model as it is, in float32. It shows how far actions and positions differ, and the time of an
    action on one core. If the file and the model in float64 differ by more than --tolerance, it
    writes no file. `--policy policy.onnx` is then a policy of all commands.

    Example: cablebot export-policy CableBot-Planar-v0 --policy model.zip --out policy.onnx
    """
    from cablebot_gym.policies import PolicySpec, load
    from cablebot_gym.policies.onnx import OnnxPolicy
    from cablebot_gym.policies.onnx_export import ExportableModel, import_onnx, not_exportable
    from cablebot_gym.utils.checks import number
    from cablebot_gym.utils.files import atomic_write, check_writable_file

    import_onnx()
    number("--tolerance", tolerance, least=0, unit="mm")
    if out.suffix != ".onnx":
        raise ValueError(f"--out must end in .onnx, not {out.name!r}")
    check_writable_file(out)
    if PolicySpec.parse(policy).kind != "file":
        raise not_exportable(policy, "it is no model in a file")
    robot = robot_of(env_id, task)
    wrappers = []
    if normalize is not None:
        wrappers.append(normalize)
    loaded = load(policy, robot, wrappers=wrappers)
    model = ExportableModel(policy, loaded.policy, robot)
    period = 1 / task.control_frequency
    file = model.to_onnx(env_id=env_id, control_period=f"{period:g} s")
    _compare(model, loaded, OnnxPolicy(file), env_id, task, tolerance)
    atomic_write(out, lambda path: path.write_bytes(file))
    print(f"wrote {out}, {len(file) / 1000:.3g} kB")


def _compare(
    model: ExportableModel,
    original: LoadedPolicy,
    exported: OnnxPolicy,
    env_id: str,
    task: TaskOptions,
    tolerance: float,
) -> None:
    """Simulates a motion with a file and its model, and prints their differences and the times of
    the file.

    Raises:
        ValueError: if the file and the model in float64 differ by more than the tolerance [mm].
    """
    import numpy as np

    from cablebot_gym.evaluation.rollout import record_rollout
    from cablebot_gym.evaluation.timing import WARM_UP, TimedPolicy

    def record(policy: object) -> Rollout:
        payload = model.robot.defaults.payload(0.0)
        return record_rollout(policy, env_id, payload=payload, **task.keywords())

    timed = TimedPolicy(exported)
    motion = record(timed)
    in_float32 = record(original)
    model.compute_in_float64()
    in_float64 = record(original)
    action, position = _differences(motion, in_float64)
    if position > tolerance:
        raise ValueError(
            f"the file would differ from the model by {position:.2g} mm, more than --tolerance "
            f"{tolerance:g}: the actor must be a sequence of its layers, as in MlpPolicy"
        )
    rounded_action, rounded_position = _differences(motion, in_float32)
    rows = [
        ["difference of the file from", "largest of an action", "largest of a position"],
        ["the model in float64", f"{action:.2g}", f"{position:.2g} mm"],
        ["the model as it is, in float32", f"{rounded_action:.2g}", f"{rounded_position:.2g} mm"],
    ]
    print_table(f"{env_id}, one motion with {len(motion) - 1} actions", rows)
    times = 1e6 * np.array(timed.times[WARM_UP:])
    if times.size:
        print(
            f"time of an action on one core: {np.median(times):.0f} µs in the median, "
            f"{times.max():.0f} µs at worst; the control period is {1e6 / task.control_frequency:g} µs"
        )


def _differences(motion: Rollout, other: Rollout) -> tuple[float, float]:
    """Largest differences of an action and of a position [mm]; infinite if one motion is longer."""
    import numpy as np

    if len(motion) != len(other):
        return math.inf, math.inf
    dimensions = motion.task.robot.dimensions
    actions, poses = (
        motion.arrays[name] - other.arrays[name] for name in ("commanded_action", "true_pose")
    )
    distances = np.linalg.norm(poses[:, :dimensions], axis=1)
    return float(np.abs(actions).max()), 1000 * float(distances.max())
