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
    cache: Annotated[bool, typer.Option(help="Keep the result on disk, and take it from there.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print only JSON.")] = False,
) -> None:
    """The best found: the largest payload for which some motion and inputs stay inside all limits, by optimization.

    A lower bound of what is possible, verified by a replay of its inputs in the environment; for rigid planar robots
    with a payload that is proved to be out of reach. Task criterion. Needs the extra: pip install
    'cablebot-gym[optimal]'.

    Example: cablebot best-known CableBot-Spatial-v0 --position-bound 0.02 --json
    """
    from cablebot_gym.bounds.best_known import best_found

    with working(notes_console()) as say:
        found = best_found(
            env_id,
            trajectory=as_data("--trajectory", trajectory),
            limits={"position": position_bound, "rotation": rotation_bound},
            control_frequency=control_frequency,
            cache=cache,
            progress=say,
        )
    print(found.to_json() if as_json else found)
    if not found.verified:
        raise typer.Exit(1)
