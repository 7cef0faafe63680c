"""Suites of the benchmark, and the cells and policies that they contain."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cablebot_gym.benchmark.board import Board
from cablebot_gym.benchmark.cells import (
    BestKnownCell,
    Cell,
    PolicyCell,
    TimingCell,
    cell_from_dict,
    merged,
)
from cablebot_gym.benchmark.maps import AXES, AnyCell
from cablebot_gym.envs import FLEXIBLE_ENV_IDS, PAPER_ENV_IDS, env_robot, fitting_env_id
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.evaluation.statistics import fewest_draws
from cablebot_gym.isolation import IsolatedPolicy
from cablebot_gym.isolation.installed import public_entries, public_entry
from cablebot_gym.policies.entry import is_entry, read_entry
from cablebot_gym.policies.protocol import PolicyError
from cablebot_gym.robots import ELASTIC, find_robot, library
from cablebot_gym.task import find_error_bounds, to_jsonable
from cablebot_gym.trajectories import held_out_seeds
from cablebot_gym.utils.checks import choice

REAL_TIME_DRAWS = fewest_draws(0.95, 0.95)
"""Number of repeats of each episode in real time without uncertainty: computing times differ
between runs."""

OWN_RESOLUTION = 1e-3
"""Payload resolution of robots with a payload range of their own, as a fraction of its end."""


@dataclass(frozen=True, kw_only=True)
class Block:
    """Conditions under which every policy is evaluated. All combinations of the tuples are
    cells."""

    policies: tuple[str, ...] = ()
    """The only policies of the block; all policies if empty."""
    motion: str = "circle"
    """Motion: ``circle``, the circle between dwells; ``paper``, the circle as printed; ``loop``,
    held-out motions; ``hidden``, the hidden motions of a board; or ``library``, the robots of the
    library that fit the environment, each with its own motion, error bounds and payload range."""
    motions: int = 1
    """Number of held-out or hidden motions."""
    payload_known: tuple[bool, ...] = (True,)
    """Whether the policies' models include the payload."""
    model_payload_factors: tuple[float, ...] = (1.0,)
    """Ratios of the policies' model payload to the nominal payload."""
    criterion: str = "task"
    """DLCC criterion. ``paper`` applies to laws that declare ``unsaturated_actions``, and is never
    ranked."""
    uncertainty: str | None = None
    """Name of an uncertainty; None for none."""
    draws: int = 1
    """Number of draws that confirm a payload; 1 without uncertainty."""
    axis: str | None = None
    """Name of the varied parameter, see :data:`~cablebot_gym.benchmark.maps.AXES`; None for none.
    Rigid robots have no joint stiffness, and flexible ones no varied pulley friction."""
    values: tuple[float, ...] = ()
    """Values of the varied parameter, SI."""
    changes: Mapping[str, Any] = field(default_factory=dict)
    """Further fields of the policies' cells; nested mappings change the values that they name."""
    slow: bool = False
    """Whether to include policies whose entry is marked as slow."""


@dataclass(frozen=True, kw_only=True)
class Suite:
    """A set of cells, given as conditions for all policies."""

    name: str
    """Value of ``--suite``."""
    summary: str
    """Description in one line."""
    blocks: tuple[Block, ...]
    """Conditions."""
    env_ids: tuple[str, ...] = PAPER_ENV_IDS
    """Environment ids."""
    best_known: bool = True
    """Whether to compute the best known payloads."""
    timing: bool = False
    """Whether to measure the computing time per action of every policy."""

    @property
    def hidden(self) -> int:
        """Number of hidden motions of each environment, which take a board."""
        return max((block.motions for block in self.blocks if block.motion == "hidden"), default=0)


def _suites() -> Iterator[Suite]:
    """Suites from suites.toml. The ``defaults`` of a suite are fields of all its blocks."""
    data = tomllib.loads(
        (files("cablebot_gym.benchmark") / "suites.toml").read_text(encoding="utf-8")
    )
    for name, suite in data.items():
        defaults = suite.pop("defaults", {})
        blocks = tuple(Block(**_tuples(merged(defaults, block))) for block in suite.pop("blocks"))
        yield Suite(name=name, blocks=blocks, **_tuples(suite))


def _tuples(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: tuple(value) if isinstance(value, list) else value for name, value in fields.items()
    }


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

    An installed policy and an entry are evaluated on the environments that they support; a policy
    file or a ``package.module:factory`` on all environments.

    Args:
        names: policy names as on the command line; empty for all installed policies.
        env_ids: environments.

    Raises:
        ValueError: if a policy is unknown or supports none of the environments.
    """
    entries = (
        {name: public_entry(name) for name in dict.fromkeys(names)} if names else public_entries()
    )
    supported = {
        name: tuple(env_ids) if entry is None else entry.env_ids for name, entry in entries.items()
    }
    supported |= {name: read_entry(Path(name)).env_ids for name in names if is_entry(name)}
    for name in names:
        fits = [env_id for env_id in env_ids if env_id in supported[name]]
        if not fits:
            raise ValueError(
                f"policy {name!r} supports {', '.join(supported[name])}, not {', '.join(env_ids)}"
            )
        if entries[name] is None:
            _check_loadable(name, fits)
    return {
        env_id: tuple(name for name, own in supported.items() if env_id in own)
        for env_id in env_ids
    }


def suite_cells(
    suite: Suite,
    policies: Mapping[str, tuple[str, ...]],
    *,
    seed: int = 0,
    board: Board | None = None,
    real_time: bool = False,
) -> dict[str, Cell]:
    """The cells by key, grouped by environment; the best known payloads of an environment come
    first.

    Args:
        suite: the suite.
        policies: names of the policies by environment, from :func:`find_policies`.
        seed: evaluation seed.
        board: board with the hidden motions; None for suites without.
        real_time: whether late actions are replaced by the last one.
    """
    cells: list[Cell] = []
    for env_id, names in policies.items():
        without = "damping" if env_id in FLEXIBLE_ENV_IDS else "stiffness"
        blocks = [block for block in suite.blocks if block.axis != without]
        for block in blocks if suite.best_known else ():
            if block.criterion == "task" and block.uncertainty is None:
                for task in _tasks(env_id, block, board):
                    cells += _varied(block, BestKnownCell(env_id=env_id, **task))
        for block in blocks:
            cells += _policy_cells(
                block, env_id, names, board, {"seed": seed, "real_time": real_time}
            )
        (circle,) = _tasks(env_id, Block(), board)
        cells += [
            TimingCell(env_id=env_id, policy=name, **circle) for name in names if suite.timing
        ]
    return {cell.key: cell for cell in cells}


def _policy_cells(
    block: Block, env_id: str, names: Sequence[str], board: Board | None, run: Mapping[str, Any]
) -> Iterator[PolicyCell]:
    slow = {name for name in names if (entry := public_entry(name)) is not None and entry.slow}
    included = [
        name
        for name in block.policies or names
        if name in names and (block.slow or name not in slow)
    ]
    for task, name, known, factor in product(
        _tasks(env_id, block, board), included, block.payload_known, block.model_payload_factors
    ):
        own = (
            find_robot(task["robot_name"]).defaults.payload_range
            if block.motion == "library"
            else None
        )
        cell = PolicyCell(
            env_id=env_id,
            policy=name,
            criterion=block.criterion,
            payload_known=known,
            model_payload_factor=factor,
            uncertainty=block.uncertainty,
            draws=max(block.draws, REAL_TIME_DRAWS if run["real_time"] else 1),
            resolution=None if own is None else OWN_RESOLUTION * own[1],
            **task,
            **run,
        )
        changed = cell_from_dict(merged(cell.to_dict(), block.changes))
        assert isinstance(changed, PolicyCell)
        yield from _varied(block, changed)


def _varied(block: Block, cell: AnyCell) -> list[AnyCell]:
    """The cell at every value of the block's axis; the cell alone if the block has no axis."""
    return (
        [AXES[block.axis].with_value(cell, value) for value in block.values]
        if block.axis
        else [cell]
    )


def _tasks(env_id: str, block: Block, board: Board | None) -> list[dict[str, Any]]:
    """Motions, and robots and error bounds if they are not those of the environment, as fields of
    the cells."""
    if block.motion == "library":
        names = [*library(), *(ELASTIC + name for name in library())]
        return [_own_task(name) for name in names if fitting_env_id(name) == env_id]
    return [{"trajectory": motion} for motion in _motions(env_id, block, board)]


def _own_task(name: str) -> dict[str, Any]:
    robot = find_robot(name)
    own = default_trajectory(robot)
    bounds = find_error_bounds(None, robot)
    motion = {"name": own} if isinstance(own, str) else to_jsonable(own)
    return {"robot_name": name, "trajectory": motion, "error_bounds": to_jsonable(bounds)}


def _motions(env_id: str, block: Block, board: Board | None) -> list[dict[str, Any]]:
    kind = find_robot(env_robot(env_id)).kind
    if block.motion in ("circle", "paper"):
        return [{"name": f"{block.motion}-{kind}"}]
    if block.motion == "hidden" and board is None:
        raise ValueError(
            "hidden motions need a board: commit one first, with the option --commit VERSION"
        )
    seeds = (
        board.seeds(env_id, block.motions)
        if board and block.motion == "hidden"
        else held_out_seeds(block.motions)
    )
    return [{"name": f"loop-{kind}", "seed": seed} for seed in seeds]


def _check_loadable(name: str, env_ids: Sequence[str]) -> None:
    """Rejects a policy that cannot be loaded for any of the environments. It is loaded in a process
    of its own."""
    errors: list[Exception] = []
    for env_id in env_ids:
        try:
            IsolatedPolicy(name, find_robot(env_robot(env_id))).close()
        except (ValueError, PolicyError) as error:
            errors.append(error)
    if len(errors) == len(env_ids):
        raise ValueError(str(errors[0])) from errors[0]
