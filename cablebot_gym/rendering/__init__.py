"""Pictures of robots: content, camera, painter and window.

This package does not depend on environments, which pass a :class:`Scene` and a :class:`Moment` to it. Painting requires
the extra ``render``.
"""

from cablebot_gym.rendering.moment import Moment, Scene

__all__ = ["Moment", "Scene"]
