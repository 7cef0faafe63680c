"""Gymnasium environments and a payload benchmark for cable-suspended robots.

Importing the package registers the ids in :data:`ENV_IDS`. Heavy modules are imported on first use.

These parameters have the same meaning everywhere. A docstring repeats them only where it adds something:

    robot: robot with nominal parameters, without payload.
    env_id: one of :data:`ENV_IDS`.
    cables: number of cables, m.
    count: number of environments or robots, N.
    blocks: observation blocks by name, as returned by ``layout.split``.
    observation: observation of one environment (size,) or of N environments (N, size).
    action: actions in [−1, 1], of one environment (m,) or of N environments (N, m).
    state, episode_start, deterministic: as in Stable-Baselines3's ``predict``.
    env: the environment to wrap or to inspect.
    seed: a non-negative integer; None for a random one.
    payload: mass added to the platform [kg].
    mass: mass of the platform and its payload [kg], shape (...).
    pose: X = (x, y) or (x, y, z, ψ, θ, φ) [m, rad], shape (..., n).
    velocity, acceleration: Ẋ and Ẍ, shape (..., n).
    euler: (ψ, θ, φ) [rad], shape (..., 3).
    base, platform: cable anchors [m], shape (m, 2) or (m, 3).
    trajectory: the reference motion.
    control_frequency: actions per second [Hz].
    draws: number of draws from an uncertainty.
    confidence: confidence level of an interval or of a lower bound, between 0 and 1.
    name: name shown in results and error messages.
    path, folder: file or folder to read or write.
"""

from cablebot_gym.envs import ENV_IDS, register_envs

__version__ = "0.1.0"
__all__ = ["ENV_IDS", "PUBLIC", "__version__"]

PUBLIC = (
    "cablebot_gym",
    "cablebot_gym.benchmark",
    "cablebot_gym.benchmark.cells",
    "cablebot_gym.benchmark.engine",
    "cablebot_gym.benchmark.leaderboard",
    "cablebot_gym.benchmark.maps",
    "cablebot_gym.benchmark.ray_backend",
    "cablebot_gym.benchmark.scores",
    "cablebot_gym.benchmark.store",
    "cablebot_gym.benchmark.suites",
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
    "cablebot_gym.utils.checks",
    "cablebot_gym.utils.workers",
    "cablebot_gym.video",
    "cablebot_gym.video.recording",
)
"""The public modules. Their names without a leading underscore form the public API."""

register_envs()
