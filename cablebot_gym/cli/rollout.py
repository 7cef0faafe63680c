"""``cablebot rollout``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cablebot_gym.cli.options import (
    EpisodeOptions,
    FittingEnvId,
    Isolate,
    Payload,
    PolicyName,
    fitting_id,
    loaded_policy,
    robot_of,
)


def rollout(
    *,
    env_id: FittingEnvId = None,
    policy: PolicyName,
    out: Annotated[Path, "File of the recording, ending in .npz or .csv."],
    episode: EpisodeOptions,
    payload: Payload = None,
    criterion: Annotated[str, "Success criterion: task or paper."] = "task",
    isolate: Isolate = None,
) -> None:
    """Run one episode of a policy and record every control step in a file.

    The file has one row for each control step, in SI units and radians. Each row holds the pose,
    velocity, reference and errors at `time`, the end of the step, and the commanded action, torques
    [N·m], tensions [N] and motor speeds [rad/s] at `action_time`, the start of the step. Flexible
    robots add the motor angles at `time`, and joint springs their deflections.

    Example: cablebot rollout CableBot-Planar-v0 --policy fl --payload 1.5 --out run.csv
    """
    from cablebot_gym.evaluation.rollout import check_suffix, record_rollout
    from cablebot_gym.utils.files import check_writable_file

    check_suffix(out)
    check_writable_file(out)
    env_id = fitting_id(env_id, episode.robot)
    robot = robot_of(env_id, episode)
    payload = robot.defaults.payload(payload)
    loaded = loaded_policy(policy, robot, episode.wrappers, isolate=isolate)
    record = record_rollout(
        loaded,
        env_id,
        payload=payload,
        criterion=criterion,
        progress=True,
        **episode.keywords(),
    )
    record.save(out)
    verdict = record.verdict
    outcome = "carried"
    if not verdict.carried:
        outcome = f"not carried: {verdict.violation}"
    if not (loaded.isolated or loaded.shipped):
        outcome += ", not isolated"
    if record.reason:
        outcome += f" (ended early: {record.reason})"
    print(
        f"{env_id}, {policy}, {payload:g} kg, {criterion} criterion: {outcome}; recorded in {out}"
    )
