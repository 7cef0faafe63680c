"""``cablebot rollout``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cablebot_gym.cli.options import (
    ConditionOptions,
    FittingEnvId,
    Isolate,
    Payload,
    PolicyName,
    fitting_id,
    loaded_policies,
    robot_of,
)


def rollout(
    *,
    env_id: FittingEnvId = None,
    policy: PolicyName,
    out: Annotated[Path, "File of the recording, ending in .npz or .csv, or of a figure, .png."],
    conditions: ConditionOptions,
    payload: Payload = None,
    criterion: Annotated[str, "Success criterion: task or paper."] = "task",
    isolate: Isolate = None,
) -> None:
    """Run one episode of a policy and record every control step in a file, or draw it.

    A figure shows torques, path and errors (extra plot). A recording has one row for each control
    step, in SI units and radians. Each row holds the pose, velocity, reference and errors at `time`,
    the end of the step, and the commanded action, torques [N·m], tensions [N] and motor speeds
    [rad/s] at `action_time`, the start of the step. Flexible robots add the motor angles at `time`.

    Examples:

    cablebot rollout CableBot-Planar-v0 --policy fl --payload 1.5 --out run.csv

    cablebot rollout CableBot-Planar-v0 --policy fl --payload 1.5 --out run.png
    """
    from cablebot_gym.evaluation.rollout import SUFFIXES, check_suffix, record_rollout
    from cablebot_gym.plotting.figures import draw_rollout, import_matplotlib, save_figure
    from cablebot_gym.utils.files import check_writable_file

    check_suffix(out, (*SUFFIXES, ".png"))
    drawn = out.suffix == ".png"
    if drawn:
        import_matplotlib()
    check_writable_file(out)
    env_id = fitting_id(env_id, conditions.robot)
    robot = robot_of(env_id, conditions)
    payload = robot.defaults.payload(payload)
    (loaded,) = loaded_policies([policy], robot, conditions.wrappers, isolate=isolate)
    record = record_rollout(
        loaded,
        env_id,
        payload=payload,
        criterion=criterion,
        progress=True,
        **conditions.keywords(),
    )
    outcome = record.verdict.outcome
    if not (loaded.isolated or loaded.shipped):
        outcome += ", not isolated"
    if record.reason:
        outcome += f" (ended early: {record.reason})"
    sentence = f"{env_id}, {policy}, {payload:g} kg, {criterion} criterion: {outcome}"
    if drawn:
        save_figure(draw_rollout(record, sentence), out)
    else:
        record.save(out)
    print(f"{sentence}; recorded in {out}")
