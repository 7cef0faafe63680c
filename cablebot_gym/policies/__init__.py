"""The policy protocol, and how names and files are loaded as policies."""

from cablebot_gym.policies.loading import (
    ENTRY_POINT_GROUP,
    FILE_ENTRY_POINT_GROUP,
    FileLoader,
    find_policy,
    holds_unsaturated_actions,
    load_policy,
    policy_entries,
    policy_entry,
)
from cablebot_gym.policies.protocol import Policy, PolicyEntry, PolicyError, PolicyFactory, as_policy, name_of
from cablebot_gym.policies.real_time import RealTime
from cablebot_gym.policies.wrapped import WrappedPolicy, Wrapper

__all__ = [
    "ENTRY_POINT_GROUP",
    "FILE_ENTRY_POINT_GROUP",
    "FileLoader",
    "Policy",
    "PolicyEntry",
    "PolicyError",
    "PolicyFactory",
    "RealTime",
    "WrappedPolicy",
    "Wrapper",
    "as_policy",
    "find_policy",
    "holds_unsaturated_actions",
    "load_policy",
    "name_of",
    "policy_entries",
    "policy_entry",
]
