"""``cablebot best-known``."""

from __future__ import annotations

import typer

from cablebot_gym.cli.options import (
    FittingEnvId,
    Json,
    TaskOptions,
    fitting_id,
    robot_of,
)
from cablebot_gym.utils.console import say


def best_known(
    *,
    env_id: FittingEnvId = None,
    conditions: TaskOptions,
    as_json: Json = False,
) -> None:
    """Compute the best known payload of an environment by trajectory optimisation.

    It is the largest payload for which a motion and torques within all limits are known, and
    therefore a lower bound of the optimal payload. Replays of the torques in the environment, with
    its physics step and with a tenth of it, verify it under the task criterion. Requires the extra:
    pip install 'cablebot-gym[optimal]'.

    Example: cablebot best-known CableBot-Spatial-v0 --position-bound 20 --json
    """
    from cablebot_gym.bounds.best_known import find_best_known

    env_id = fitting_id(env_id, conditions.robot)
    robot_of(env_id, conditions)
    result = find_best_known(env_id, progress=say, **conditions.keywords())
    print(result.to_json() if as_json else result)
    if not result.verified:
        raise typer.Exit(1)
