"""Suites of the benchmark as data, and the cells and policies that they contain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
from typing import Any

from cablebot_gym.benchmark.cells import BestKnownCell, Cell, PolicyCell
from cablebot_gym.benchmark.maps import AXES
from cablebot_gym.envs import ENV_IDS, FLEXIBLE_ENV_IDS, env_robot
from cablebot_gym.policies import load_policy, policy_entries
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import held_out_seeds
from cablebot_gym.utils.checks import unknown_name_error


@dataclass(frozen=True, kw_only=True)
class Block:
    """Conditions under which every policy is evaluated. All combinations of the tuples are cells."""

    loops: int = 0
    """Number of held-out motions; 0 for the paper's circle."""
    payload_known: tuple[bool, ...] = (True, False)
    """Whether the policies' models include the payload."""
    model_payload_factors: tuple[float, ...] = (1.0,)
    """Ratios of the policies' model payload to the nominal payload."""
    criterion: str = "task"
    """DLCC criterion. ``paper`` applies to laws that declare ``unsaturated_actions``, and is never ranked."""
    uncertainty: str | None = None
    """Name of an uncertainty; None for none."""
    draws: int = 1
    """Number of sampled episodes per payload."""
    axis: str | None = None
    """Name of the varied parameter, see :data:`~cablebot_gym.benchmark.maps.AXES`; None for none."""
    slow: bool = False
    """Whether to include policies whose entry is marked as slow."""


@dataclass(frozen=True, kw_only=True)
class Suite:
    """A set of cells, given as conditions for all policies."""

    name: str
    """Value of ``--suite``."""
    summary: str
    """Description in one line."""
    env_ids: tuple[str, ...]
    """Environment ids."""
    blocks: tuple[Block, ...]
    """Conditions."""


_WRONG: dict[str, Any] = {"payload_known": (True,), "model_payload_factors": (0.9, 1.1)}
"""A payload model that is wrong by 10 %."""

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
                summary="all environments, circle with and without uncertainty, 3 held-out motions; under half an hour",
                env_ids=ENV_IDS,
                blocks=(
                    Block(slow=True),
                    Block(**_WRONG),
                    Block(payload_known=(True,), criterion="paper"),
                    Block(uncertainty="table6", draws=32),
                    Block(payload_known=(False,), uncertainty="sensors", draws=32),
                    Block(loops=3),
                ),
            ),
            Suite(
                name="full",
                summary="standard with 256 draws, combined uncertainties and 20 held-out motions; hours",
                env_ids=ENV_IDS,
                blocks=(
                    Block(slow=True),
                    Block(**_WRONG, slow=True),
                    Block(payload_known=(True,), criterion="paper"),
                    Block(uncertainty="table6", draws=256),
                    Block(uncertainty="sensors", draws=256),
                    Block(uncertainty="table6+sensors", draws=256),
                    Block(loops=20, slow=True),
                    Block(loops=20, **_WRONG),
                ),
            ),
            Suite(
                name="maps",
                summary="circle of all environments for varied error bound R, duration and joint stiffness K; an hour",
                env_ids=ENV_IDS,
                blocks=tuple(Block(payload_known=(True,), axis=axis) for axis in AXES),
            ),
        )
    }
)
"""Suites by name."""


def find_suite(name: str) -> Suite:
    """A suite by name.

    Raises:
        ValueError: if the name is unknown. The message lists the valid names.
    """
    if name not in SUITES:
        raise unknown_name_error("suite", name, SUITES)
    return SUITES[name]


def find_env_ids(suite: Suite, env_ids: Sequence[str]) -> tuple[str, ...]:
    """The environments ``env_ids`` in the order of the suite; all environments of the suite if ``env_ids`` is empty.

    Raises:
        ValueError: if an environment is unknown or not part of the suite.
    """
    for env_id in env_ids:
        env_robot(env_id)
        if env_id not in suite.env_ids:
            raise ValueError(f"suite {suite.name!r} does not contain {env_id}; it contains {', '.join(suite.env_ids)}")
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
    entries = policy_entries()
    chosen = list(dict.fromkeys(names)) or list(entries)
    supported = {name: entries[name].env_ids if name in entries else tuple(env_ids) for name in chosen}
    for name in names:
        fits = [env_id for env_id in env_ids if env_id in supported[name]]
        if not fits:
            raise ValueError(f"policy {name!r} supports {', '.join(supported[name])}, not for {', '.join(env_ids)}")
        if name not in entries:
            _check_loadable(name, fits)
    return {env_id: tuple(name for name in chosen if env_id in supported[name]) for env_id in env_ids}


def suite_cells(suite: Suite, policies: dict[str, tuple[str, ...]]) -> dict[str, Cell]:
    """The cells by key, grouped by environment; the best known payloads of an environment come first.

    Args:
        suite: the suite.
        policies: names of the policies by environment, from :func:`find_policies`.
    """
    cells: list[Cell] = []
    slow = {name for name, entry in policy_entries().items() if entry.slow}
    for env_id, names in policies.items():
        blocks = [block for block in suite.blocks if block.axis != "stiffness" or env_id in FLEXIBLE_ENV_IDS]
        for block in blocks:
            for motion in _motions(env_id, block.loops):
                cells += _varied(block, BestKnownCell(env_id=env_id, trajectory=motion))
        for block in blocks:
            included = [name for name in names if block.slow or name not in slow]
            for motion, name, known, factor in product(
                _motions(env_id, block.loops), included, block.payload_known, block.model_payload_factors
            ):
                cells += _varied(
                    block,
                    PolicyCell(
                        env_id=env_id,
                        trajectory=motion,
                        policy=name,
                        criterion=block.criterion,
                        payload_known=known,
                        model_payload_factor=factor,
                        uncertainty=block.uncertainty,
                        draws=block.draws,
                    ),
                )
    return {cell.key: cell for cell in cells}


def _varied(block: Block, cell: Cell) -> list[Cell]:
    """The cell at every value of the block's axis; the cell alone if the block has no axis."""
    if block.axis is None:
        return [cell]
    axis = AXES[block.axis]
    return [axis.with_value(cell, value) for value in axis.values]


def _motions(env_id: str, loops: int) -> list[dict[str, Any]]:
    kind = "planar" if find_robot(env_robot(env_id)).planar else "spatial"
    if not loops:
        return [{"name": f"paper-{kind}"}]
    return [{"name": f"loop-{kind}", "seed": seed} for seed in held_out_seeds(loops)]


def _check_loadable(name: str, env_ids: Sequence[str]) -> None:
    """Rejects a policy that cannot be loaded for any of the environments."""
    errors: list[ValueError] = []
    for env_id in env_ids:
        try:
            load_policy(name, find_robot(env_robot(env_id)))
        except ValueError as error:
            errors.append(error)
    if len(errors) == len(env_ids):
        raise errors[0]
