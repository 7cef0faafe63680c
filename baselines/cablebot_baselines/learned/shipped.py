"""The shipped learned policies: their table, and loading them by name. This module does not need torch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType

from cablebot_gym.envs import ENV_IDS, env_robot
from cablebot_gym.policies import Policy, PolicyEntry
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.utils.checks import unknown_name_error

WEIGHTS = Path(__file__).parent / "weights"
"""Folder of the shipped files: the bundles ``NAME-KIND.zip`` and their cards ``NAME-KIND.json``; see :func:`stem`."""


@dataclass(frozen=True, kw_only=True)
class Condition:
    """Condition of an evaluation on the paper's circle."""

    payload_known: bool = True
    """Whether the policy's model contains the payload."""
    uncertainty: str | None = None
    """Name of an uncertainty model, sampled in each draw; None for no uncertainty."""


KNOWN, UNKNOWN = Condition(), Condition(payload_known=False)


@dataclass(frozen=True, kw_only=True)
class Shipped:
    """A shipped learned policy: its training, environments and evaluation."""

    name: str
    """Name for ``--policy``."""
    algorithm: str
    """Name for ``cablebot train --algo``."""
    config: str | None
    """Name of the file of hyperparameters; None for the algorithm's default file."""
    env_ids: tuple[str, ...]
    """Ids of the environments with weights."""
    summary: str
    """Description in one line."""
    conditions: tuple[Condition, ...]
    """Conditions of the evaluation; the first one selects the shipped seed."""


SHIPPED = MappingProxyType(
    {
        one.name: one
        for one in (
            Shipped(
                name="ppo-circle",
                algorithm="ppo",
                config=None,
                env_ids=("CableBot-Spatial-v0",),
                summary="PPO: shifts the reference on the paper's circle, payload known",
                conditions=(KNOWN, UNKNOWN),
            ),
            Shipped(
                name="apg-circle",
                algorithm="gradient",
                config="gradient",
                env_ids=("CableBot-Planar-v0", "CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"),
                summary="analytic policy gradient (APG): time-based shift of the paper's circle",
                conditions=(KNOWN, UNKNOWN),
            ),
            Shipped(
                name="apg-circle-margin",
                algorithm="gradient",
                config="gradient-margin",
                env_ids=("CableBot-Spatial-v0",),
                summary="apg-circle with margins for table6 and noise; estimates the payload",
                conditions=(
                    UNKNOWN,
                    KNOWN,
                    Condition(payload_known=False, uncertainty="sensors"),
                    Condition(uncertainty="sensors"),
                    Condition(payload_known=False, uncertainty="table6"),
                    Condition(uncertainty="table6"),
                ),
            ),
            Shipped(
                name="apg-loops",
                algorithm="gradient",
                config="gradient-loops",
                env_ids=ENV_IDS,
                summary="APG on random loops: uses the preview, also works on unseen motions",
                conditions=(KNOWN, UNKNOWN),
            ),
        )
    }
)
"""Shipped policies by name."""


def find_shipped(name: str) -> Shipped:
    """Returns a shipped policy by name.

    Raises:
        ValueError: if the name is unknown; the message lists the known ones.
    """
    if name not in SHIPPED:
        raise unknown_name_error("learned policy", name, SHIPPED)
    return SHIPPED[name]


def stem(name: str, env_id: str) -> str:
    """Name of a policy's files without their suffix, such as ``apg-circle-flexspatial``."""
    return f"{name}-{short_id(env_id).lower()}"


def weights_file(name: str, env_id: str, folder: Path = WEIGHTS) -> Path:
    """Path of a policy's bundle."""
    return folder / f"{stem(name, env_id)}.zip"


def short_id(env_id: str) -> str:
    """An environment's id without the common prefix and suffix."""
    return env_id.removeprefix("CableBot-").removesuffix("-v0")


def env_id_of(robot: Robot) -> str:
    """Id of the environment with the same kind of robot: planar or spatial, rigid or flexible."""

    def kind(one: Robot) -> tuple[bool, bool]:
        return one.planar, one.flexible

    return next(env_id for env_id in ENV_IDS if kind(find_robot(env_robot(env_id))) == kind(robot))


def load_shipped(name: str, robot: Robot, folder: Path = WEIGHTS) -> Policy:
    """Loads a shipped policy for a nominal robot; the robot's kind selects the weights.

    Args:
        name: name in :data:`SHIPPED`.
        robot: nominal robot.
        folder: folder of the weights.

    Raises:
        ValueError: if the name is unknown, the weights for this kind of robot are missing or damaged, or the robot's
            observation differs from the one that the policy was trained on.
    """
    from cablebot_baselines.learned.bundle import Bundle  # imported here: listing policies does not need them
    from cablebot_baselines.learned.policy import LearnedPolicy

    shipped, env_id = find_shipped(name), env_id_of(robot)
    path = weights_file(name, env_id, folder)
    if env_id not in shipped.env_ids:
        others = ", ".join(other.name for other in SHIPPED.values() if env_id in other.env_ids)
        raise ValueError(
            f"policy {name!r} has weights for {', '.join(shipped.env_ids)}, not for {env_id}. Choose {others}, or "
            f"train it with `cablebot train {env_id} --algo {shipped.algorithm} --out FOLDER` and use FOLDER/best.zip"
        )
    if not path.is_file():
        files = [weights_file(name, one, folder) for one in shipped.env_ids]
        present = ", ".join(one.name for one in files if one.is_file()) or "none"
        raise ValueError(
            f"policy {name!r} has no weights for {env_id}: {path.name} is missing (present: {present}). Reinstall the "
            f"package, or train the policy: python scripts/train_shipped.py --policy {name} --id {env_id}"
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


PPO_CIRCLE = _entry("ppo-circle")
APG_CIRCLE = _entry("apg-circle")
APG_CIRCLE_MARGIN = _entry("apg-circle-margin")
APG_LOOPS = _entry("apg-loops")
