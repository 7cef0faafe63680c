"""The paper's tables, figures and claims, made again: the same as ``cablebot reproduce``, whose options it takes.

Example: python scripts/reproduce_paper.py --only fig10 --out reproduction
"""

from __future__ import annotations

import sys

from cablebot_gym.cli import main

if __name__ == "__main__":
    sys.argv.insert(1, "reproduce")
    main()
