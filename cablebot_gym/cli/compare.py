"""``cablebot compare``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cablebot_gym.cli import options
from cablebot_gym.utils.console import print_table, say

if TYPE_CHECKING:
    from cablebot_gym.evaluation.comparison import (
        Comparison,
        PayloadComparison,
        PolicyMetrics,
    )

_SHOWN_UNITS = {"m": ("mm", 1e3), "rad": ("mrad", 1e3), "1": ("%", 100.0)}
"""Unit of a column and its factor, by the unit of the quantity where they differ."""

_SHOWN = ("mean_error", "max_error", "max_rotation", "rms_torque", "torque_margin")
"""Quantities that the table shows; the files have all."""


def compare(
    *,
    env_id: options.FittingEnvId = None,
    policies: Annotated[
        str,
        typer.Option(
            "--policies",
            help="Policies as for `dlcc --policy`, separated by commas. The others are compared against the first.",
        ),
    ],
    conditions: options.ConditionOptions,
    payload: Annotated[
        str | None,
        "Payload [kg], or several: FIRST:LAST:STEP, such as 0:9:0.5, or 0,1,2. The default is the least one of the "
        "robot's payload range, else 0.",
    ] = None,
    draws: options.Draws = None,
    out: Annotated[Path | None, "Folder for comparison.json, comparison.png and draws.csv."] = None,
    as_json: options.Json = False,
    isolate: options.Isolate = None,
) -> None:
    """Compare the errors, torques and margins of several policies over the same draws, with one or
    more payloads.

    Examples:

    cablebot compare CableBot-Spatial-v0 --policies fl,robust --uncertainty table6 --payload 1 --out results

    cablebot compare CableBot-Spatial-v0 --policies fl,robust,observing --payload 0:9:0.5 --out results
    """
    from cablebot_gym.evaluation.comparison import (
        PayloadComparison,
        compare_over_payloads,
        compare_policies,
    )

    env_id = options.fitting_id(env_id, conditions.robot)
    options.check_figure_folder(out, "comparison.json", "comparison.png", "draws.csv")
    payloads = None if payload is None else payload_grid(payload)
    names = options.split_names(policies)
    robot = options.robot_of(env_id, conditions)
    loaded = options.loaded_policies(names, robot, conditions.wrappers, isolate=isolate)
    has_isolated = any(policy.isolated for policy in loaded)
    conditions = options.with_seed(conditions, is_secret=has_isolated)
    common: dict[str, Any] = {"draws": draws, "progress": True, **conditions.keywords()}
    comparison: Comparison | PayloadComparison
    if payloads is None:
        payloads = [robot.defaults.payload()]
    if len(payloads) == 1:
        comparison = compare_policies(loaded, env_id, payload=payloads[0], **common)
    else:
        comparison = compare_over_payloads(loaded, env_id, payloads=payloads, **common)
    if out is not None:
        _write(comparison, out)
    if as_json:
        print(comparison.to_json())
        return
    if isinstance(comparison, PayloadComparison):
        print_comparisons(comparison.comparisons)
    else:
        print_comparisons([comparison])
    if has_isolated:
        print(f"seed {conditions.seed}")


def _write(comparison: Comparison | PayloadComparison, folder: Path) -> None:
    from cablebot_gym.evaluation.comparison import PayloadComparison, save_draws
    from cablebot_gym.plotting import draw_comparison, draw_payload_comparison
    from cablebot_gym.plotting.figures import save_figure
    from cablebot_gym.utils.files import atomic_write_text

    path = folder / "comparison.json"
    atomic_write_text(path, comparison.to_json() + "\n")
    draws = folder / "draws.csv"
    save_draws(comparison, draws)
    picture = folder / "comparison.png"
    if isinstance(comparison, PayloadComparison):
        save_figure(draw_payload_comparison(comparison), picture)
    else:
        save_figure(draw_comparison(comparison), picture)
    say(f"wrote {path}, {draws}, {picture}")


def payload_grid(text: str) -> list[float]:
    """Payloads from ``--payload`` of ``compare`` [kg].

    Raises:
        ValueError: if the text is neither a list of numbers nor FIRST:LAST:STEP, or has more than
            1000 payloads.
    """
    is_range = ":" in text
    try:
        numbers = [float(number) for number in text.replace(":", ",").split(",")]
    except ValueError:
        numbers = []
    if numbers and not is_range:
        return numbers
    if len(numbers) == 3:
        low, high, step = numbers
        if step > 0 and 0 <= (high - low) / step < 1000:
            count = int((high - low) / step + 1e-6) + 1
            return [round(low + index * step, 9) for index in range(count)]
    raise ValueError(
        f"--payload must be a number, a list such as 0,1,2, or FIRST:LAST:STEP, such as 0:9:0.5, not {text!r}"
    )


def print_comparisons(comparisons: Sequence[Comparison]) -> None:
    """Prints a table of policies over the same draws, with each payload. With a single payload, it
    prints relative changes against the first policy, too."""
    from cablebot_gym.evaluation.comparison import QUANTITIES, REDUCTION_QUANTITIES

    first = comparisons[0]
    columns = []
    for name in _SHOWN:
        # a point mass has no rotation
        if name != "max_rotation" or not first.task.robot.point_mass:
            unit, factor = _SHOWN_UNITS.get(QUANTITIES[name], (QUANTITIES[name], 1.0))
            columns.append((name, f"{name.replace('_', ' ')} [{unit}]", factor))
    rows = [["payload [kg]", "policy", "success rate", *(heading for _, heading, _ in columns)]]
    for comparison in comparisons:
        payload = f"{comparison.payload:g}"
        for metrics in comparison.metrics:
            rows.append([payload, *_cells(metrics, columns)])
            payload = ""
    print_table(first.describe(), rows)
    if len(comparisons) == 1:
        reference, *compared = first.metrics
        for index, metrics in enumerate(compared, 1):
            changes = []
            for name in REDUCTION_QUANTITIES:
                less = first.reduction(index, name)
                interval = f"[{-less.high:+.0%}, {-less.low:+.0%}]"
                changes.append(f"{name.replace('_', ' ')} {-less.mean:+.0%} {interval}")
            print(f"{metrics.policy} against {reference.policy}: {', '.join(changes)}")
    _print_notes(comparisons)


def _cells(metrics: PolicyMetrics, columns: Sequence[tuple[str, str, float]]) -> list[str]:
    """Name, success rate and quantities of a policy, with confidence intervals if there are several
    draws."""
    success = metrics.success
    is_drawn = len(metrics.carried) > 1
    rate = f"{success.mean:.0%}"
    if is_drawn:
        rate += f" [{success.low:.0%}, {success.high:.0%}]"
    cells = [metrics.policy, rate]
    for name, _, scale in columns:
        estimate = metrics.estimate(name)
        cell = f"{scale * estimate.mean:.3g}"
        if is_drawn:
            cell += f" ± {scale * (estimate.high - estimate.mean):.2g}"
        cells.append(cell)
    return cells


def _print_notes(comparisons: Sequence[Comparison]) -> None:
    from cablebot_gym.evaluation.comparison import CONFIDENCE

    if comparisons[0].draws > 1:
        print(f"± and brackets: {CONFIDENCE:.0%} confidence over draws")
    ended = 0
    for comparison in comparisons:
        ended += sum(int(metrics.ended.sum()) for metrics in comparison.metrics)
    if ended:
        rule = "the remaining steps count with the termination radius as error"
        print(f"{options.counted(ended, 'episode')} ended early: {rule}")
    not_isolated = comparisons[0].not_isolated
    if not_isolated:
        print(f"not isolated: {', '.join(not_isolated)}: {options.NOT_ISOLATED}")
