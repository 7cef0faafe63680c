"""``cablebot rollout``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from cablebot_gym.cli.options import BOUNDS, EnvId, PolicyName, episode_options
from cablebot_gym.utils.console import progress


@episode_options(without=BOUNDS)
def rollout(
    env_id: EnvId,
    policy: PolicyName,
    out: Annotated[Path, typer.Option(help="File of the recording, ending in .npz or .csv.")],
    episode: dict[str, Any],
    payload: Annotated[float, typer.Option(help="Payload [kg].")] = 0.0,
) -> None:
    """Run one episode of a policy and record every control step in a file.

    The file has one row for each control step, in SI units and radians. Each row holds the pose, velocity, reference
    and errors at `time`, the end of the step, and the commanded action, torques [N·m], tensions [N] and motor speeds
    [rad/s] at `action_time`, the start of the step.

    Example: cablebot rollout CableBot-Planar-v0 --policy fl --payload 1.5 --out run.csv
    """
    from cablebot_gym.evaluation.rollout import check_suffix, record_rollout
    from cablebot_gym.utils.files import check_writable_file

    check_suffix(out)
    check_writable_file(out)
    with progress(policy, "steps") as step:
        record = record_rollout(policy, env_id, payload=payload, progress=step, **episode)
    record.save(out)
    verdict = record.verdict
    outcome = "carried" if verdict.carried else f"not carried: {verdict.violation}"
    ended = f" (ended early: {record.reason})" if record.reason else ""
    print(f"{env_id}, {policy}, {payload:g} kg, task criterion: {outcome}{ended}; recorded in {out}")
