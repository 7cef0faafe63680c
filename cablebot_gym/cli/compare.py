"""``cablebot compare``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cablebot_gym.cli import options
from cablebot_gym.utils.console import notes_console, print_table, progress, results_console

if TYPE_CHECKING:
    from cablebot_gym.evaluation.comparison import Comparison, Estimate

_NARROW = 150
"""Width of the terminal below which the table is transposed: one column for each policy [columns]."""

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
"""Quantity, heading and factor of the unit of each column."""


@options.episode_options()
def compare(
    env_id: options.EnvId,
    policies: Annotated[
        str,
        typer.Option(
            "--policies",
            help="Policies as for `dlcc --policy`, separated by commas. The others are compared against the first.",
        ),
    ],
    episode: dict[str, Any],
    payload: Annotated[float, typer.Option(help="Payload [kg].")] = 0.0,
    draws: options.Draws = None,
    out: Annotated[Path | None, typer.Option(help="Folder for comparison.json and comparison.png.")] = None,
    as_json: options.Json = False,
) -> None:
    """Compare the errors, torques and margins of several policies with one payload over the same draws.

    Example: cablebot compare CableBot-Spatial-v0 --policies fl,robust --uncertainty table6 --payload 1 --out results
    """
    from cablebot_gym.evaluation.comparison import compare_policies
    from cablebot_gym.utils.files import atomic_write_text

    options.check_figure_folder(out, "comparison.json", "comparison.png")
    names = options.split_names(policies)
    options.note_unsupported(names, env_id)
    loaded = options.loaded_policies(names, env_id, episode.pop("wrappers"))
    with progress("comparing") as step:
        comparison = compare_policies(
            loaded, env_id, names=names, payload=payload, draws=draws, progress=step, **episode
        )
    if out is not None:
        from cablebot_gym.plotting.comparison import save_comparison

        atomic_write_text(out / "comparison.json", comparison.to_json() + "\n")
        notes_console().print(f"wrote {out / 'comparison.json'}, {save_comparison(comparison, out)}")
    if as_json:
        print(comparison.to_json())
    else:
        print_comparison(comparison)


def print_comparison(comparison: Comparison) -> None:
    """Prints a table of policies over the same draws, and the relative changes against the first policy."""
    from cablebot_gym.envs import described
    from cablebot_gym.evaluation.comparison import CONFIDENCE, REDUCTION_QUANTITIES
    from cablebot_gym.evaluation.statistics import interval
    from cablebot_gym.task import payload_model_text

    model = payload_model_text(comparison.payload_known, comparison.model_payload_factor)
    uncertainty = f"{options.counted(comparison.draws, 'draw')} of {comparison.uncertainty or 'no uncertainty'}"
    environment = described(comparison.env_id, comparison.task.robot.name)
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
    if results_console().width < _NARROW:
        rows = [list(row) for row in zip(*rows, strict=True)]
    print_table(f"{environment}, payload {comparison.payload:g} kg, {model}, {uncertainty}", rows)
    first = comparison.metrics[0].policy
    for index, one in enumerate(comparison.metrics[1:], 1):
        changes = [
            f"{name.replace('_', ' ')} {_change(comparison.reduction(index, name))}" for name in REDUCTION_QUANTITIES
        ]
        print(f"{one.policy} against {first}: {', '.join(changes)}")
    if comparison.draws > 1:
        print(f"± and brackets: {CONFIDENCE:.0%} confidence over draws")
    if ended := sum(int(one.ended.sum()) for one in comparison.metrics):
        rule = "the remaining steps count with the termination radius as error"
        print(f"{options.counted(ended, 'episode')} ended early: {rule}")


def _change(fraction: Estimate) -> str:
    """Relative change as text. A reduction has a minus sign."""
    ends = (fraction.mean, fraction.high, fraction.low)
    mean, low, high = (f"{round(-end, 2) + 0.0:+.0%}" for end in ends)  # + 0.0 avoids "-0%"
    return f"{mean} [{low}, {high}]" if fraction.high > fraction.low else mean
