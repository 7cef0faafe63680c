"""Pictures of a robot at work: what there is to see, from where, and how it is painted.

Knows robots and motions, not environments: these hand over a :class:`Moment`. Painting needs the extra ``render``.
"""

from cablebot_gym.rendering.moment import Moment, Scene

__all__ = ["Moment", "Scene"]
