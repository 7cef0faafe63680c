"""``cablebot dlcc``."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from cablebot_gym.cli import options
from cablebot_gym.cli.records import Options
from cablebot_gym.utils.console import print_table, say
from cablebot_gym.utils.files import atomic_write_text, json_text

if TYPE_CHECKING:
    from cablebot_gym.evaluation.result import DLCCResult
    from cablebot_gym.policies import LoadedPolicy


@dataclass(frozen=True, kw_only=True)
class SearchOptions(Options):
    """The search for the payload."""

    title: ClassVar[str] = "Search"

    criterion: Annotated[
        str,
        "Success criterion: task (saturated torques; position, rotation and tension), "
        "paper (torques within the limits without saturation; position and slack), or both.",
    ] = "both"
    payload_max: Annotated[
        float | None,
        "Largest payload of the scan [kg]. The default is the end of the robot's payload range, or slightly "
        "more than what the motors hold; for the paper's robots 10 (planar) and 20 (spatial).",
    ] = None
    resolution: Annotated[
        float | None,
        "Resolution of the payload [kg]. The default is 0.001 for one draw and 0.01 for several.",
    ] = None
    search: Annotated[
        str,
        "scan, or bisection for policies that take seconds for an episode: it tries few payloads, and its "
        "result is unranked.",
    ] = "scan"
    draws: options.Draws = None
    probability: Annotated[
        float, "Required success probability of the payload over the draws, with 95 % confidence."
    ] = 0.95


def dlcc(
    *,
    env_id: options.FittingEnvId = None,
    policy: options.PolicyNames,
    out: Annotated[Path | None, "Folder for result.json and figures."] = None,
    as_json: options.Json = False,
    conditions: options.ConditionOptions,
    search: SearchOptions,
    isolate: options.Isolate = None,
) -> None:
    """Find the largest payload that a policy carries along a trajectory (DLCC).

    Prints the payload, the limiting violation beyond it, and the margins at that payload. The files
    of several policies are in one folder each.

    Examples:

    cablebot dlcc CableBot-Spatial-v0 --policy fl --out results

    cablebot dlcc CableBot-Spatial-v0 --policy fl:gains=tuned --uncertainty table6

    cablebot dlcc --policy fl,robust,observing --robot cogiro
    """
    env_id = options.fitting_id(env_id, conditions.robot)
    names = list(dict.fromkeys(options.split_names(policy)))
    folders = {name: _folder(out, name, names) for name in names}
    for folder in folders.values():
        options.check_figure_folder(folder, "result.json")
    robot = options.robot_of(env_id, conditions)
    policies = options.loaded_policies(names, robot, conditions.wrappers, isolate=isolate)
    has_isolated = any(policy.isolated for policy in policies)
    conditions = options.with_seed(conditions, is_secret=has_isolated)
    data: list[dict[str, Any]] = []
    for loaded in policies:
        results = _results(loaded, env_id, conditions, search)
        folder = folders[loaded.name]
        if folder is not None:
            _write(results, folder)
        data += [result.to_dict() for result in results]
        if not as_json:
            _print_results(results, loaded, conditions, search)
    if as_json:
        print(json_text(data))
    elif has_isolated:
        print(f"seed {conditions.seed}")


def _folder(out: Path | None, name: str, names: list[str]) -> Path | None:
    """Folder of the results of a policy: of its own if there are several."""
    if out is None or len(names) == 1:
        return out
    return out / name


def _criteria(policy: LoadedPolicy, search: SearchOptions) -> list[str]:
    """The criteria to evaluate: of ``both``, those that apply to the policy."""
    from cablebot_gym.evaluation.judge import CRITERIA

    if search.criterion != "both":
        return [search.criterion]
    if not policy.declarations.unsaturated_actions:
        return ["task"]
    return list(CRITERIA)


def _results(
    policy: LoadedPolicy, env_id: str, conditions: options.ConditionOptions, search: SearchOptions
) -> list[DLCCResult]:
    from cablebot_gym.evaluation.evaluator import evaluate_dlcc

    settings = asdict(search)
    results = []
    for criterion in _criteria(policy, search):
        settings["criterion"] = criterion
        results.append(
            evaluate_dlcc(policy, env_id, progress=True, **settings, **conditions.keywords())
        )
    return results


def _write(results: list[DLCCResult], folder: Path) -> None:
    from cablebot_gym.plotting.figures import save_result

    path = folder / "result.json"
    atomic_write_text(path, json_text([result.to_dict() for result in results]) + "\n")
    written = [path]
    for result in results:
        written.append(save_result(result, folder))
    say("wrote " + ", ".join(map(str, written)))


def _print_results(
    results: list[DLCCResult],
    policy: LoadedPolicy,
    conditions: options.ConditionOptions,
    search: SearchOptions,
) -> None:
    print_payloads(results, search)
    for result in results:
        if result.details.violation_seed is not None and not result.details.stochastic:
            command = options.command_again(
                "rollout",
                result.conditions.env_id,
                policy=policy.name,
                payload=repr(result.failed_payload or 0.0),
                criterion=None if result.criterion == "task" else result.criterion,
                out="failure.csv",
                conditions=replace(conditions, seed=result.details.violation_seed),
            )
            print(f"{result.criterion}: this command repeats the failure:\n  {command}")


def print_payloads(results: list[DLCCResult], search: SearchOptions) -> None:
    """Prints a table of the evaluations of one policy, one for each criterion that applies to it."""
    rows = [["criterion", "payload", "total mass", "limiting violation", "margins at that payload"]]
    rows += [_row(result) for result in results]
    if search.criterion == "both" and len(results) == 1:
        reason = "not applicable: the policy does not declare unsaturated_actions"
        rows.append(["paper", "n/a", "–", reason, "–"])
    motion = results[0].details.environment["trajectory"].get("name", "")
    print_table(results[0].describe(motion), rows, right=False)
    for note in _notes(results):
        print(note)


def _row(result: DLCCResult) -> list[str]:
    """Row of the table of one evaluation."""
    from cablebot_gym.evaluation.judge import LIMIT_NAMES

    details = result.details
    criterion = f"{result.criterion} (declared)" if details.declared else result.criterion
    draws = "" if result.assured is None else f", {options.counted(result.draws, 'draw')}"
    violation = result.violation_text
    if details.failures:
        counts = []
        for kind, number in details.failures.items():
            counts.append(f"{LIMIT_NAMES[kind]} in {number}")
        violation = f"{', '.join(counts)} of {result.draws} draws; {violation}"
    if result.payload is None:
        margins = "–"
        if details.feasible:
            intervals = [f"{low:.2f}–{high:.2f} kg" for low, high in details.feasible]
            margins = f"feasible: {', '.join(intervals)}"
        return [criterion, f"fails unloaded{draws}", "–", violation, margins]
    payload = f"{result.payload:.3f} kg{draws}"
    return [criterion, payload, f"{result.total_mass:.3f} kg", violation, _margins_text(result)]


def _notes(results: list[DLCCResult]) -> list[str]:
    from cablebot_gym.evaluation.statistics import fewest_draws

    score = results[0]
    details = score.details
    bounds = f"error bounds: position {1e3 * (details.error_bounds['position'] or 0.0):g} mm"
    for result in results:
        rotation = result.details.error_bounds["rotation"]
        if rotation is not None:
            bounds += f", rotation {1e3 * rotation:g} mrad (task only)"
            break
    notes = [bounds]
    resolution = max(result.resolution for result in results)
    if resolution > 0:
        size = float(f"{resolution * 1e3:.2g}")
        checked = "without" if details.discretisation is None else "with"
        notes.append(
            f"resolution {size:g} g, {checked} the discretisation error of the physics steps"
        )
    if not score.ranked:
        notes.append("unranked: a bisection tries few payloads and can miss a failure between them")
    if not (score.isolated or details.shipped):
        notes.append(f"not isolated: {options.NOT_ISOLATED}")
    if score.assured is not None:
        notes.append(f"payload: {score.assurance}")
    if score.assured is False:
        fewest = fewest_draws(details.probability or 0.95, details.confidence or 0.95)
        notes.append(f"a lower tolerance bound needs at least {fewest} draws")
    if any(result.details.declared for result in results):
        notes.append("declared: only the policy itself says that its actions are not saturated")
    if any(result.scan_ended for result in results):
        notes.append(f"the scan ended at {details.payload_max:g} kg: try a larger --payload-max")
    return notes


def _margins_text(result: DLCCResult) -> str:
    margins = dict(result.details.margins)
    tension = margins.pop("tension")
    parts = [f"{name} {margin:.1%}" for name, margin in margins.items()]
    text = ", ".join([*parts, f"tension ≥ {tension:.1f} N"])
    if result.draws > 1:
        text += " (least over the draws that carry it)"
    return text
