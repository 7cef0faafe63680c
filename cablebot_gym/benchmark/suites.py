"""Suites of the benchmark, and the cells and policies that they contain."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib.resources import files
from itertools import chain, product
from types import MappingProxyType
from typing import Any

from cablebot_gym.benchmark.cells import (
    BestKnownCell,
    Cell,
    PolicyCell,
    SurveyCell,
    TimingCell,
)
from cablebot_gym.benchmark.scores import RANKED_MOTIONS
from cablebot_gym.benchmark.seeds import hidden_seeds
from cablebot_gym.benchmark.yardstick import drawn_cells
from cablebot_gym.envs import PAPER_ENV_IDS, fitting_env_id
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.isolation import IsolatedPolicy
from cablebot_gym.isolation.installed import public_entries, public_entry
from cablebot_gym.policies.protocol import PolicyError
from cablebot_gym.robots import ELASTIC, find_robot, library
from cablebot_gym.task import find_error_bounds, to_jsonable
from cablebot_gym.trajectories import TRAJECTORIES, held_out_seeds
from cablebot_gym.uncertainty import ERROR_SEPARATOR, find_uncertainty
from cablebot_gym.utils.checks import choice

OWN_RESOLUTION = 1e-3
"""Payload resolution in blocks with the motion ``library``, as a fraction of the end of the robot's
payload range."""


@dataclass(frozen=True, kw_only=True)
class Block:
    """Conditions under which policies are evaluated."""

    policies: Sequence[str] = ()
    """The only policies of the block; all policies if empty."""
    env_ids: Sequence[str] = ()
    """The only environments of the block, where it evaluates its policies whether their entries name
    them or not; those of the suite and of the entries if empty."""
    slow: bool = False
    """Whether to include policies whose entry is marked as slow."""
    motion: str = "circle"
    """Motion: ``circle``, the circle between dwells; ``paper``, the circle as printed, for the
    paper's robots; ``loop``, held-out motions; ``hidden``, those that follow from a seed text; or
    ``library``, the robots of the library that fit the environment, each with its own motion, error
    bounds and payload range."""
    motions: int = 1
    """Number of held-out or hidden motions."""
    one_at_a_time: bool = False
    """Whether the block has each error of its uncertainty alone, and none, beside all of them."""
    survey: bool = False
    """Whether all motions of a policy are one cell, a survey."""
    surveyed: int | None = None
    """Largest number of motions in a survey, the first ones; None for all."""
    conditions: Mapping[str, Any] = field(default_factory=dict)
    """Further fields of the policies' cells. A list makes one cell for each of its values."""

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Block:
        """The block of a suite file: unknown names are fields of the cells."""
        names = {item.name for item in fields(cls)}
        settings = {name: value for name, value in data.items() if name in names}
        conditions = {name: value for name, value in data.items() if name not in names}
        return cls(**settings, conditions=conditions)

    @property
    def is_nominal(self) -> bool:
        """Whether best known payloads are the yardstick: task criterion, no uncertainty."""
        is_task = self.conditions.get("criterion", "task") == "task"
        return is_task and "uncertainty" not in self.conditions

    def combinations(self, env_id: str) -> list[dict[str, Any]]:
        """The conditions with each combination of the values of their lists, for an
        environment."""
        conditions = dict(self.conditions)
        if self.one_at_a_time:
            name = conditions["uncertainty"]
            errors = find_uncertainty(name, find_robot(env_id)).errors()
            alone = [f"{name}{ERROR_SEPARATOR}{error}" for error in errors]
            conditions["uncertainty"] = [None, *alone, name]
        values = []
        for value in conditions.values():
            values.append(value if isinstance(value, list) else [value])
        names = conditions.keys()
        return [dict(zip(names, chosen, strict=True)) for chosen in product(*values)]


@dataclass(frozen=True, kw_only=True)
class Suite:
    """A set of cells, given as conditions for all policies."""

    name: str
    """Value of ``--suite``."""
    summary: str
    """Description in one line."""
    blocks: tuple[Block, ...]
    """Blocks of conditions."""
    env_ids: Sequence[str] = PAPER_ENV_IDS
    """Environment ids."""
    best_known: bool = True
    """Whether to compute the best known payloads."""
    timing: bool = False
    """Whether to measure the computing time per action of every policy."""


def _suites() -> Iterator[Suite]:
    """Suites from suites.toml."""
    data = tomllib.loads(
        (files("cablebot_gym.benchmark") / "suites.toml").read_text(encoding="utf-8")
    )
    for name, suite in data.items():
        blocks = tuple(map(Block.from_dict, suite.pop("blocks")))
        yield Suite(name=name, blocks=blocks, **suite)


SUITES = MappingProxyType({suite.name: suite for suite in _suites()})
"""Suites by name."""


def find_suite(name: str) -> Suite:
    """A suite by name.

    Raises:
        ValueError: if the name is unknown. The message lists the valid names.
    """
    return SUITES[choice("suite", name, SUITES)]


def find_env_ids(suite: Suite, env_ids: Sequence[str]) -> tuple[str, ...]:
    """The environments ``env_ids`` in the order of the suite; all environments of the suite if
    ``env_ids`` is empty.

    Raises:
        ValueError: if an environment is unknown or not part of the suite.
    """
    for env_id in env_ids:
        choice(f"environment of suite {suite.name!r}", env_id, suite.env_ids)
    return tuple(env_id for env_id in suite.env_ids if not env_ids or env_id in env_ids)


def find_policies(names: Sequence[str], env_ids: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """The names of the policies to evaluate on each environment.

    An installed policy is evaluated on the environments that it supports; a policy file or a
    ``package.module:factory`` on all environments.

    Args:
        names: policy names as on the command line; empty for all installed policies.
        env_ids: environments.

    Raises:
        ValueError: if a policy is unknown or supports none of the environments.
    """
    if names:
        entries = {name: public_entry(name) for name in dict.fromkeys(names)}
    else:
        entries = dict(public_entries())
    supported: dict[str, tuple[str, ...]] = {}
    for name, entry in entries.items():
        supported[name] = tuple(env_ids) if entry is None else entry.env_ids
    for name in names:
        fitting = [env_id for env_id in env_ids if env_id in supported[name]]
        if not fitting:
            raise ValueError(
                f"policy {name!r} supports {', '.join(supported[name])}, not {', '.join(env_ids)}"
            )
        if entries[name] is None:
            _check_loadable(name, fitting)
    by_environment: dict[str, tuple[str, ...]] = {}
    for env_id in env_ids:
        by_environment[env_id] = tuple(name for name in supported if env_id in supported[name])
    return by_environment


def check_evaluated(suite: Suite, policies: Mapping[str, tuple[str, ...]]) -> None:
    """Checks that a suite evaluates one of the policies at all.

    Args:
        suite: the suite.
        policies: names of the policies by environment, from :func:`find_policies`.

    Raises:
        ValueError: if not. The message lists those that it evaluates.
    """
    asked = list(dict.fromkeys(chain.from_iterable(policies.values())))
    evaluated: dict[str, None] = {}
    for block in suite.blocks:
        if _included(block, asked):
            return
        evaluated |= dict.fromkeys(_included(block, list(public_entries())))
    raise ValueError(
        f"suite {suite.name!r} does not evaluate {', '.join(asked)}: choose from "
        f"{', '.join(evaluated)}, or another suite"
    )


def suite_cells(
    suite: Suite,
    policies: Mapping[str, tuple[str, ...]],
    *,
    seed: int = 0,
    seed_text: str | None = None,
) -> dict[str, Cell]:
    """The cells by key, grouped by environment; the best known payloads of an environment come
    first.

    Args:
        suite: the suite.
        policies: names of the policies by environment, from :func:`find_policies`.
        seed: evaluation seed.
        seed_text: public text from which the hidden motions follow; None for suites without.
    """
    cells: list[Cell] = []
    asked = list(dict.fromkeys(chain.from_iterable(policies.values())))
    for env_id, names in policies.items():
        if suite.best_known:
            for block in suite.blocks:
                if block.is_nominal:
                    cells += _best_known_cells(block, env_id, seed_text)
            for block in suite.blocks:  # the yardsticks of surveys under uncertainty
                uncertainty = block.conditions.get("uncertainty")
                if block.survey and uncertainty is not None:
                    motions = _best_known_cells(block, env_id, seed_text)
                    cells += drawn_cells(motions, uncertainty, seed)
        for block in suite.blocks:
            if not block.env_ids:
                cells += _policy_cells(block, env_id, names, seed_text, seed)
            elif env_id in block.env_ids:
                cells += _policy_cells(block, env_id, asked, seed_text, seed)
        if suite.timing:
            (circle,) = _tasks(env_id, Block(motion="circle"), seed_text)
            cells += [TimingCell(env_id=env_id, policy=name, **circle) for name in names]
    return {cell.key: cell for cell in cells}


def _best_known_cells(block: Block, env_id: str, seed_text: str | None) -> list[BestKnownCell]:
    """Cells of the best known payloads on the motions of a block."""
    return [BestKnownCell(env_id=env_id, **task) for task in _tasks(env_id, block, seed_text)]


def _policy_cells(
    block: Block,
    env_id: str,
    names: Sequence[str],
    seed_text: str | None,
    seed: int,
) -> list[PolicyCell]:
    included = _included(block, names)
    tasks = _tasks(env_id, block, seed_text)
    cells: list[PolicyCell] = []
    if block.survey:
        for name, conditions in product(included, block.combinations(env_id)):
            # the motions of the policy in one trajectory with a list of seeds
            count = surveyed_motions(name, env_id, block.surveyed or block.motions)
            seeds = [task["trajectory"]["seed"] for task in tasks[:count]]
            motions = tasks[0] | {"trajectory": tasks[0]["trajectory"] | {"seed": seeds}}
            data = {"env_id": env_id, "policy": name, **motions, "seed": seed}
            cells.append(SurveyCell(**data | conditions))
        return cells
    for task, name, conditions in product(tasks, included, block.combinations(env_id)):
        data = {"env_id": env_id, "policy": name, **task} | conditions
        if block.one_at_a_time and data["uncertainty"] is None:
            data["draws"] = 1
        if block.motion == "library":
            payload_range = find_robot(task["robot_name"]).defaults.payload_range
            if payload_range is not None:
                data["resolution"] = OWN_RESOLUTION * payload_range[1]
        cells.append(PolicyCell(seed=seed, **data))
    return cells


def surveyed_motions(policy: str, env_id: str, motions: int) -> int:
    """How many of a number of hidden motions a policy has in a survey: those that ranks need if it is
    slow or plans, else all of the environment."""
    entry = public_entry(policy)
    if entry is not None and (entry.slow or entry.plans):
        return min(motions, RANKED_MOTIONS)
    return hidden_motions(env_id, motions)


QUICK_ENV_IDS = PAPER_ENV_IDS[:3]
"""Environments whose best known payloads take less than a minute each. Those of the other ones take
minutes."""


def hidden_motions(env_id: str, motions: int) -> int:
    """How many of a number of hidden motions an environment has: all of :data:`QUICK_ENV_IDS`, those
    that ranks need on others."""
    if env_id in QUICK_ENV_IDS:
        return motions
    return min(motions, RANKED_MOTIONS)


def _included(block: Block, names: Sequence[str]) -> list[str]:
    """Names of the policies that a block evaluates."""
    included = []
    for name in block.policies or names:
        entry = public_entry(name)
        is_slow = entry is not None and entry.slow
        if name in names and (block.slow or not is_slow):
            included.append(name)
    return included


def _tasks(env_id: str, block: Block, seed_text: str | None) -> list[dict[str, Any]]:
    """Tasks of a block as fields of cells: the motion, and in ``library`` blocks also the robot and
    the error bounds."""
    if block.motion == "library":
        tasks = []
        for name in (*library(), *(ELASTIC + name for name in library())):
            if fitting_env_id(name) != env_id:
                continue
            robot = find_robot(name)
            trajectory = default_trajectory(robot)
            if isinstance(trajectory, str):
                trajectory = {"name": trajectory}
            task = {
                "robot_name": name,
                "trajectory": to_jsonable(trajectory),
                "error_bounds": to_jsonable(find_error_bounds(None, robot)),
            }
            tasks.append(task)
        return tasks
    bounds = to_jsonable(find_error_bounds(None, find_robot(env_id)))
    return [
        {"trajectory": motion, "error_bounds": bounds}
        for motion in _motions(env_id, block, seed_text)
    ]


def _motions(env_id: str, block: Block, seed_text: str | None) -> list[dict[str, Any]]:
    kind = find_robot(env_id).kind
    if block.motion in ("circle", "paper"):
        name = f"{block.motion}-{kind}"
        return [{"name": name}] if name in TRAJECTORIES else []
    seeds: Sequence[int]
    if block.motion != "hidden":
        seeds = held_out_seeds(block.motions)
    elif seed_text is None:
        raise ValueError(
            "hidden motions need a public text: add --seed-text TEXT, such as the headline of a day "
            "after the policies are final"
        )
    else:
        seeds = hidden_seeds(seed_text, env_id, hidden_motions(env_id, block.motions))
    return [{"name": f"loop-{kind}", "seed": seed} for seed in seeds]


def _check_loadable(name: str, env_ids: Sequence[str]) -> None:
    """Raises a ValueError if a policy can be loaded for none of the environments. It is loaded in a
    process of its own."""
    errors: list[Exception] = []
    for env_id in env_ids:
        try:
            IsolatedPolicy(name, env_id).close()
        except (ValueError, PolicyError) as error:
            errors.append(error)
    if len(errors) == len(env_ids):
        raise ValueError(str(errors[0])) from errors[0]
