"""Writes a video of one control law with two payloads: a feasible one and one that is too large.

Requires the extra "render". Run it: python examples/record_a_video.py [FILE.gif]
"""

import sys
from pathlib import Path

from cablebot_gym import record_rollout
from cablebot_gym.video.recording import write_video

if __name__ == "__main__":
    path = Path(sys.argv[1] if len(sys.argv) > 1 else "video").with_suffix(".gif")
    episodes = [
        ("fl", record_rollout("fl", "CableBot-Planar-v0", payload=payload)) for payload in (1.5, 3.0)
    ]
    write_video(path, episodes, speed=0.5, size=(400, 300))
    print(f"wrote {path}")
