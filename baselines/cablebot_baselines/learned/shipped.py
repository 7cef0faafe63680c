"""The learned policies that ship: their table, and how a name becomes a policy by the weights beside; no torch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType

from cablebot_gym.envs import ENV_IDS, env_robot
from cablebot_gym.policies import Policy, PolicyEntry
from cablebot_gym.robots import Robot, find_robot

WEIGHTS = Path(__file__).parent / "weights"
"""Folder of the files that ship: ``NAME-KIND.zip``, a bundle, and its card ``NAME-KIND.json``; see :func:`stem`."""


@dataclass(frozen=True, kw_only=True)
class Condition:
    """What a policy knows while it is judged on the paper's circle."""

    told: bool = True
    """Whether it is told the payload."""
    uncertainty: str | None = None
    """Name of what else it does not know, over draws; None for nothing."""


TOLD, UNTOLD = Condition(), Condition(told=False)


@dataclass(frozen=True, kw_only=True)
class Shipped:
    """A learned policy that ships: how it is trained, where, and how it is judged."""

    name: str
    """What to type after ``--policy``."""
    algorithm: str
    """Of ``cablebot train --algo``."""
    config: str | None
    """Name of its file of hyperparameters; None for the one that its algorithm reads anyway."""
    env_ids: tuple[str, ...]
    """Environments with weights of their own."""
    summary: str
    """One line."""
    conditions: tuple[Condition, ...]
    """Under which it is judged; by the first one the seed that ships is chosen."""


SHIPPED = MappingProxyType(
    {
        one.name: one
        for one in (
            Shipped(
                name="ppo",
                algorithm="ppo",
                config=None,
                env_ids=("CableBot-Spatial-v0",),
                summary="PPO: shifts the reference of the base law on the paper's circle, whose payload it is told",
                conditions=(TOLD, UNTOLD),
            ),
            Shipped(
                name="curve",
                algorithm="gradient",
                config="gradient",
                env_ids=("CableBot-Planar-v0", "CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"),
                summary="by gradients: a shift of the paper's circle that knows the time alone",
                conditions=(TOLD, UNTOLD),
            ),
            Shipped(
                name="curve-safe",
                algorithm="gradient",
                config="gradient-safe",
                env_ids=("CableBot-Spatial-v0",),
                summary="curve with margins, on a law that weighs its payload: for table6 and noisy sensors",
                conditions=(
                    UNTOLD,
                    TOLD,
                    Condition(told=False, uncertainty="sensors"),
                    Condition(uncertainty="sensors"),
                    Condition(told=False, uncertainty="table6"),
                    Condition(uncertainty="table6"),
                ),
            ),
            Shipped(
                name="preview",
                algorithm="gradient",
                config="gradient-preview",
                env_ids=ENV_IDS,
                summary="by gradients on many random loops: reads what is ahead, on motions that it has never seen too",
                conditions=(TOLD, UNTOLD),
            ),
        )
    }
)
"""By name."""


def find_shipped(name: str) -> Shipped:
    """A policy that ships by name.

    Raises:
        ValueError: if there is none of this name, naming those there are.
    """
    if name not in SHIPPED:
        raise ValueError(f"no learned policy {name!r} ships; choose one of {', '.join(SHIPPED)}")
    return SHIPPED[name]


def stem(name: str, env_id: str) -> str:
    """Name of a policy's files without their suffix, such as ``curve-flexspatial``."""
    return f"{name}-{short_id(env_id).lower()}"


def weights_file(name: str, env_id: str, folder: Path = WEIGHTS) -> Path:
    """Of a policy's bundle."""
    return folder / f"{stem(name, env_id)}.zip"


def short_id(env_id: str) -> str:
    """An environment's id without what all ids share."""
    return env_id.removeprefix("CableBot-").removesuffix("-v0")


def env_id_of(robot: Robot) -> str:
    """The environment whose robots are of this one's kind."""

    def kind(one: Robot) -> tuple[bool, bool]:
        return one.planar, one.flexible

    return next(env_id for env_id in ENV_IDS if kind(find_robot(env_robot(env_id))) == kind(robot))


def load_shipped(name: str, robot: Robot, folder: Path = WEIGHTS) -> Policy:
    """A policy that ships, for a nominal robot: the weights of the robot's kind.

    Args:
        name: of :data:`SHIPPED`.
        robot: nominal.
        folder: of the weights.

    Raises:
        ValueError: if the name is unknown, there are no weights for robots of this kind, they are damaged, or the
            robot's observation is another one than that of the robot trained on.
    """
    from cablebot_baselines.learned.bundle import Bundle  # not at import: listing policies does not need them
    from cablebot_baselines.learned.policy import LearnedPolicy

    shipped, env_id = find_shipped(name), env_id_of(robot)
    path = weights_file(name, env_id, folder)
    if env_id not in shipped.env_ids:
        others = ", ".join(other.name for other in SHIPPED.values() if env_id in other.env_ids)
        raise ValueError(
            f"policy {name!r} ships for {', '.join(shipped.env_ids)}, not for {env_id}: choose {others}, or train it "
            f"with `cablebot train {env_id} --algo {shipped.algorithm} --out FOLDER` and name FOLDER/best.zip"
        )
    if not path.is_file():
        files = [weights_file(name, one, folder) for one in shipped.env_ids]
        there = ", ".join(one.name for one in files if one.is_file()) or "none"
        raise ValueError(
            f"policy {name!r} has no weights for {env_id}: of its files {path.name} is missing (there: {there}); "
            f"install the package anew, or make them: python scripts/train_shipped.py --policy {name} --id {env_id}"
        )
    return LearnedPolicy(Bundle.load(path), robot)


def _entry(name: str) -> PolicyEntry:
    shipped = SHIPPED[name]
    return PolicyEntry(
        name=name,
        kind="learned",
        env_ids=shipped.env_ids,
        factory=partial(load_shipped, name),
        summary=shipped.summary,
        files=tuple(path for env_id in shipped.env_ids if (path := weights_file(name, env_id)).is_file()),
    )


PPO = _entry("ppo")
CURVE = _entry("curve")
CURVE_SAFE = _entry("curve-safe")
PREVIEW = _entry("preview")
