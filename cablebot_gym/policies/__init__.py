"""The policy protocol, and how a policy's name becomes a loaded policy."""

from cablebot_gym.policies.adapters import PolicyFactory, as_policy
from cablebot_gym.policies.protocol import (
    Declarations,
    LoadedPolicy,
    Policy,
    PolicyEntry,
    PolicyError,
    name_of,
)
from cablebot_gym.policies.spec import (
    ENTRY_POINT_GROUP,
    FILE_ENTRY_POINT_GROUP,
    FileLoader,
    PolicySpec,
    load,
    load_policy,
    policy_entries,
)
from cablebot_gym.policies.wrappers import Wrapper

__all__ = [
    "ENTRY_POINT_GROUP",
    "FILE_ENTRY_POINT_GROUP",
    "Declarations",
    "FileLoader",
    "LoadedPolicy",
    "Policy",
    "PolicyEntry",
    "PolicyError",
    "PolicyFactory",
    "PolicySpec",
    "Wrapper",
    "as_policy",
    "load",
    "load_policy",
    "name_of",
    "policy_entries",
]
