"""Which policies carry their unloaded platform on robots of ``hardware``, and which say that they do
not."""

import numpy as np
import pytest

from cablebot_gym.envs import env_robot
from cablebot_gym.evaluation import compare_policies
from cablebot_gym.policies import policy_entries
from cablebot_gym.robots import find_robot

MOTIONS = (1, 2)
"""Training seeds of random loops."""

ENTRIES = [
    # Policies that plan rehearse on such robots themselves.
    entry
    for entry in policy_entries().values()
    if entry.kind != "learned" and not entry.plans
]


def carried(entry, env_id):
    """Whether 16 robots carry their platform along each motion, payload unknown."""
    kind = find_robot(env_robot(env_id)).kind
    results = []
    for seed in MOTIONS:
        compared = compare_policies(
            [entry.name],
            env_id,
            payload=0.0,
            payload_known=False,
            trajectory={"name": f"loop-{kind}", "seed": seed},
            uncertainty="hardware",
            draws=16,
            seed=1,
        )
        results.append(compared.metrics[0].carried)
    return np.all(results)


@pytest.mark.slow
@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_only_laws_as_printed_fail_unloaded(entry):
    """A law that is not the paper's has no environment on which it fails; the mark is no excuse for
    a law that needs none."""
    results = {env_id: carried(entry, env_id) for env_id in entry.env_ids}
    assert all(results.values()) == (not entry.as_printed), results
