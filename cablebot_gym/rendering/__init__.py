"""Pictures of robots: moments, camera, painter and window.

This package does not depend on environments, which pass the task and a
:class:`~cablebot_gym.rendering.moment.Moment` to it. Painting requires the extra ``render``.
"""
