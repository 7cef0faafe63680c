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
    ModelPayloadFactor,
    PayloadKnown,
    PolicyName,
    PositionBound,
    RotationBound,
    Seed,
    TrajectoryName,
    UncertaintyName,
    as_data,
    counted,
    note_unsupported,
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
    criterion: Annotated[
        CriterionChoice,
        typer.Option(
            help="Success criterion: task (saturated torques; position, rotation and slack), "
            "paper (torques within the limits without saturation; position and slack), or both."
        ),
    ] = CriterionChoice.both,
    trajectory: TrajectoryName = None,
    payload_known: PayloadKnown = True,
    model_payload_factor: ModelPayloadFactor = 1.0,
    position_bound: PositionBound = 0.01,
    rotation_bound: RotationBound = 0.01,
    payload_max: Annotated[
        float | None,
        typer.Option(help="Largest payload of the scan [kg]. The default is 10 for planar and 20 for spatial robots."),
    ] = None,
    resolution: Annotated[
        float | None,
        typer.Option(help="Resolution of the payload [kg]. The default is 0.001 for one draw and 0.01 for several."),
    ] = None,
    uncertainty: UncertaintyName = None,
    draws: Annotated[
        int | None,
        typer.Option(
            help="Number of sampled episodes at each payload. The default is 256 if the uncertainty is random, else 1."
        ),
    ] = None,
    probability: Annotated[
        float, typer.Option(help="Required success rate: the fraction of the draws that must carry the payload.")
    ] = 0.95,
    confidence: Annotated[
        float, typer.Option(help="Confidence of the assured payload, a lower tolerance bound.")
    ] = 0.95,
    control_frequency: Frequency = 500.0,
    seed: Seed = 0,
    out: Annotated[Path | None, typer.Option(help="Folder for result.json and figures.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print only JSON.")] = False,
) -> None:
    """Find the largest payload that a policy carries along a trajectory (DLCC).

    Prints the payload, the limiting violation beyond it, and the margins at that payload.

    Examples:

    cablebot dlcc CableBot-Spatial-v0 --policy fl --out results

    cablebot dlcc CableBot-Spatial-v0 --policy robust-tuned --uncertainty table6 --draws 256 --probability 0.95
    """
    from cablebot_gym.envs import env_robot
    from cablebot_gym.evaluation import CRITERIA, evaluate_dlcc
    from cablebot_gym.policies import load_policy
    from cablebot_gym.robots import find_robot
    from cablebot_gym.utils.files import atomic_write_text, check_writable_dir, check_writable_file

    save_figures: Callable[..., Any] | None = None
    if out is not None:
        from cablebot_gym.plotting.figures import import_matplotlib, save_figures

        import_matplotlib()
        check_writable_dir(out)
        check_writable_file(out / "result.json")
    loaded = load_policy(policy, find_robot(env_robot(env_id)))
    note_unsupported([policy], env_id)
    chosen = list(CRITERIA) if criterion.value == _BOTH else [criterion.value]
    inapplicable = []
    if criterion.value == _BOTH and not getattr(loaded, "unsaturated_actions", False):
        inapplicable = ["paper"]
        chosen.remove("paper")
    results = []
    with progress_bar() as step:
        for stage, name in enumerate(chosen):
            results.append(
                evaluate_dlcc(
                    loaded,
                    env_id,
                    criterion=name,
                    error_bounds={"position": position_bound, "rotation": rotation_bound},
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
                    model_payload_factor=model_payload_factor,
                    control_frequency=control_frequency,
                    progress=partial(step, f"{name} criterion", stage, len(chosen)),
                )
            )
    text = json.dumps([result.to_dict() for result in results], indent=2, ensure_ascii=False, allow_nan=False)
    if out is not None and save_figures is not None:
        atomic_write_text(out / "result.json", text + "\n")
        written = [out / "result.json", *(path for result in results for path in save_figures(result, out))]
        notes_console().print("wrote " + ", ".join(str(path) for path in written))
    if as_json:
        print(text)
    else:
        print_payloads(results, inapplicable)


def print_payloads(results: list[DLCCResult], inapplicable: list[str]) -> None:
    """Prints a table of the evaluations of one policy.

    Args:
        results: one evaluation for each criterion; at least one.
        inapplicable: names of the criteria that do not apply to the policy.
    """
    from rich.table import Table

    from cablebot_gym.envs import described
    from cablebot_gym.task import payload_model_text

    console = results_console()
    first = results[0]
    model = payload_model_text(first.payload_known, first.model_payload_factor)
    uncertainty = "" if first.uncertainty is None else f", {first.uncertainty}"
    if first.uncertainty is not None or first.draws > 1:
        uncertainty += f", {counted(first.draws, 'draw')}"
    environment = described(first.env_id, first.task.robot.name)
    motion = first.environment["trajectory"].get("name", "")
    console.print(f"{environment}, {first.policy}, {motion}, {model}{uncertainty}", highlight=False)
    table = Table()
    for column, justify in (
        ("criterion", "left"),
        ("payload", "right"),
        ("total mass", "right"),
        ("limiting violation", "left"),
        ("margins at that payload", "left"),
    ):
        table.add_column(column, justify=justify)  # type: ignore[arg-type]
    for result in results:
        if result.payload is None:
            payload, total = "fails unloaded", "–"
            intervals = ", ".join(f"{low:.2f}–{high:.2f} kg" for low, high in result.feasible)
            margins = f"feasible: {intervals}" if intervals else "–"
        else:
            payload, total = f"{result.payload:.3f} kg", f"{result.total_mass:.3f} kg"
            margins = _margins_text(result)
        table.add_row(result.criterion, payload, total, _failure_text(result), margins)
    for criterion in inapplicable:
        table.add_row(criterion, "n/a", "–", "not applicable: the policy does not declare unsaturated_actions", "–")
    console.print(table)
    bounds = f"position {1e3 * (first.error_bounds['position'] or 0.0):g} mm"
    rotation = next(
        (result.error_bounds["rotation"] for result in results if result.error_bounds["rotation"] is not None), None
    )
    if rotation is not None:
        bounds += f", rotation {rotation * 1e3:g} mrad (task only)"
    notes = [f"error bounds: {bounds}"]
    if (resolution := max(result.resolution for result in results)) > 0:
        notes.append(f"resolution {resolution * 1e3:.2g} g")
    if first.probability is not None:
        notes.append(f"required success rate: {first.probability:.0%} of the draws")
        notes += [f"{result.criterion}: {_assured_text(result)}" for result in results if result.payload is not None]
        notes += [_replay_text(result) for result in results if result.violation_seed is not None]
    if any(result.scan_ended for result in results):
        notes.append(f"the scan ended at {first.payload_max:g} kg: try a larger --payload-max")
    for note in notes:
        console.print(note, highlight=False)


def _failure_text(result: DLCCResult) -> str:
    if not result.failures:
        return result.violation_text
    kinds = ", ".join(f"{kind} in {number}" for kind, number in result.failures.items())
    return f"{kinds} of {result.draws} draws; {result.violation_text}"


def _assured_text(result: DLCCResult) -> str:
    if result.assured_payload is not None:
        return (
            f"assured payload {result.assured_payload:.2f} kg "
            f"({result.confidence:.0%}/{result.probability:.0%} lower tolerance bound)"
        )
    from cablebot_gym.evaluation.statistics import fewest_draws

    assert result.probability is not None
    assert result.confidence is not None
    text = f"no assured payload with {result.confidence:.0%} confidence from {result.draws} draws"
    fewest = fewest_draws(result.probability, result.confidence)
    return f"{text}: at least {fewest} draws are needed" if result.draws < fewest else text


def _replay_text(result: DLCCResult) -> str:
    payload = (result.payload or 0.0) + result.resolution
    again = f"cablebot rollout --payload {payload!r} --seed {result.violation_seed}"
    return f"{result.criterion}: that failure is repeated by {again}"


def _margins_text(result: DLCCResult) -> str:
    torque = result.margins["torque"]
    parts = [f"torque {torque:.1%}" if torque >= 0 else f"torque {-torque:.1%} beyond the limit"]
    parts += [f"position {result.margins['position']:.1%}"]
    if "rotation" in result.margins:
        parts.append(f"rotation {result.margins['rotation']:.1%}")
    return ", ".join([*parts, f"tension ≥ {result.margins['tension']:.1f} N"])
