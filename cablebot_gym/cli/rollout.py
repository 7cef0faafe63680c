"""``cablebot rollout``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cablebot_gym.cli.options import (
    EnvId,
    Frequency,
    Known,
    PolicyName,
    Seed,
    TrajectoryName,
    UncertaintyName,
    as_data,
)
from cablebot_gym.utils.console import counting, notes_console


def rollout(
    env_id: EnvId,
    policy: PolicyName,
    out: Annotated[Path, typer.Option(help="Recording, ending in .npz or .csv.")],
    payload: Annotated[float, typer.Option(help="[kg]")] = 0.0,
    trajectory: TrajectoryName = None,
    payload_known: Known = True,
    uncertainty: UncertaintyName = None,
    control_frequency: Frequency = 500.0,
    seed: Seed = 0,
) -> None:
    """One episode of a policy, recorded step by step.

    One row for each control step: time [s], pose, velocity, reference and errors at that time; command_time, the step's
    start, with drive demand, torques [N·m], tensions [N] and motor speeds [rad/s] then. SI units and radians.

    Example: cablebot rollout CableBot-Planar-v0 --policy fl --payload 1.5 --out run.csv
    """
    from cablebot_gym.evaluation.rollout import check_suffix, record_rollout
    from cablebot_gym.utils.files import usable_file

    check_suffix(out)
    usable_file(out)
    with counting(notes_console(), "steps") as bar:
        task = bar.add_task(policy, total=1)
        record = record_rollout(
            policy,
            env_id,
            payload=payload,
            seed=seed,
            trajectory=as_data("--trajectory", trajectory),
            payload_known=payload_known,
            uncertainty=as_data("--uncertainty", uncertainty),
            control_frequency=control_frequency,
            progress=lambda done, expected: bar.update(task, completed=done, total=expected),
        )
    record.save(out)
    verdict = record.verdict
    outcome = "carried" if verdict.carried else f"not carried: {verdict.limit}"
    ended = f" (ended early: {record.reason})" if record.reason else ""
    print(f"{env_id}, {policy}, {payload:g} kg, task criterion: {outcome}{ended}; recorded in {out}")
