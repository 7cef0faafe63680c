"""Suites of the benchmark, and the rows and policies that they contain."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib.resources import files
from itertools import chain, product
from types import MappingProxyType
from typing import Any

from cablebot_gym.benchmark.policy_source import shipped_entry
from cablebot_gym.benchmark.ranking import RANKED_MOTIONS
from cablebot_gym.benchmark.rows import Row
from cablebot_gym.benchmark.seeds import hidden_seeds
from cablebot_gym.benchmark.yardstick import drawn_rows
from cablebot_gym.envs import PAPER_ENV_IDS, fitting_env_id
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.evaluation.survey import motion_seeds
from cablebot_gym.isolation import IsolatedPolicy
from cablebot_gym.motions import TRAJECTORIES, held_out_seeds
from cablebot_gym.policies.protocol import PolicyError
from cablebot_gym.policies.spec import policy_names
from cablebot_gym.robots import ELASTIC, find_robot, library
from cablebot_gym.uncertainty import single_errors
from cablebot_gym.utils.checks import choice

OWN_RESOLUTION = 1e-3
"""Payload resolution of robots of the library, as a fraction of the end of their payload range."""


_TASK = ("error_bounds", "control_frequency")
"""Conditions on which best known payloads depend, beside robot and motion."""


@dataclass(frozen=True, kw_only=True)
class Override:
    """What differs from the usual conditions in some rows of a suite, and for which policies."""

    policies: Sequence[str] = ()
    """The only policies; all policies if empty."""
    env_ids: Sequence[str] = ()
    """The only environments, whether the entries of the policies name them or not; those of the
    suite and of the entries if empty."""
    slow: bool = False
    """Whether to include policies whose entry is marked as slow."""
    motion: str
    """Motion: ``circle``, the circle between dwells; ``paper``, the circle as printed, for the
    paper's robots; ``loop``, held-out motions; ``hidden``, those that follow from a seed text; or
    ``own``, the robots of the library that fit the environment, each with its own motion."""
    motions: int = 1
    """Number of held-out or hidden motions."""
    single_errors: bool = False
    """Whether there are rows of no error and of each error of the uncertainty alone, beside those of
    all errors."""
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
    def is_nominal(self) -> bool:
        """Whether best known payloads are the yardstick: task criterion, no uncertainty."""
        is_task = self.conditions.get("criterion", "task") == "task"
        return is_task and "uncertainty" not in self.conditions

    def variants(self, env_id: str) -> list[dict[str, Any]]:
        """The conditions, and those of no error and of each single error if these have rows."""
        given = dict(self.conditions)
        if not self.single_errors:
            return [given]
        names = single_errors(given["uncertainty"], find_robot(env_id))
        exact = {key: value for key, value in given.items() if key not in ("uncertainty", "draws")}
        return [exact, *(given | {"uncertainty": name} for name in names), given]


@dataclass(frozen=True, kw_only=True)
class Suite:
    """A set of rows, given as overrides of the usual conditions for all policies."""

    name: str
    """Value of ``--suite``."""
    summary: str
    """Description in one line."""
    overrides: tuple[Override, ...]
    """Overrides of the usual conditions."""
    env_ids: Sequence[str] = PAPER_ENV_IDS
    """Environment ids."""
    best_known: bool = True
    """Whether to compute the best known payloads."""
    reference_motions: int = 1
    """Number of hidden motions of the best known payloads; at least those of the policies."""
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


def check_evaluated(suite: Suite, policies: Mapping[str, tuple[str, ...]]) -> None:
    """Checks that a suite evaluates one of the policies at all.

    Args:
        suite: the suite.
        policies: names of the policies by environment, from :func:`find_policies`.

    Raises:
        ValueError: if not.
    """
    asked = list(dict.fromkeys(chain.from_iterable(policies.values())))
    if not any(_included(override, asked) for override in suite.overrides):
        raise ValueError(
            f"suite {suite.name!r} does not evaluate {', '.join(asked)}: choose another suite"
        )


def suite_rows(
    suite: Suite,
    policies: Mapping[str, tuple[str, ...]],
    *,
    seed: int = 0,
    seed_text: str | None = None,
) -> list[Row]:
    """The rows without results, grouped by environment; the best known payloads of an environment
    come first.

    Args:
        suite: the suite.
        policies: names of the policies by environment, from :func:`find_policies`.
        seed: evaluation seed.
        seed_text: public text from which the hidden motions follow; None for suites without.
    """
    rows: list[Row] = []
    asked = list(dict.fromkeys(chain.from_iterable(policies.values())))
    for env_id, names in policies.items():
        if suite.best_known:
            rows += _references(suite, env_id, seed, seed_text)
        for override in suite.overrides:
            if not override.env_ids:
                rows += _policy_rows(override, env_id, names, seed, seed_text)
            elif env_id in override.env_ids:
                rows += _policy_rows(override, env_id, asked, seed, seed_text)
        if suite.timing:
            (circle,) = _tasks(env_id, Override(motion="circle"), 1, seed_text)
            conditions = Conditions(env_id=env_id, **circle)
            rows += [Row(measure="time", policy=name, conditions=conditions) for name in names]
    return list({row.key: row for row in rows}.values())


def _references(suite: Suite, env_id: str, seed: int, seed_text: str | None) -> list[Row]:
    """The best known payloads, and those of random robots where random motions have an
    uncertainty."""
    nominal: list[Row] = []
    drawn: list[Row] = []
    for override in suite.overrides:
        motions = hidden_motions(env_id, max(override.motions, suite.reference_motions))
        bounds = {name: override.conditions[name] for name in _TASK if name in override.conditions}
        best_known = []
        for task in _tasks(env_id, override, motions, seed_text):
            conditions = Conditions(env_id=env_id, **task, **bounds)
            best_known.append(Row(measure="best-known", conditions=conditions))
        if override.is_nominal:
            nominal += best_known
        elif override.motion == "hidden":
            drawn += drawn_rows(best_known, override.conditions["uncertainty"], seed)
    return nominal + drawn


def _policy_rows(
    override: Override, env_id: str, names: Sequence[str], seed: int, seed_text: str | None
) -> list[Row]:
    included = _included(override, names)
    tasks = _tasks(env_id, override, override.motions, seed_text)
    seeds = [seed] * len(tasks)
    if override.motion in ("loop", "hidden"):  # each motion has robots of its own
        seeds = motion_seeds(seed, len(tasks))
    rows = []
    for name, given in product(included, override.variants(env_id)):
        for task, task_seed in zip(tasks, seeds, strict=True):
            data = {"env_id": env_id, "seed": task_seed, **task, **given}
            conditions = Conditions.from_dict(data)
            rows.append(
                Row(
                    measure="payload",
                    policy=name,
                    conditions=conditions,
                    search=_search(conditions),
                )
            )
    return rows


def _search(conditions: Conditions) -> dict[str, float]:
    """The resolution for a robot with a payload range, see :data:`OWN_RESOLUTION`; none for those of
    the environments."""
    if conditions.robot is None:
        return {}
    payload_range = conditions.nominal_robot.defaults.payload_range
    if payload_range is None:
        return {}
    return {"resolution": OWN_RESOLUTION * payload_range[1]}


QUICK_ENV_IDS = PAPER_ENV_IDS[:3]
"""Environments whose best known payloads take less than a minute each. Those of the other ones take
minutes."""


def hidden_motions(env_id: str, motions: int) -> int:
    """How many of a number of hidden motions an environment has: all of :data:`QUICK_ENV_IDS`, those
    that ranks need on others."""
    if env_id in QUICK_ENV_IDS:
        return motions
    return min(motions, RANKED_MOTIONS)


def _included(override: Override, names: Sequence[str]) -> list[str]:
    """Names of the policies that an override evaluates."""
    included = []
    for name in override.policies or names:
        entry = shipped_entry(name)
        is_slow = entry is not None and entry.slow
        if name in names and (override.slow or not is_slow):
            included.append(name)
    return included


def _tasks(
    env_id: str, override: Override, motions: int, seed_text: str | None
) -> list[dict[str, Any]]:
    """Fields of conditions: the motion, or the robot with its own motion."""
    if override.motion == "own":
        names = [*library(), *(ELASTIC + name for name in library())]
        return [{"robot": name} for name in names if fitting_env_id(name) == env_id]
    kind = find_robot(env_id).kind
    if override.motion in ("circle", "paper"):
        name = f"{override.motion}-{kind}"
        return [{"trajectory": {"name": name}}] if name in TRAJECTORIES else []
    seeds: Sequence[int]
    if override.motion != "hidden":
        seeds = held_out_seeds(motions)
    elif seed_text is None:
        raise ValueError(
            "hidden motions need a public text: add --seed-text TEXT, such as the headline of a day "
            "after the policies are final"
        )
    else:
        seeds = hidden_seeds(seed_text, env_id, motions)
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
