"""Policies in closed loop with a batch of environments."""

from typing import Any, NamedTuple

from cablebot_gym.kinematics import Array


class Step(NamedTuple):
    """A control step: an observation and what follows from it."""

    observation: Array
    action: Array
    state: Any
    info: dict[str, Any]


def drive(policy, env, steps=None, **start):
    """Yields each control step; without ``steps`` over the whole motion. ``start`` has keywords of
    the environment's ``reset``."""
    observation, _ = env.reset(**{"seed": 0, **start})
    tasks = env.unwrapped.tasks
    policy.reset(tasks)
    state = None
    for _ in range(steps or tasks[0].steps):
        action, state = policy.predict(observation, state=state)
        following, _, _, _, info = env.step(action)
        yield Step(observation, action, state, info)
        observation = following


def keeps_limits(info):
    """Whether each episode keeps 10 mm, 10 mrad and taut cables in a control step."""
    is_near = (info["tracking_error_peak"] <= 0.01) & (info["rotation_error_peak"] <= 0.01)
    return is_near & ~info["slack"].any(axis=1)
