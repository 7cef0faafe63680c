"""Suites of the benchmark, and the rows and policies that they contain."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from importlib.resources import files
from types import MappingProxyType
from typing import Any

from cablebot_gym.benchmark.policy_source import shipped_entry
from cablebot_gym.benchmark.rows import Row
from cablebot_gym.benchmark.seeds import hidden_seeds
from cablebot_gym.benchmark.yardstick import drawn_rows
from cablebot_gym.envs import ENV_IDS
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.evaluation.survey import motion_seeds
from cablebot_gym.isolation import IsolatedPolicy
from cablebot_gym.motions import TRAJECTORIES, held_out_seeds
from cablebot_gym.policies.protocol import PolicyError
from cablebot_gym.policies.spec import policy_names
from cablebot_gym.robots import find_robot
from cablebot_gym.utils.checks import choice

_TASK = ("error_bounds", "control_frequency")
"""Conditions on which optima depend, beside robot and motion."""


@dataclass(frozen=True, kw_only=True)
class Override:
    """What differs from the usual conditions in some rows of a suite."""

    motion: str
    """Motion: ``circle``, the circle between dwells; ``paper``, the circle as printed, for the
    paper's robots; ``loop``, held-out motions; or ``hidden``, those that follow from a seed text."""
    motions: int = 1
    """Number of held-out or hidden motions."""
    conditions: Mapping[str, Any] = field(default_factory=dict)
    """Keywords of :class:`~cablebot_gym.evaluation.conditions.Conditions`."""

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Override:
        """An override of the file of suites: unknown names are fields of the conditions."""
        names = {item.name for item in fields(cls)}
        own = {name: value for name, value in data.items() if name in names}
        conditions = {name: value for name, value in data.items() if name not in names}
        return cls(**own, conditions=conditions)

    @property
    def is_exact(self) -> bool:
        """Whether the robots are exactly known."""
        return "uncertainty" not in self.conditions

    @property
    def has_optima(self) -> bool:
        """Whether optima are the yardstick: task criterion, exactly known robots."""
        return self.is_exact and self.conditions.get("criterion", "task") == "task"


@dataclass(frozen=True, kw_only=True)
class Suite:
    """A set of rows, given as overrides of the usual conditions for all policies."""

    name: str
    """Value of ``--suite``."""
    summary: str
    """Description in one line."""
    overrides: tuple[Override, ...]
    """Overrides of the usual conditions."""
    env_ids: Sequence[str] = ENV_IDS
    """Environment ids."""
    timing: bool = False
    """Whether to measure the computing time per action of every policy."""


def _suites() -> Iterator[Suite]:
    """Suites from suites.toml."""
    data = tomllib.loads(
        (files("cablebot_gym.benchmark") / "suites.toml").read_text(encoding="utf-8")
    )
    for name, suite in data.items():
        overrides = tuple(map(Override.from_dict, suite.pop("overrides")))
        yield Suite(name=name, overrides=overrides, **suite)


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

    A policy of this project is evaluated on the environments that it supports, any other one where
    it can be loaded.

    Args:
        names: policy names as on the command line; empty for all policies of this project.
        env_ids: environments.

    Raises:
        ValueError: if a policy is unknown or supports none of the environments.
    """
    supported: dict[str, Sequence[str]] = {}
    for name in names or policy_names():
        entry = shipped_entry(name)
        if entry is not None:
            supported[name] = entry.env_ids
        elif names:
            supported[name] = _loadable(name, env_ids)
    for name in names:
        if set(env_ids).isdisjoint(supported[name]):
            raise ValueError(
                f"policy {name!r} supports {', '.join(supported[name])}, not {', '.join(env_ids)}"
            )
    by_environment: dict[str, tuple[str, ...]] = {}
    for env_id in env_ids:
        by_environment[env_id] = tuple(name for name in supported if env_id in supported[name])
    return by_environment


def suite_rows(
    suite: Suite,
    policies: Mapping[str, tuple[str, ...]],
    *,
    seed: int = 0,
    seed_text: str | None = None,
) -> list[Row]:
    """The rows without results, grouped by environment; what the motions allow comes first.

    Laws for robots that are exactly known have no rows of other ones.

    Args:
        suite: the suite.
        policies: names of the policies by environment, from :func:`find_policies`.
        seed: evaluation seed.
        seed_text: public text from which the hidden motions follow; None for suites without.
    """
    rows: list[Row] = []
    for env_id, names in policies.items():
        rows += _bounds_of_payloads(suite, env_id, seed, seed_text)
        for override in suite.overrides:
            rows += _policy_rows(override, env_id, names, seed, seed_text)
        if suite.timing:
            (circle,) = _tasks(env_id, Override(motion="circle"), seed_text)
            conditions = Conditions(env_id=env_id, **circle)
            rows += [Row(measure="time", policy=name, conditions=conditions) for name in names]
    return list({row.key: row for row in rows}.values())


def _bounds_of_payloads(suite: Suite, env_id: str, seed: int, seed_text: str | None) -> list[Row]:
    """The optima of the motions, those of random robots on them, and the best known payload of the
    first motion, which shows what replays change."""
    nominal: list[Row] = []
    drawn: list[Row] = []
    for override in suite.overrides:
        bounds = {name: override.conditions[name] for name in _TASK if name in override.conditions}
        optima = []
        for task in _tasks(env_id, override, seed_text):
            conditions = Conditions(env_id=env_id, **task, **bounds)
            optima.append(Row(measure="optimum", conditions=conditions))
        if override.has_optima:
            nominal += optima
        elif override.motion == "hidden":
            drawn += drawn_rows(optima, override.conditions["uncertainty"], seed)
    verified = [replace(row, measure="best-known") for row in nominal[:1]]
    return nominal + verified + drawn


def _policy_rows(
    override: Override, env_id: str, names: Sequence[str], seed: int, seed_text: str | None
) -> list[Row]:
    tasks = _tasks(env_id, override, seed_text)
    seeds = [seed] * len(tasks)
    if override.motion in ("loop", "hidden"):  # each motion has robots of its own
        seeds = motion_seeds(seed, len(tasks))
    rows = []
    for name in names:
        if not override.is_exact and _needs_known_robot(name):
            continue
        for task, task_seed in zip(tasks, seeds, strict=True):
            data = {"env_id": env_id, "seed": task_seed, **task, **override.conditions}
            conditions = Conditions.from_dict(data)
            rows.append(Row(measure="payload", policy=name, conditions=conditions))
    return rows


def _needs_known_robot(name: str) -> bool:
    entry = shipped_entry(name)
    return entry is not None and entry.known_robot


def _tasks(env_id: str, override: Override, seed_text: str | None) -> list[dict[str, Any]]:
    """Fields of conditions: the motions."""
    kind = find_robot(env_id).kind
    if override.motion in ("circle", "paper"):
        name = f"{override.motion}-{kind}"
        return [{"trajectory": {"name": name}}] if name in TRAJECTORIES else []
    seeds: Sequence[int]
    if override.motion != "hidden":
        seeds = held_out_seeds(override.motions)
    elif seed_text is None:
        raise ValueError(
            "hidden motions need a public text: add --seed-text TEXT, such as the headline of a day "
            "after the policies are final"
        )
    else:
        seeds = hidden_seeds(seed_text, env_id, override.motions)
    return [{"trajectory": {"name": f"loop-{kind}", "seed": seed}} for seed in seeds]


def _loadable(name: str, env_ids: Sequence[str]) -> list[str]:
    """The environments for whose robots a policy can be loaded, in a process of its own.

    Raises:
        ValueError: if there is none.
    """
    loadable = []
    errors: list[Exception] = []
    for env_id in env_ids:
        try:
            IsolatedPolicy(name, env_id).close()
            loadable.append(env_id)
        except (ValueError, PolicyError) as error:
            errors.append(error)
    if not loadable:
        raise ValueError(str(errors[0])) from errors[0]
    return loadable
