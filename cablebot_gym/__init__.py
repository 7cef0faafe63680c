"""Gymnasium environments and a payload benchmark for cable-suspended robots.

Importing registers the ids in :data:`ENV_IDS`; everything heavy is loaded when it is used.

These parameters mean the same everywhere. A docstring names them only where there is more to say:

    robot: with the nominal parameters, without payload.
    env_id: one of :data:`ENV_IDS`.
    cables: their number, m.
    count: how many environments or robots, N.
    part: blocks of an observation by name, as ``layout.split`` gives them.
    observation: of one environment (size,) or of N of them (N, size).
    action: drive commands in [−1, 1], of one environment (m,) or of N of them (N, m).
    state, episode_start, deterministic: as in Stable-Baselines3's ``predict``.
    env: the environment that is wrapped or looked at.
    seed: a non-negative integer; None for a new one.
    payload: added to the platform [kg].
    mass: of the platform and its payload [kg], shape (...).
    pose: X = (x, y) or (x, y, z, ψ, θ, φ) [m, rad], shape (..., n).
    velocity, acceleration: Ẋ and Ẍ, shape (..., n).
    euler: (ψ, θ, φ) [rad], shape (..., 3).
    base, platform: anchors of the cables [m], shape (m, 2) or (m, 3).
    trajectory: the reference motion.
    control_frequency: drive commands per second [Hz].
    draws: of an uncertainty, their number.
    confidence: of an interval or a lower bound, between 0 and 1.
    name: of what is said in results and errors.
    path, folder: where to read or write.
"""

from cablebot_gym.envs import ENV_IDS, register_envs

__version__ = "0.1.0"
__all__ = ["ENV_IDS", "PUBLIC", "__version__"]

PUBLIC = (
    "cablebot_gym",
    "cablebot_gym.bounds",
    "cablebot_gym.bounds.best_known",
    "cablebot_gym.bounds.certificate",
    "cablebot_gym.bounds.closed_form",
    "cablebot_gym.envs",
    "cablebot_gym.envs.observation",
    "cablebot_gym.envs.settings",
    "cablebot_gym.envs.single",
    "cablebot_gym.envs.streams",
    "cablebot_gym.envs.vector",
    "cablebot_gym.evaluation",
    "cablebot_gym.evaluation.batch",
    "cablebot_gym.evaluation.comparison",
    "cablebot_gym.evaluation.constraints",
    "cablebot_gym.evaluation.evaluator",
    "cablebot_gym.evaluation.result",
    "cablebot_gym.evaluation.rollout",
    "cablebot_gym.evaluation.statistics",
    "cablebot_gym.kinematics",
    "cablebot_gym.physics.inverse",
    "cablebot_gym.physics.plant",
    "cablebot_gym.physics.textbook",
    "cablebot_gym.planning",
    "cablebot_gym.planning.following",
    "cablebot_gym.planning.library",
    "cablebot_gym.planning.motion",
    "cablebot_gym.planning.program",
    "cablebot_gym.planning.stage_functions",
    "cablebot_gym.plotting",
    "cablebot_gym.plotting.comparison",
    "cablebot_gym.plotting.figures",
    "cablebot_gym.policies",
    "cablebot_gym.policies.protocol",
    "cablebot_gym.rendering",
    "cablebot_gym.rendering.camera",
    "cablebot_gym.rendering.moment",
    "cablebot_gym.rendering.painter",
    "cablebot_gym.rendering.window",
    "cablebot_gym.robots",
    "cablebot_gym.task",
    "cablebot_gym.trajectories",
    "cablebot_gym.uncertainty",
    "cablebot_gym.utils.console",
    "cablebot_gym.utils.files",
    "cablebot_gym.utils.palette",
    "cablebot_gym.utils.suggestions",
    "cablebot_gym.utils.workers",
    "cablebot_gym.video",
    "cablebot_gym.video.recording",
)
"""The public modules. Their names without a leading underscore are the public API, and nothing else is."""

register_envs()
