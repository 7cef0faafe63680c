"""The policy protocol, and how names and files are loaded as policies."""

from cablebot_gym.policies.loading import (
    ENTRY_POINT_GROUP,
    FILE_ENTRY_POINT_GROUP,
    FileLoader,
    load_policy,
    policy_entries,
    policy_entry,
)
from cablebot_gym.policies.protocol import Policy, PolicyEntry, PolicyError, as_policy, name_of

__all__ = [
    "ENTRY_POINT_GROUP",
    "FILE_ENTRY_POINT_GROUP",
    "FileLoader",
    "Policy",
    "PolicyEntry",
    "PolicyError",
    "as_policy",
    "load_policy",
    "name_of",
    "policy_entries",
    "policy_entry",
]
