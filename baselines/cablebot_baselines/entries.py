"""Entries of the policies of this package, with the data of ``policies.toml``."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from importlib.resources import files
from typing import Any

from cablebot_gym.envs import ENV_IDS
from cablebot_gym.policies import Policy, PolicyEntry
from cablebot_gym.robots import Robot

DATA: dict[str, dict[str, Any]] = {
    name: data | {"name": name, "env_ids": tuple(data.get("env_ids", ENV_IDS))}
    for name, data in tomllib.loads(
        (files("cablebot_baselines") / "policies.toml").read_text(encoding="utf-8")
    ).items()
}
"""Fields of the entries by the name of the policy."""


def entry(name: str, factory: Callable[[Robot], Policy]) -> PolicyEntry:
    """The entry of a policy in ``policies.toml`` that ``factory`` builds for a nominal robot."""
    return PolicyEntry(factory=factory, **DATA[name])
