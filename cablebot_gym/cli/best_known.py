"""``cablebot best-known``."""

from __future__ import annotations

from typing import Annotated

import typer

from cablebot_gym.cli.options import EnvId, Frequency, PositionBound, RotationBound, TrajectoryName, as_data
from cablebot_gym.utils.console import notes_console, working


def best_known(
    env_id: EnvId,
    trajectory: TrajectoryName = None,
    position_bound: PositionBound = 0.01,
    rotation_bound: RotationBound = 0.01,
    control_frequency: Frequency = 500.0,
    cache: Annotated[
        bool, typer.Option(help="Whether to store the result on disk, and to read a stored result.")
    ] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print only JSON.")] = False,
) -> None:
    """Compute the best known payload of an environment by trajectory optimisation.

    It is the largest payload for which a motion and torques within all limits are known, and therefore a lower bound of
    the optimal payload. A replay of the torques in the environment verifies it under the task criterion. For rigid
    planar robots, the result also has a proven upper bound. Requires the extra: pip install 'cablebot-gym[optimal]'.

    Example: cablebot best-known CableBot-Spatial-v0 --position-bound 0.02 --json
    """
    from cablebot_gym.bounds.best_known import find_best_known

    with working(notes_console()) as say:
        result = find_best_known(
            env_id,
            trajectory=as_data("--trajectory", trajectory),
            error_bounds={"position": position_bound, "rotation": rotation_bound},
            control_frequency=control_frequency,
            cache=cache,
            progress=say,
        )
    print(result.to_json() if as_json else result)
    if not result.verified:
        raise typer.Exit(1)
