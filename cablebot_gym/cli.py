"""``cablebot``: payloads, lists and recordings from the command line.

Exit status: 0 done, 1 ran and failed, 2 bad input, 130 interrupted. Results go to standard output, everything else to
standard error.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from cablebot_gym.benchmark.command import benchmark
from cablebot_gym.command_options import (
    EnvId,
    Frequency,
    Known,
    PolicyName,
    Seed,
    TrajectoryName,
    UncertaintyName,
    as_data,
)
from cablebot_gym.films.command import video, watch
from cablebot_gym.report.command import report

app = typer.Typer(
    name="cablebot",
    help=(
        "How many kilograms does a controller carry on a cable robot?\n\n"
        "Exit status: 0 done, whatever is carried; 1 ran and failed: a policy raised, a file could not be written, a "
        "cell of the benchmark failed, a best payload was not verified, or doctor found something wrong; 2 bad input, "
        "a folder that cannot be written to too; "
        "130 interrupted."
    ),
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
_errors = Console(stderr=True, emoji=False)
_BOTH = "both"
COMMAND_GROUP = "cablebot_gym.commands"
"""Entry points of further commands: functions with typer's annotations."""

INTERRUPTED = 130
"""Exit status after Ctrl-C."""


class CriterionChoice(StrEnum):
    """Choices of ``--criterion``."""

    task = "task"
    paper = "paper"
    both = _BOTH


@app.callback(invoke_without_command=True)
def _version(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        from cablebot_gym import __version__

        print(f"cablebot_gym {__version__}")


Draws = Annotated[
    int | None, typer.Option("--draws", help="Episodes at each payload: 256 if the uncertainty is random, else 1.")
]
PositionBound = Annotated[float, typer.Option("--position-bound", help="Largest position error [m].")]
RotationBound = Annotated[float, typer.Option("--rotation-bound", help="Largest rotation error, task criterion [rad].")]


@app.command()
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
    draws: Draws = None,
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
    from cablebot_gym.dlcc import CRITERIA, evaluate_dlcc
    from cablebot_gym.envs import env_robot
    from cablebot_gym.files import usable_file, usable_folder, write_text_whole
    from cablebot_gym.policies import load_policy
    from cablebot_gym.robots import find_robot
    from cablebot_gym.tables import print_payloads

    save_figures: Callable[..., Any] | None = None
    if out is not None:
        from cablebot_gym.dlcc.figures import import_matplotlib, save_figures

        import_matplotlib()
        usable_folder(out)
        usable_file(out / "result.json")
    loaded = load_policy(policy, find_robot(env_robot(env_id)))
    _note_purpose([policy], env_id)
    chosen = list(CRITERIA) if criterion.value == _BOTH else [criterion.value]
    left_out = []
    if criterion.value == _BOTH and not getattr(loaded, "unclipped", False):
        left_out = ["paper"]
        chosen.remove("paper")
    results = []
    with _progress() as step:
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
        _errors.print("wrote " + ", ".join(str(path) for path in written), soft_wrap=True, highlight=False)
    if as_json:
        print(text)
    else:
        print_payloads(results, left_out)


@app.command()
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
    from cablebot_gym.dlcc.comparison import compare_policies
    from cablebot_gym.envs import env_robot
    from cablebot_gym.files import usable_file, usable_folder, write_text_whole
    from cablebot_gym.policies import load_policy
    from cablebot_gym.robots import find_robot
    from cablebot_gym.tables import print_comparison

    save_comparison: Callable[..., Any] | None = None
    if out is not None:
        from cablebot_gym.dlcc.comparison_figure import save_comparison
        from cablebot_gym.dlcc.figures import import_matplotlib

        import_matplotlib()
        usable_folder(out)
        usable_file(out / "comparison.json")
        usable_file(out / "comparison.png")
    names, robot = [name.strip() for name in policies.split(",") if name.strip()], find_robot(env_robot(env_id))
    _note_purpose(names, env_id)
    with _progress() as step:
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
        _errors.print("wrote " + ", ".join(str(path) for path in written), soft_wrap=True, highlight=False)
    if as_json:
        print(comparison.to_json())
    else:
        print_comparison(comparison)


@app.command()
def bound(
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

    Example: cablebot bound CableBot-Spatial-v0 --position-bound 0.02 --json
    """
    from cablebot_gym.dlcc.optimum import best_found
    from cablebot_gym.terminal import working

    with working(_errors) as say:
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


@app.command(name="list")
def list_(as_json: Annotated[bool, typer.Option("--json", help="Print only JSON.")] = False) -> None:
    """Environments, trajectories, uncertainties and installed policies.

    Example: cablebot list --json
    """
    from cablebot_gym.envs import ENV_IDS
    from cablebot_gym.policies import policy_entries
    from cablebot_gym.trajectories import trajectory_names
    from cablebot_gym.uncertainty import PARAMETERS, UNCERTAINTIES

    entries = policy_entries().values()
    if as_json:
        policies = [{"name": item.name, "kind": item.kind, "env_ids": list(item.env_ids)} for item in entries]
        data = {
            "env_ids": list(ENV_IDS),
            "trajectories": trajectory_names(),
            "uncertainties": list(UNCERTAINTIES),
            "uncertain_parameters": list(PARAMETERS),
            "policies": policies,
        }
        print(json.dumps(data, indent=2))
        return
    console = Console(width=None if sys.stdout.isatty() else 140, highlight=False, markup=False, emoji=False)
    console.print("environments: " + ", ".join(ENV_IDS))
    console.print("trajectories: " + ", ".join(trajectory_names()))
    console.print("uncertainties: " + ", ".join(UNCERTAINTIES))
    console.print("uncertain parameters: " + ", ".join(PARAMETERS))
    console.print("policies:")
    for item in entries:
        console.print(f"  {item.name} ({item.kind}): {item.summary}; for {', '.join(item.env_ids)}")


@app.command()
def rollout(
    env_id: EnvId,
    policy: PolicyName,
    out: Annotated[Path, typer.Option(help="Recording, ending in .npz or .csv.")],
    payload: Annotated[float, typer.Option(help="[kg]")] = 0.0,
    trajectory: TrajectoryName = None,
    payload_known: Known = True,
    uncertainty: UncertaintyName = None,
    control_frequency: Frequency = 500.0,
    seed: Seed = 0,
) -> None:
    """One episode of a policy, recorded step by step.

    One row for each control step: time [s], pose, velocity, reference and errors at that time; command_time, the step's
    start, with drive demand, torques [N·m], tensions [N] and motor speeds [rad/s] then. SI units and radians.

    Example: cablebot rollout CableBot-Planar-v0 --policy fl --payload 1.5 --out run.csv
    """
    from cablebot_gym.files import usable_file
    from cablebot_gym.rollout import check_suffix, record_rollout
    from cablebot_gym.terminal import counting

    check_suffix(out)
    usable_file(out)
    with counting(_errors, "steps") as bar:
        task = bar.add_task(policy, total=1)
        record = record_rollout(
            policy,
            env_id,
            payload=payload,
            seed=seed,
            trajectory=as_data("--trajectory", trajectory),
            payload_known=payload_known,
            uncertainty=as_data("--uncertainty", uncertainty),
            control_frequency=control_frequency,
            progress=lambda done, expected: bar.update(task, completed=done, total=expected),
        )
    record.save(out)
    verdict = record.verdict
    outcome = "carried" if verdict.carried else f"not carried: {verdict.limit}"
    ended = f" (ended early: {record.reason})" if record.reason else ""
    print(f"{env_id}, {policy}, {payload:g} kg, task criterion: {outcome}{ended}; recorded in {out}")


for _command in (watch, video, benchmark, report):
    app.command()(_command)


@app.command()
def doctor() -> None:
    """Versions, extras, compile cache, and a self-test of every plant. The exit status is 1 if something is wrong.

    Example: cablebot doctor
    """
    from cablebot_gym.doctor import examine, print_findings

    if not print_findings(examine()):
        raise typer.Exit(1)


def _note_purpose(names: list[str], env_id: str) -> None:
    """Says so when a policy is made for other environments: it runs all the same, and seldom well."""
    from cablebot_gym.policies import policy_entries

    entries = policy_entries()
    for name in names:
        if name in entries and env_id not in entries[name].env_ids:
            meant = ", ".join(entries[name].env_ids)
            _errors.print(f"note: {name} is made for {meant}, not for {env_id}", soft_wrap=True, highlight=False)


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int, int, int], None]]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=_errors, transient=True, disable=not _errors.is_terminal) as bar:
        task = bar.add_task("preparing", total=1.0)

        def step(description: str, place: int, places: int, done: int, expected: int) -> None:
            bar.update(task, description=description, completed=place + done / expected, total=places)

        yield step


def main() -> None:
    """Entry point: turns errors into one sentence and an exit status."""
    from cablebot_gym.policies import PolicyError

    sys.path.insert(0, "")  # so that package.module:factory is found in the folder in which one works
    try:
        if len(sys.argv) < 2:
            sys.argv.append("--help")
        if sys.argv[1] not in _command_names():
            _add_commands()
        status = app(standalone_mode=False)  # a number where the parser ended the command itself, as Ctrl-C does
        if status == INTERRUPTED:
            raise KeyboardInterrupt
        sys.exit(status if isinstance(status, int) else 0)
    except KeyboardInterrupt:
        _fail("interrupted: nothing was left half-written", INTERRUPTED)
    except (ValueError, ImportError) as error:
        _fail(_as_typed(str(error)), 2)
    except OSError as error:
        _fail(f"cannot write {error.filename!r}: {error.strerror}", 1)
    except PolicyError as error:
        _fail(str(error), 1)
    except Exception as error:
        show = getattr(error, "format_message", None)  # what the option parser found wrong
        if show is None:
            raise
        message = show()
        if message.startswith("No such command"):
            added = (point.name for point in entry_points(group=COMMAND_GROUP))
            message += f" The commands are {', '.join(dict.fromkeys([*_command_names(), *added]))}."
        elif example := _example(sys.argv[1]):
            message = f"{message.rstrip('.')}; for example: {example}"
        _fail(message, getattr(error, "exit_code", 2))


def _add_commands() -> None:
    """Commands that installed packages add, such as the baselines' own; not looked for where one of these is typed."""
    for point in entry_points(group=COMMAND_GROUP):
        asked_for = sys.argv[1] == point.name or sys.argv[1].startswith("-")
        if asked_for and point.name not in _command_names():
            app.command(name=point.name)(point.load())


def _command_names() -> list[str]:
    """Of this module, and once they are looked for, of other packages."""
    return [_name(item) for item in app.registered_commands]


def _name(item: typer.models.CommandInfo) -> str:
    return item.name or str(getattr(item.callback, "__name__", ""))


def _example(name: str) -> str:
    """The first in the docstring of a command; empty if there is no such command."""
    texts = [item.callback.__doc__ or "" for item in app.registered_commands if _name(item) == name and item.callback]
    found = re.search(r"^ *(?:Example: )?(cablebot .+)$", "\n".join(texts), re.MULTILINE)
    return found[1] if found else ""


def _as_typed(message: str) -> str:
    """A message about a keyword, about the option instead that gave it."""
    keyword = re.match(r"([a-z][a-z0-9_]*) must ", message)
    option = f"--{keyword[1].replace('_', '-')}" if keyword else ""
    typed = (argument.partition("=")[0] for argument in sys.argv)
    return option + message[len(keyword[1]) :] if keyword and option in typed else message


def _fail(message: str, status: int) -> None:
    _errors.print(f"cablebot: {message}", style="red", highlight=False, markup=False, soft_wrap=True)
    sys.exit(status)


if __name__ == "__main__":
    main()
