"""Results as tables in the terminal."""

from __future__ import annotations

from rich.table import Table

from cablebot_gym.dlcc.comparison import CONFIDENCE, REDUCED, Comparison, Estimate
from cablebot_gym.dlcc.probability import fewest_draws, interval
from cablebot_gym.dlcc.result import DLCCResult
from cablebot_gym.envs import described
from cablebot_gym.terminal import results_console

_NARROW = 150
"""Columns below which a comparison stands on its side, a column for each policy."""


def print_payloads(results: list[DLCCResult], left_out: list[str]) -> None:
    """Evaluations of one policy, and the criteria that are ``left_out``, for they do not apply to it."""
    console = results_console()
    first = results[0]
    told = "payload told" if first.payload_known else "payload not told"
    unknown = "" if first.uncertainty is None else f", {first.uncertainty}"
    if first.uncertainty is not None or first.draws > 1:
        unknown += f", {_number(first.draws, 'draw')}"
    where = described(first.env_id, first.task.robot.name)
    motion = first.environment["trajectory"].get("name", "")
    table = Table(title=f"{where}, {first.policy}, {motion}, {told}{unknown}", title_justify="left")
    for column, justify in (
        ("criterion", "left"),
        ("payload", "right"),
        ("total mass", "right"),
        ("what fails first beyond it", "left"),
        ("left at that payload", "left"),
    ):
        table.add_column(column, justify=justify)  # type: ignore[arg-type]
    for result in results:
        if result.payload is None:
            payload, total = "none", "–"
            intervals = ", ".join(f"{low:.2f}–{high:.2f} kg" for low, high in result.feasible)
            margins = f"not even zero is carried{f'; carried: {intervals}' if intervals else ''}"
        else:
            payload, total = f"{result.payload:.3f} kg", f"{result.total_mass:.3f} kg"
            margins = _margins_text(result)
        table.add_row(result.criterion, payload, total, _failure_text(result), margins)
    for name in left_out:
        table.add_row(name, "n/a", "–", "not applicable: the policy does not declare unclipped", "–")
    console.print(table)
    bounds = f"position {1e3 * (first.limits['position'] or 0.0):g} mm"
    rotation = next((result.limits["rotation"] for result in results if result.limits["rotation"] is not None), None)
    if rotation is not None:
        bounds += f", rotation {rotation * 1e3:g} mrad (task only)"
    notes = [f"bounds: {bounds}"]
    if (resolution := max(result.resolution for result in results)) > 0:
        notes.append(f"resolution {resolution * 1e3:.2g} g")
    if first.probability is not None:
        notes.append(f"carried in at least {first.probability:.0%} of the draws")
        notes += [f"{result.criterion}: {_assured_text(result)}" for result in results if result.payload is not None]
        notes += [_replay_text(result) for result in results if result.limit_seed is not None]
    if any(result.limit.kind == "scan_end" for result in results):
        notes.append(f"the scan ended at {first.payload_max:g} kg: try a larger --payload-max")
    console.print("; ".join(notes), highlight=False)


def _failure_text(result: DLCCResult) -> str:
    if not result.failures:
        return str(result.limit)
    kinds = ", ".join(f"{kind} in {number}" for kind, number in result.failures.items())
    return f"{kinds} of {result.draws} draws; {result.limit}"


def _assured_text(result: DLCCResult) -> str:
    if result.assured_payload is not None:
        return f"{result.assured_payload:.2f} kg assured with {result.confidence:.0%} confidence"
    text = f"no payload assured with {result.confidence:.0%} confidence by {result.draws} draws"
    assert result.probability is not None
    assert result.confidence is not None
    fewest = fewest_draws(result.probability, result.confidence)
    return f"{text}: it takes {fewest} at least" if result.draws < fewest else text


def _replay_text(result: DLCCResult) -> str:
    payload = (result.payload or 0.0) + result.resolution
    again = f"cablebot rollout --payload {payload!r} --seed {result.limit_seed}"
    return f"{result.criterion}: that failure is repeated by {again}"


def _number(count: int, thing: str) -> str:
    return f"{count} {thing}{'' if count == 1 else 's'}"


def _margins_text(result: DLCCResult) -> str:
    torque = result.margins["torque"]
    parts = [f"torque {torque:.1%}" if torque >= 0 else f"demand {-torque:.1%} beyond the torque line"]
    parts += [f"position {result.margins['position']:.1%}"]
    if "rotation" in result.margins:
        parts.append(f"rotation {result.margins['rotation']:.1%}")
    return ", ".join([*parts, f"tension ≥ {result.margins['tension']:.1f} N"])


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
    told = "told" if comparison.payload_known else "not told"
    unknown = f"{_number(comparison.draws, 'draw')} of {comparison.uncertainty or 'no uncertainty'}"
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
            f"{_number(ended, 'episode')} ended early: counted as lost, at the termination radius, from then on"
        )
    if notes:
        console.print("; ".join(notes), highlight=False)


def _change(share: Estimate) -> str:
    """Less of something is a gain, and written with a minus sign."""
    mean, low, high = (f"{round(-end, 2) + 0.0:+.0%}" for end in (share.mean, share.high, share.low))  # no "-0%"
    return f"{mean} [{low}, {high}]" if share.high > share.low else mean
