"""Reference motions with time derivatives in closed form: the paper's circles, smooth motions, random
loops.

Most named motions are :class:`~cablebot_gym.motions.sequences.BetweenDwells`: the robot rests
at the start pose first and at the end pose last.

A custom motion is any object with ``name``, ``duration``, ``coordinates`` and ``__call__(times) ->
Reference``, see the :class:`~cablebot_gym.motions.base.Trajectory` protocol. Positions are in
m, angles in rad and times in s; z points down.

* ``base``: the protocol, the values of a motion, and a base class.
* ``motions``: circles, dwells, lines and lemniscates.
* ``spline``: a curve through waypoints.
* ``loops``: random loops and their seeds.
* ``sequences``: motions between dwells.
* ``pieces``: many curves evaluated at once.
* ``names``: motions by name, from files and from data.
"""

from cablebot_gym.motions.base import (
    ORDERS,
    Reference,
    Trajectory,
    sampled,
)
from cablebot_gym.motions.curves import (
    Dwell,
    Lemniscate,
    PaperCircle,
    PointToPoint,
    SmoothCircle,
)
from cablebot_gym.motions.loops import (
    FIRST_HELD_OUT_SEED,
    TRAINING_SEEDS,
    RandomLoop,
    held_out_seeds,
)
from cablebot_gym.motions.names import (
    TRAJECTORIES,
    find_trajectory,
    random_loop,
    trajectory_names,
)
from cablebot_gym.motions.pieces import Pieces
from cablebot_gym.motions.sequences import BetweenDwells
from cablebot_gym.motions.spline import Waypoints

__all__ = [
    "FIRST_HELD_OUT_SEED",
    "ORDERS",
    "TRAINING_SEEDS",
    "TRAJECTORIES",
    "BetweenDwells",
    "Dwell",
    "Lemniscate",
    "PaperCircle",
    "Pieces",
    "PointToPoint",
    "RandomLoop",
    "Reference",
    "SmoothCircle",
    "Trajectory",
    "Waypoints",
    "find_trajectory",
    "held_out_seeds",
    "random_loop",
    "sampled",
    "trajectory_names",
]
