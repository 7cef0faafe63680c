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
    ModelPayloadFactor,
    PayloadKnown,
    PositionBound,
    RotationBound,
    Seed,
    TrajectoryName,
    UncertaintyName,
    as_data,
    counted,
    note_unsupported,
    progress_bar,
    split_names,
)
from cablebot_gym.utils.console import notes_console, results_console

if TYPE_CHECKING:
    from cablebot_gym.evaluation.comparison import Comparison, Estimate

_NARROW = 150
"""Width of the terminal below which the table is transposed: one column for each policy [columns]."""


def compare(
    env_id: EnvId,
    policies: Annotated[
        str,
        typer.Option(
            "--policies",
            help="Policies as for `dlcc --policy`, separated by commas. The others are compared against the first.",
        ),
    ],
    payload: Annotated[float, typer.Option(help="Payload [kg].")] = 0.0,
    uncertainty: UncertaintyName = None,
    draws: Annotated[
        int | None,
        typer.Option(
            help="Number of sampled episodes of each policy. The default is 256 if the uncertainty is random, else 1."
        ),
    ] = None,
    trajectory: TrajectoryName = None,
    payload_known: PayloadKnown = True,
    model_payload_factor: ModelPayloadFactor = 1.0,
    position_bound: PositionBound = 0.01,
    rotation_bound: RotationBound = 0.01,
    control_frequency: Frequency = 500.0,
    seed: Seed = 0,
    out: Annotated[Path | None, typer.Option(help="Folder for comparison.json and comparison.png.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print only JSON.")] = False,
) -> None:
    """Compare the errors, torques and margins of several policies with one payload over the same draws.

    Example: cablebot compare CableBot-Spatial-v0 --policies fl,robust --uncertainty table6 --payload 1 --out results
    """
    from cablebot_gym.envs import env_robot
    from cablebot_gym.evaluation.comparison import compare_policies
    from cablebot_gym.policies import load_policy
    from cablebot_gym.robots import find_robot
    from cablebot_gym.utils.files import atomic_write_text, check_writable_dir, check_writable_file

    save_comparison: Callable[..., Any] | None = None
    if out is not None:
        from cablebot_gym.plotting.comparison import save_comparison
        from cablebot_gym.plotting.figures import import_matplotlib

        import_matplotlib()
        check_writable_dir(out)
        check_writable_file(out / "comparison.json")
        check_writable_file(out / "comparison.png")
    names, robot = split_names(policies), find_robot(env_robot(env_id))
    note_unsupported(names, env_id)
    with progress_bar() as step:
        comparison = compare_policies(
            [load_policy(name, robot) for name in names],
            env_id,
            names=names,
            payload=payload,
            error_bounds={"position": position_bound, "rotation": rotation_bound},
            uncertainty=as_data("--uncertainty", uncertainty),
            draws=draws,
            seed=seed,
            trajectory=as_data("--trajectory", trajectory),
            payload_known=payload_known,
            model_payload_factor=model_payload_factor,
            control_frequency=control_frequency,
            progress=partial(step, "comparing", 0, 1),
        )
    if out is not None and save_comparison is not None:
        atomic_write_text(out / "comparison.json", comparison.to_json() + "\n")
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
    ("least_tension", "minimum tension [N]", 1.0),
)


def print_comparison(comparison: Comparison) -> None:
    """Prints a table of policies over the same draws, and the relative changes against the first policy."""
    from rich.table import Table

    from cablebot_gym.envs import described
    from cablebot_gym.evaluation.comparison import CONFIDENCE, REDUCTION_QUANTITIES
    from cablebot_gym.evaluation.statistics import interval
    from cablebot_gym.task import payload_model_text

    model = payload_model_text(comparison.payload_known, comparison.model_payload_factor)
    uncertainty = f"{counted(comparison.draws, 'draw')} of {comparison.uncertainty or 'no uncertainty'}"
    environment = described(comparison.env_id, comparison.task.robot.name)
    title = f"{environment}, payload {comparison.payload:g} kg, {model}, {uncertainty}"
    columns = [column for column in _COLUMNS if column[0] != "max_rotation" or not comparison.task.robot.planar]
    rows = [["policy", "success rate", *(heading for _, heading, _ in columns)]]
    for one in comparison.metrics:
        cells = []
        for name, _, scale in columns:
            estimate = one.estimate(name)
            interval_text = f" ± {scale * (estimate.high - estimate.mean):.2g}" if comparison.draws > 1 else ""
            cells.append(f"{scale * estimate.mean:.3g}{interval_text}")
        success_rate = f"{one.carried.mean():.0%}"
        if comparison.draws > 1:
            low, high = interval(int(one.carried.sum()), comparison.draws, CONFIDENCE)
            success_rate += f" [{low:.0%}, {high:.0%}]"
        rows.append([one.policy, success_rate, *cells])
    console = results_console()
    if narrow := console.width < _NARROW:
        rows = [list(row) for row in zip(*rows, strict=True)]
    console.print(title, highlight=False)
    table = Table()
    table.add_column(rows[0][0], overflow="fold")
    for index, heading in enumerate(rows[0][1:]):
        table.add_column(heading, justify="right", overflow="fold", no_wrap=not narrow and index == 0)
    for row in rows[1:]:
        table.add_row(*row)
    console.print(table)
    first = comparison.metrics[0].policy
    for index, one in enumerate(comparison.metrics[1:], 1):
        changes = [
            f"{name.replace('_', ' ')} {_change(comparison.reduction(index, name))}" for name in REDUCTION_QUANTITIES
        ]
        console.print(f"{one.policy} against {first}: {', '.join(changes)}", highlight=False)
    notes = [f"± and brackets: {CONFIDENCE:.0%} confidence over draws"] if comparison.draws > 1 else []
    if ended := sum(int(one.ended.sum()) for one in comparison.metrics):
        notes.append(
            f"{counted(ended, 'episode')} ended early: the remaining steps count with the termination radius as error"
        )
    for note in notes:
        console.print(note, highlight=False)


def _change(fraction: Estimate) -> str:
    """Relative change as text. A reduction has a minus sign."""
    mean, low, high = (
        f"{round(-end, 2) + 0.0:+.0%}" for end in (fraction.mean, fraction.high, fraction.low)
    )  # no "-0%"
    return f"{mean} [{low}, {high}]" if fraction.high > fraction.low else mean
