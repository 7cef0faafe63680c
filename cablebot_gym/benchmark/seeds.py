"""Hidden motions and the evaluation seed of a run: SHA-256 of a public text.

Anybody can compute them again. If the text is chosen after the policies are final, nobody can have
made a policy for these motions.
"""

from __future__ import annotations

import hashlib

from cablebot_gym.motions import FIRST_HELD_OUT_SEED

_EVALUATION_DIGITS = 32
"""Number of hexadecimal digits of the evaluation seed, which has 128 bits."""

_MOTION_BITS = 53
"""Motion seeds have 53 bits, so that every JSON parser reads them exactly."""


def evaluation_seed(seed_text: str | None) -> int:
    """Seed of all noise and draws of a run; 0 without a text."""
    if seed_text is None:
        return 0
    return int(_sha256(f"{_sha256(seed_text)}:evaluation")[:_EVALUATION_DIGITS], 16)


def hidden_seeds(seed_text: str, env_id: str, count: int) -> list[int]:
    """Seeds of the first hidden motions of an environment: all of them are held out.

    Args:
        seed_text: public text.
        env_id: environment id.
        count: number of motions. The first seeds do not depend on it.
    """
    digest_of_text = _sha256(seed_text)
    seeds = []
    for index in range(count):
        digest = int(_sha256(f"{digest_of_text}:{env_id}:{index}"), 16)
        seeds.append(FIRST_HELD_OUT_SEED + digest % (2**_MOTION_BITS - FIRST_HELD_OUT_SEED))
    return seeds


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
