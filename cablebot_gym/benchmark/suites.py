"""Which cells a benchmark has: suites as data, and the policies that take part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
from typing import Any

from cablebot_gym.benchmark.cells import BestCell, Cell, PolicyCell
from cablebot_gym.benchmark.maps import AXES
from cablebot_gym.envs import ENV_IDS, FLEXIBLE_ENV_IDS, env_robot
from cablebot_gym.policies import load_policy, policy_entries
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import held_out_seeds
from cablebot_gym.utils.suggestions import no_such


@dataclass(frozen=True, kw_only=True)
class Block:
    """Conditions under which every policy is asked, all combinations."""

    loops: int = 0
    """Held-out motions; 0 for the paper's circle."""
    information: tuple[str, ...] = ("told", "untold")
    """Information sets, see :data:`~cablebot_gym.benchmark.cells.TOLD_SHARE`."""
    criterion: str = "task"
    """``paper`` is asked of laws that declare ``unclipped``, and is never ranked."""
    uncertainty: str | None = None
    """Name of what else the policies do not know."""
    draws: int = 1
    """Episodes at each payload."""
    axis: str | None = None
    """Name of what is varied, see :data:`~cablebot_gym.benchmark.maps.AXES`; None for nothing."""
    slow: bool = False
    """Whether policies whose entry says that they are slow take part."""


@dataclass(frozen=True, kw_only=True)
class Suite:
    """A benchmark."""

    name: str
    """What ``--suite`` takes."""
    summary: str
    """One line."""
    env_ids: tuple[str, ...]
    """Environments."""
    blocks: tuple[Block, ...]
    """Conditions."""


_WRONG = ("told-0.9", "told-1.1")

SUITES = MappingProxyType(
    {
        suite.name: suite
        for suite in (
            Suite(
                name="smoke",
                summary="planar robot, circle and one held-out motion; under two minutes",
                env_ids=("CableBot-Planar-v0",),
                blocks=(Block(), Block(loops=1)),
            ),
            Suite(
                name="standard",
                summary="every id, circle with and without uncertainty, three held-out motions; under half an hour",
                env_ids=ENV_IDS,
                blocks=(
                    Block(slow=True),
                    Block(information=_WRONG),
                    Block(information=("told",), criterion="paper"),
                    Block(uncertainty="table6", draws=32),
                    Block(information=("untold",), uncertainty="sensors", draws=32),
                    Block(loops=3),
                ),
            ),
            Suite(
                name="full",
                summary="as standard, with 256 draws, both uncertainties together and twenty held-out motions; hours",
                env_ids=ENV_IDS,
                blocks=(
                    Block(slow=True),
                    Block(information=_WRONG, slow=True),
                    Block(information=("told",), criterion="paper"),
                    Block(uncertainty="table6", draws=256),
                    Block(uncertainty="sensors", draws=256),
                    Block(uncertainty="table6+sensors", draws=256),
                    Block(loops=20, slow=True),
                    Block(loops=20, information=_WRONG),
                ),
            ),
            Suite(
                name="maps",
                summary="every id's circle under other bounds R, durations and joint stiffness K; an hour",
                env_ids=ENV_IDS,
                blocks=tuple(Block(information=("told",), axis=axis) for axis in AXES),
            ),
        )
    }
)
"""Suites by name."""


def find_suite(name: str) -> Suite:
    """A suite by name.

    Raises:
        ValueError: if there is none of this name, naming those there are.
    """
    if name not in SUITES:
        raise ValueError(no_such("suite", name, SUITES))
    return SUITES[name]


def find_env_ids(suite: Suite, env_ids: Sequence[str]) -> tuple[str, ...]:
    """The environments ``env_ids``, or all of a suite for none, in the suite's order.

    Raises:
        ValueError: if one is unknown, or is not in the suite.
    """
    for env_id in env_ids:
        env_robot(env_id)
        if env_id not in suite.env_ids:
            raise ValueError(f"suite {suite.name!r} does not have {env_id}; its ids are {', '.join(suite.env_ids)}")
    return tuple(env_id for env_id in suite.env_ids if not env_ids or env_id in env_ids)


def find_policies(names: Sequence[str], env_ids: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Policies for each environment of ``env_ids``: those of these names, or all installed ones for none.

    An installed policy takes part where it is made for, a file or a ``package.module:factory`` everywhere.

    Raises:
        ValueError: if one is unknown, or cannot be made for any of the environments.
    """
    entries = policy_entries()
    chosen = list(dict.fromkeys(names)) or list(entries)
    made_for = {name: entries[name].env_ids if name in entries else tuple(env_ids) for name in chosen}
    for name in names:
        fits = [env_id for env_id in env_ids if env_id in made_for[name]]
        if not fits:
            raise ValueError(f"policy {name!r} is made for {', '.join(made_for[name])}, not for {', '.join(env_ids)}")
        if name not in entries:
            _check_made(name, fits)
    return {env_id: tuple(name for name in chosen if env_id in made_for[name]) for env_id in env_ids}


def suite_cells(suite: Suite, policies: dict[str, tuple[str, ...]]) -> dict[str, Cell]:
    """The cells by key, those of each environment together, the best found first.

    Args:
        suite: what to ask.
        policies: of each environment that is to be asked, from :func:`find_policies`.
    """
    cells: list[Cell] = []
    slow = {name for name, entry in policy_entries().items() if entry.slow}
    for env_id, names in policies.items():
        own = [block for block in suite.blocks if block.axis != "stiffness" or env_id in FLEXIBLE_ENV_IDS]
        for block in own:
            for motion in _motions(env_id, block.loops):
                cells += _varied(block, BestCell(env_id=env_id, trajectory=motion))
        for block in own:
            asked = [name for name in names if block.slow or name not in slow]
            for motion, name, information in product(_motions(env_id, block.loops), asked, block.information):
                cells += _varied(
                    block,
                    PolicyCell(
                        env_id=env_id,
                        trajectory=motion,
                        policy=name,
                        criterion=block.criterion,
                        information=information,
                        uncertainty=block.uncertainty,
                        draws=block.draws,
                    ),
                )
    return {cell.key: cell for cell in cells}


def _varied(block: Block, cell: Cell) -> list[Cell]:
    """The cell at every value of the block's axis."""
    if block.axis is None:
        return [cell]
    axis = AXES[block.axis]
    return [axis.put(cell, value) for value in axis.values]


def _motions(env_id: str, loops: int) -> list[dict[str, Any]]:
    kind = "planar" if find_robot(env_robot(env_id)).planar else "spatial"
    if not loops:
        return [{"name": f"paper-{kind}"}]
    return [{"name": f"loop-{kind}", "seed": seed} for seed in held_out_seeds(loops)]


def _check_made(name: str, env_ids: Sequence[str]) -> None:
    """Refuses what is no policy anywhere; one that is made for some robots only fails in the cells of the others."""
    refused: list[ValueError] = []
    for env_id in env_ids:
        try:
            load_policy(name, find_robot(env_robot(env_id)))
        except ValueError as error:
            refused.append(error)
    if len(refused) == len(env_ids):
        raise refused[0]
