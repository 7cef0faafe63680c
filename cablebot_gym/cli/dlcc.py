"""``cablebot dlcc``."""

from __future__ import annotations

import json
from collections.abc import Callable
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cablebot_gym.cli.options import (
    EnvId,
    Frequency,
    Known,
    PolicyName,
    PositionBound,
    RotationBound,
    Seed,
    TrajectoryName,
    UncertaintyName,
    as_data,
    counted,
    note_purpose,
    progress_bar,
)
from cablebot_gym.utils.console import notes_console, results_console

if TYPE_CHECKING:
    from cablebot_gym.evaluation.result import DLCCResult

_BOTH = "both"


class CriterionChoice(StrEnum):
    """Choices of ``--criterion``."""

    task = "task"
    paper = "paper"
    both = _BOTH


def dlcc(
    env_id: EnvId,
    policy: PolicyName,
    criterion: Annotated[CriterionChoice, typer.Option(help="Which limits count.")] = CriterionChoice.both,
    trajectory: TrajectoryName = None,
    payload_known: Known = True,
    position_bound: PositionBound = 0.01,
    rotation_bound: RotationBound = 0.01,
    payload_max: Annotated[float | None, typer.Option(help="End of the scan [kg]: 10 planar, 20 spatial.")] = None,
    resolution: Annotated[
        float | None, typer.Option(help="Gap between carried and not carried [kg]: 0.001, or 0.01 over draws.")
    ] = None,
    uncertainty: UncertaintyName = None,
    draws: Annotated[
        int | None, typer.Option(help="Episodes at each payload: 256 if the uncertainty is random, else 1.")
    ] = None,
    probability: Annotated[float, typer.Option(help="Share of the draws that has to carry a payload.")] = 0.95,
    confidence: Annotated[float, typer.Option(help="Of the lower bound of the payload.")] = 0.95,
    control_frequency: Frequency = 500.0,
    seed: Seed = 0,
    out: Annotated[Path | None, typer.Option(help="Folder for result.json and the figures.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print only JSON.")] = False,
) -> None:
    """The largest payload that a policy carries, what gives way first beyond it, and when.

    Examples:

    cablebot dlcc CableBot-Spatial-v0 --policy fl --out results

    cablebot dlcc CableBot-Spatial-v0 --policy robust-tuned --uncertainty table6 --draws 256 --probability 0.95
    """
    from cablebot_gym.envs import env_robot
    from cablebot_gym.evaluation import CRITERIA, evaluate_dlcc
    from cablebot_gym.policies import load_policy
    from cablebot_gym.robots import find_robot
    from cablebot_gym.utils.files import usable_file, usable_folder, write_text_whole

    save_figures: Callable[..., Any] | None = None
    if out is not None:
        from cablebot_gym.plotting.figures import import_matplotlib, save_figures

        import_matplotlib()
        usable_folder(out)
        usable_file(out / "result.json")
    loaded = load_policy(policy, find_robot(env_robot(env_id)))
    note_purpose([policy], env_id)
    chosen = list(CRITERIA) if criterion.value == _BOTH else [criterion.value]
    left_out = []
    if criterion.value == _BOTH and not getattr(loaded, "unclipped", False):
        left_out = ["paper"]
        chosen.remove("paper")
    results = []
    with progress_bar() as step:
        for place, one in enumerate(chosen):
            results.append(
                evaluate_dlcc(
                    loaded,
                    env_id,
                    criterion=one,
                    limits={"position": position_bound, "rotation": rotation_bound},
                    payload_max=payload_max,
                    resolution=resolution,
                    uncertainty=as_data("--uncertainty", uncertainty),
                    draws=draws,
                    probability=probability,
                    confidence=confidence,
                    seed=seed,
                    name=policy,
                    trajectory=as_data("--trajectory", trajectory),
                    payload_known=payload_known,
                    control_frequency=control_frequency,
                    progress=partial(step, f"{one} criterion", place, len(chosen)),
                )
            )
    text = json.dumps([result.to_dict() for result in results], indent=2, ensure_ascii=False, allow_nan=False)
    if out is not None and save_figures is not None:
        write_text_whole(out / "result.json", text + "\n")
        written = [out / "result.json", *(path for result in results for path in save_figures(result, out))]
        notes_console().print("wrote " + ", ".join(str(path) for path in written))
    if as_json:
        print(text)
    else:
        print_payloads(results, left_out)


def print_payloads(results: list[DLCCResult], left_out: list[str]) -> None:
    """Evaluations of one policy, and the criteria that are ``left_out``, for they do not apply to it."""
    from rich.table import Table

    from cablebot_gym.envs import described

    console = results_console()
    first = results[0]
    told = "payload told" if first.payload_known else "payload not told"
    unknown = "" if first.uncertainty is None else f", {first.uncertainty}"
    if first.uncertainty is not None or first.draws > 1:
        unknown += f", {counted(first.draws, 'draw')}"
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
    from cablebot_gym.evaluation.statistics import fewest_draws

    text = f"no payload assured with {result.confidence:.0%} confidence by {result.draws} draws"
    assert result.probability is not None
    assert result.confidence is not None
    fewest = fewest_draws(result.probability, result.confidence)
    return f"{text}: it takes {fewest} at least" if result.draws < fewest else text


def _replay_text(result: DLCCResult) -> str:
    payload = (result.payload or 0.0) + result.resolution
    again = f"cablebot rollout --payload {payload!r} --seed {result.limit_seed}"
    return f"{result.criterion}: that failure is repeated by {again}"


def _margins_text(result: DLCCResult) -> str:
    torque = result.margins["torque"]
    parts = [f"torque {torque:.1%}" if torque >= 0 else f"demand {-torque:.1%} beyond the torque line"]
    parts += [f"position {result.margins['position']:.1%}"]
    if "rotation" in result.margins:
        parts.append(f"rotation {result.margins['rotation']:.1%}")
    return ", ".join([*parts, f"tension ≥ {result.margins['tension']:.1f} N"])
