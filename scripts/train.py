"""A learned policy, trained: the same as ``cablebot train``, whose arguments it takes.

Example: python scripts/train.py CableBot-Spatial-v0 --algo ppo --seed 0 --out runs/spatial
"""

from __future__ import annotations

import sys

from cablebot_gym.cli import main

if __name__ == "__main__":
    sys.argv.insert(1, "train")
    main()
