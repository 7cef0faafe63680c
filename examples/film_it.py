"""A film of one law with two payloads: one that it carries, and one that it does not. Extra render.

Run it: python examples/film_it.py [FILE.gif]
"""

import sys
from pathlib import Path

from cablebot_gym.video.recording import film, write_film

if __name__ == "__main__":
    path = Path(sys.argv[1] if len(sys.argv) > 1 else "film").with_suffix(".gif")
    films = [film("fl", "CableBot-Planar-v0", payload=payload, title="fl") for payload in (1.5, 3.0)]
    write_film(path, films, speed=0.5, size=(400, 300))
    print(f"wrote {path}")
