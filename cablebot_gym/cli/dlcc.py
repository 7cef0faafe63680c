"""``cablebot dlcc``."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cablebot_gym.cli import options
from cablebot_gym.utils.console import notes_console, print_table

if TYPE_CHECKING:
    from cablebot_gym.evaluation.result import DLCCResult


class CriterionChoice(StrEnum):
    """Choices of ``--criterion``."""

    task = "task"
    paper = "paper"
    both = "both"


class SearchChoice(StrEnum):
    """Choices of ``--search``."""

    scan = "scan"
    bisection = "bisection"


@options.episode_options()
def dlcc(
    env_id: options.FittingEnvId,
    policy: options.PolicyName,
    episode: dict[str, Any],
    criterion: Annotated[
        CriterionChoice,
        typer.Option(
            help="Success criterion: task (saturated torques; position, rotation and tension), "
            "paper (torques within the limits without saturation; position and slack), or both."
        ),
    ] = CriterionChoice.both,
    payload_max: Annotated[
        float | None,
        typer.Option(
            help="Largest payload of the scan [kg]. The default is the end of the robot's payload range, or slightly "
            "more than what the motors hold; for the paper's robots 10 (planar) and 20 (spatial)."
        ),
    ] = None,
    resolution: Annotated[
        float | None,
        typer.Option(
            help="Resolution of the payload [kg]. The default is 0.001 for one draw and 0.01 for several."
        ),
    ] = None,
    search: Annotated[
        SearchChoice,
        typer.Option(
            help="scan, or bisection for policies that take seconds for an episode: it tries few payloads, and its "
            "result is unranked."
        ),
    ] = SearchChoice.scan,
    draws: options.Draws = None,
    probability: Annotated[
        float, typer.Option(help="Required success probability of the payload over the draws.")
    ] = 0.95,
    confidence: Annotated[
        float,
        typer.Option(
            help="Confidence of the payload over the draws, which is a lower tolerance bound."
        ),
    ] = 0.95,
    isolate: options.Isolate = False,
    sandbox: options.Sandbox = False,
    deadline: options.Deadline = None,
    out: Annotated[Path | None, typer.Option(help="Folder for result.json and figures.")] = None,
    as_json: options.Json = False,
) -> None:
    """Find the largest payload that a policy carries along a trajectory (DLCC).

    Prints the payload, the limiting violation beyond it, and the margins at that payload. --policy
    may name several policies, separated by commas. Their files are then in one folder each.

    Examples:

    cablebot dlcc CableBot-Spatial-v0 --policy fl --out results

    cablebot dlcc CableBot-Spatial-v0 --policy robust-tuned --uncertainty table6

    cablebot dlcc --policy fl,robust,adaptive --robot cogiro
    """
    from cablebot_gym.evaluation.constraints import CRITERIA
    from cablebot_gym.evaluation.evaluator import evaluate_dlcc
    from cablebot_gym.utils.files import atomic_write_text

    names = list(dict.fromkeys(options.split_names(policy)))
    folders = {name: out if out is None or len(names) == 1 else out / name for name in names}
    for folder in folders.values():
        options.check_figure_folder(folder, "result.json")
    wrappers = episode["wrappers"]
    robot = options.robot_of(env_id, episode)
    policies = [
        options.loaded_policy(
            name, robot, isolate=isolate, deadline=deadline, sandbox=sandbox, wrappers=wrappers
        )
        for name in names
    ]
    options.note_unsupported(names, env_id)
    settings: dict[str, Any] = {
        "payload_max": payload_max,
        "resolution": resolution,
        "draws": draws,
        "probability": probability,
        "confidence": confidence,
        "search": search.value,
    }
    evaluated = {key: value for key, value in episode.items() if key != "wrappers"}
    found: list[dict[str, Any]] = []
    for loaded in policies:
        chosen = list(CRITERIA) if criterion is CriterionChoice.both else [criterion.value]
        inapplicable = []
        if criterion is CriterionChoice.both and not loaded.declarations.unsaturated_actions:
            chosen, inapplicable = ["task"], ["paper"]
        results = [
            evaluate_dlcc(loaded, env_id, criterion=one, progress=True, **settings, **evaluated)
            for one in chosen
        ]
        data = [result.to_dict() for result in results]
        if (folder := folders[loaded.name]) is not None:
            from cablebot_gym.plotting.figures import save_figures

            atomic_write_text(folder / "result.json", _json(data) + "\n")
            written = [
                folder / "result.json",
                *(path for result in results for path in save_figures(result, folder)),
            ]
            notes_console().print("wrote " + ", ".join(map(str, written)))
        found += data
        if as_json:
            continue
        print_payloads(results, inapplicable)
        for result in results:
            if result.details.violation_seed is not None and not result.details.stochastic:
                print(f"{result.criterion}: this command repeats the failure:")
                print(f"  {_failure_command(result, loaded.name, episode)}")
    if as_json:
        print(_json(found))
    elif isolate:
        print(f"seed {episode['seed']}")


def _json(data: list[dict[str, Any]]) -> str:
    return json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)


def _failure_command(result: DLCCResult, policy: str, episode: dict[str, Any]) -> str:
    """The command line that repeats and records the episode with the limiting violation."""
    return options.command_again(
        "rollout",
        result.conditions.env_id,
        policy=policy,
        payload=repr(result.failed_payload or 0.0),
        criterion=None if result.criterion == "task" else result.criterion,
        out="failure.csv",
        episode=episode | {"seed": result.details.violation_seed},
    )


def print_payloads(results: list[DLCCResult], inapplicable: list[str]) -> None:
    """Prints a table of the evaluations of one policy.

    Args:
        results: one evaluation for each criterion; at least one.
        inapplicable: names of the criteria that do not apply to the policy.
    """
    from cablebot_gym.envs import described

    first = results[0]
    words = [described(first.conditions.env_id, first.rollout.task.robot.name), first.policy]
    words += [first.details.environment["trajectory"].get("name", "")]
    words += [first.conditions.payload_model]
    words += [f"behind {', '.join(first.details.wrappers)}"] if first.details.wrappers else []
    words += (
        [first.conditions.uncertainty_name] if first.conditions.uncertainty_name is not None else []
    )
    words += ["stochastic policy"] if first.details.stochastic else []
    words += [] if first.ranked else ["unranked"]
    draws = "" if first.assured is None else f", {options.counted(first.draws, 'draw')}"
    rows = [["criterion", "payload", "total mass", "limiting violation", "margins at that payload"]]
    for result in results:
        failures = ", ".join(
            f"{kind} in {number}" for kind, number in result.details.failures.items()
        )
        violation = result.violation_text
        if failures:
            violation = f"{failures} of {result.draws} draws; {violation}"
        if result.payload is None:
            intervals = ", ".join(
                f"{low:.2f}–{high:.2f} kg" for low, high in result.details.feasible
            )
            rest = [
                f"fails unloaded{draws}",
                "–",
                violation,
                f"feasible: {intervals}" if intervals else "–",
            ]
        else:
            total = f"{result.total_mass:.3f} kg"
            rest = [f"{result.payload:.3f} kg{draws}", total, violation, _margins_text(result)]
        rows.append(
            [
                f"{result.criterion} (declared)" if result.details.declared else result.criterion,
                *rest,
            ]
        )
    for criterion in inapplicable:
        rows.append(
            [
                criterion,
                "n/a",
                "–",
                "not applicable: the policy does not declare unsaturated_actions",
                "–",
            ]
        )
    print_table(", ".join(words), rows, right=False)
    for note in _notes(results):
        print(note)


def _notes(results: list[DLCCResult]) -> list[str]:
    from cablebot_gym.evaluation.statistics import fewest_draws

    first = results[0]
    bounds = f"error bounds: position {1e3 * (first.details.error_bounds['position'] or 0.0):g} mm"
    rotations = [
        result.details.error_bounds["rotation"]
        for result in results
        if result.details.error_bounds["rotation"] is not None
    ]
    notes = [f"{bounds}, rotation {1e3 * rotations[0]:g} mrad (task only)" if rotations else bounds]
    if (resolution := max(result.resolution for result in results)) > 0:
        size = float(f"{resolution * 1e3:.2g}")
        checked = "without" if first.details.discretisation is None else "with"
        notes.append(
            f"resolution {size:g} g, {checked} the discretisation error of the physics steps"
        )
    if not first.ranked:
        notes.append("unranked: a bisection tries few payloads and can miss a failure between them")
    if first.assured is not None:
        notes += (
            [f"payload: {first.assurance}"]
            if any(result.payload is not None for result in results)
            else []
        )
        notes += [
            _unloaded(result) for result in results if result.payload is None and result.draws > 1
        ]
    if first.assured is False:
        fewest = fewest_draws(first.details.probability or 0.95, first.details.confidence or 0.95)
        notes.append(f"a lower tolerance bound needs at least {fewest} draws")
    if any(result.details.declared for result in results):
        notes.append("declared: only the policy itself says that its actions are not saturated")
    if any(result.scan_ended for result in results):
        notes.append(
            f"the scan ended at {first.details.payload_max:g} kg: try a larger --payload-max"
        )
    return notes


def _unloaded(result: DLCCResult) -> str:
    from cablebot_gym.evaluation.statistics import required_successes

    needed, _ = required_successes(
        result.draws, result.details.probability or 0.95, result.details.confidence or 0.95
    )
    failed = sum(result.details.failures.values())
    return f"{result.criterion}: fails unloaded in {failed} of {result.draws} draws; {needed} have to succeed"


def _margins_text(result: DLCCResult) -> str:
    torque = result.details.margins["torque"]
    position = result.details.margins["position"]
    parts = [f"torque {torque:.1%}" if torque >= 0 else f"torque {-torque:.1%} beyond the limit"]
    parts += [f"position {position:.1%}"]
    if "rotation" in result.details.margins:
        parts.append(f"rotation {result.details.margins['rotation']:.1%}")
    return ", ".join([*parts, f"tension ≥ {result.details.margins['tension']:.1f} N"])
