"""``cablebot compare``."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cablebot_gym.cli.options import (
    EnvId,
    Frequency,
    Known,
    PositionBound,
    RotationBound,
    Seed,
    TrajectoryName,
    UncertaintyName,
    as_data,
    counted,
    note_purpose,
    progress_bar,
    split_names,
)
from cablebot_gym.utils.console import notes_console, results_console

if TYPE_CHECKING:
    from cablebot_gym.evaluation.comparison import Comparison, Estimate

_NARROW = 150
"""Columns below which a comparison stands on its side, a column for each policy."""


def compare(
    env_id: EnvId,
    policies: Annotated[str, typer.Option("--policies", help="Names as for --policy, separated by commas.")],
    payload: Annotated[float, typer.Option(help="[kg]")] = 0.0,
    uncertainty: UncertaintyName = None,
    draws: Annotated[
        int | None, typer.Option(help="Episodes of each policy: 256 if the uncertainty is random, else 1.")
    ] = None,
    trajectory: TrajectoryName = None,
    payload_known: Known = True,
    position_bound: PositionBound = 0.01,
    rotation_bound: RotationBound = 0.01,
    control_frequency: Frequency = 500.0,
    seed: Seed = 0,
    out: Annotated[Path | None, typer.Option(help="Folder for comparison.json and comparison.png.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print only JSON.")] = False,
) -> None:
    """Several policies with one payload over the same draws: errors, torques and margins, with intervals.

    Example: cablebot compare CableBot-Spatial-v0 --policies fl,robust --uncertainty table6 --payload 1 --out results
    """
    from cablebot_gym.envs import env_robot
    from cablebot_gym.evaluation.comparison import compare_policies
    from cablebot_gym.policies import load_policy
    from cablebot_gym.robots import find_robot
    from cablebot_gym.utils.files import usable_file, usable_folder, write_text_whole

    save_comparison: Callable[..., Any] | None = None
    if out is not None:
        from cablebot_gym.plotting.comparison import save_comparison
        from cablebot_gym.plotting.figures import import_matplotlib

        import_matplotlib()
        usable_folder(out)
        usable_file(out / "comparison.json")
        usable_file(out / "comparison.png")
    names, robot = split_names(policies), find_robot(env_robot(env_id))
    note_purpose(names, env_id)
    with progress_bar() as step:
        comparison = compare_policies(
            [load_policy(name, robot) for name in names],
            env_id,
            names=names,
            payload=payload,
            limits={"position": position_bound, "rotation": rotation_bound},
            uncertainty=as_data("--uncertainty", uncertainty),
            draws=draws,
            seed=seed,
            trajectory=as_data("--trajectory", trajectory),
            payload_known=payload_known,
            control_frequency=control_frequency,
            progress=partial(step, "comparing", 0, 1),
        )
    if out is not None and save_comparison is not None:
        write_text_whole(out / "comparison.json", comparison.to_json() + "\n")
        written = (out / "comparison.json", save_comparison(comparison, out))
        notes_console().print("wrote " + ", ".join(str(path) for path in written))
    if as_json:
        print(comparison.to_json())
    else:
        print_comparison(comparison)


_COLUMNS = (
    ("mean_error", "error, mean [mm]", 1e3),
    ("rms_error", "rms [mm]", 1e3),
    ("max_error", "max [mm]", 1e3),
    ("max_rotation", "rotation, max [mrad]", 1e3),
    ("rms_torque", "torque, rms [N·m]", 1.0),
    ("peak_torque", "peak [N·m]", 1.0),
    ("torque_margin", "margin [%]", 100.0),
    ("least_tension", "least tension [N]", 1.0),
)


def print_comparison(comparison: Comparison) -> None:
    """Policies over the same draws."""
    from rich.table import Table

    from cablebot_gym.envs import described
    from cablebot_gym.evaluation.comparison import CONFIDENCE, REDUCED
    from cablebot_gym.evaluation.statistics import interval

    told = "told" if comparison.payload_known else "not told"
    unknown = f"{counted(comparison.draws, 'draw')} of {comparison.uncertainty or 'no uncertainty'}"
    where = described(comparison.env_id, comparison.task.robot.name)
    title = f"{where}, payload {comparison.payload:g} kg, {told}, {unknown}"
    columns = [column for column in _COLUMNS if column[0] != "max_rotation" or not comparison.task.robot.planar]
    rows = [["policy", "carried", *(heading for _, heading, _ in columns)]]
    for one in comparison.measured:
        cells = []
        for name, _, scale in columns:
            estimate = one.estimate(name)
            width = f" ± {scale * (estimate.high - estimate.mean):.2g}" if comparison.draws > 1 else ""
            cells.append(f"{scale * estimate.mean:.3g}{width}")
        carried = f"{one.carried.mean():.0%}"
        if comparison.draws > 1:
            low, high = interval(int(one.carried.sum()), comparison.draws, CONFIDENCE)
            carried += f" [{low:.0%}, {high:.0%}]"
        rows.append([one.policy, carried, *cells])
    console = results_console()
    if narrow := console.width < _NARROW:
        rows = [list(row) for row in zip(*rows, strict=True)]
    table = Table(title=title, title_justify="left")
    table.add_column(rows[0][0], overflow="fold")
    for place, heading in enumerate(rows[0][1:]):
        table.add_column(heading, justify="right", overflow="fold", no_wrap=not narrow and place == 0)
    for row in rows[1:]:
        table.add_row(*row)
    console.print(table)
    first = comparison.measured[0].policy
    for place, one in enumerate(comparison.measured[1:], 1):
        shares = [f"{name.replace('_', ' ')} {_change(comparison.reduction(place, name))}" for name in REDUCED]
        console.print(f"{one.policy} against {first}: {', '.join(shares)}", highlight=False)
    notes = [f"± and brackets: {CONFIDENCE:.0%} confidence over draws"] if comparison.draws > 1 else []
    if ended := sum(int(one.ended.sum()) for one in comparison.measured):
        notes.append(
            f"{counted(ended, 'episode')} ended early: counted as lost, at the termination radius, from then on"
        )
    if notes:
        console.print("; ".join(notes), highlight=False)


def _change(share: Estimate) -> str:
    """Less of something is a gain, and written with a minus sign."""
    mean, low, high = (f"{round(-end, 2) + 0.0:+.0%}" for end in (share.mean, share.high, share.low))  # no "-0%"
    return f"{mean} [{low}, {high}]" if share.high > share.low else mean
