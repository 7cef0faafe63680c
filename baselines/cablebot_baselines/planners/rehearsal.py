"""Rehearsal of a planned motion on random robots, and the margins that they need over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from cablebot_baselines.laws.law import ClassicalLaw
from cablebot_gym.envs.vector import CableBotVectorEnv
from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Trajectory
from cablebot_gym.planning import MarginProfile, PlannedMotion
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.uncertainty import Uncertainty

ROBOTS = 20
"""Number of robots in a rehearsal: random ones, and in the end the expected one."""

SEED = 1_000_003
"""Seed of the first robot."""

ERROR_RESERVE = 0.02
"""Reserve of a rehearsal to the error bounds, as a fraction of them."""

TENSION_RESERVE = 1.5
"""Reserve of a rehearsal to the minimum and the maximum tension [N]: more than the standard
deviation over robots of their least tension."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Rehearsal:
    """Episodes of one motion, each with a robot of its own."""

    task: Task
    """The task."""
    payloads: Array
    """Nominal payload of each episode, (N,) [kg]."""
    times: Array
    """Ends of the control periods, (T,) [s]."""
    poses: Array
    """True poses at these times, (N, T, n)."""
    position: Array
    """Largest distance from the reference in each control period, (N, T) [m]."""
    rotation: Array
    """Largest error of an angle in each control period, (N, T) [rad]."""
    action: Array
    """Actions before saturation, (N, T, m)."""
    tension: Array
    """Least tension of all cables in each control period, (N, T) [N]."""
    largest_tension: Array
    """Largest tension of all cables in each control period, (N, T) [N]."""

    def excess(self, *, reserved: bool = True) -> dict[str, Array]:
        """How far each control period is beyond the limits, by limit, each (N, T); negative within
        them.

        Args:
            reserved: whether the limits are those less the reserves, which cover the robots that are
                not rehearsed.
        """
        error, tension = (ERROR_RESERVE, TENSION_RESERVE) if reserved else (0.0, 0.0)
        bounds = self.task.error_bounds
        robot = self.task.robot
        missing_tension = robot.minimum_tension + tension - self.tension
        overload = self.largest_tension - (robot.maximum_tension - tension)
        return {
            "position": self.position - (1 - error) * bounds.position,
            "rotation": self.rotation - (1 - error) * bounds.rotation,
            "tension": np.maximum(missing_tension, overload),
        }

    def largest_carried(self, *, reserved: bool = True) -> float:
        """Largest payload with which all robots keep the limits of :meth:`excess`, with all smaller
        ones [kg]; −1 if there is none."""
        is_carried = np.ones(len(self.payloads), np.bool_)
        for excess in self.excess(reserved=reserved).values():
            is_carried &= excess.max(axis=1) <= 0
        largest = -1.0
        for payload in np.unique(self.payloads):
            if not is_carried[self.payloads == payload].all():
                break
            largest = float(payload)
        return largest

    def of(self, episodes: NDArray[np.bool_]) -> Rehearsal:
        """The marked episodes."""
        arrays = {name: getattr(self, name)[episodes] for name in _EPISODE_ARRAYS}
        return Rehearsal(task=self.task, times=self.times, **arrays)


_EPISODE_ARRAYS = (
    "payloads",
    "poses",
    "position",
    "rotation",
    "action",
    "tension",
    "largest_tension",
)


def rehearse(
    law: ClassicalLaw,
    tasks: Sequence[Task],
    uncertainty: Uncertainty,
    payloads: Sequence[Sequence[float]],
    *,
    robots: int = ROBOTS,
) -> list[Rehearsal]:
    """Episodes of a law on each task, with each of its payloads and each robot.

    Args:
        law: the law of these episodes, task by task and payload by payload.
        tasks: the tasks, which differ in their motions alone.
        uncertainty: uncertainty from which the robots are drawn.
        payloads: nominal payloads of each task [kg]. The robots are the same for each.
        robots: number of robots; the last one is exactly known.
    """
    task_of_row = np.repeat(np.arange(len(tasks)), [robots * len(some) for some in payloads])
    payload = np.repeat(np.concatenate(payloads), robots)
    count = len(payload)
    first = tasks[0]
    env = CableBotVectorEnv(
        robot=first.robot,
        num_envs=count,
        error_bounds=first.error_bounds,
        control_frequency=first.control_frequency,
        cable=first.cable,
        uncertainty=uncertainty,
        payload_known=first.payload_known,
        autoreset_mode=AutoresetMode.DISABLED,
    )
    seeds = [SEED + episode % robots for episode in range(count)]
    options: dict[str, Any] = {"payload": payload}
    is_exact = np.arange(count) % robots == robots - 1
    for index, task in enumerate(tasks):
        options["trajectory"] = task.trajectory
        env.reset(seed=seeds, options=options)
        exact = {"uncertainty": None, "reset_mask": is_exact & (task_of_row >= index)}
        observation, _ = env.reset(seed=seeds, options=options | exact)
        options["reset_mask"] = task_of_row > index  # only the first reset starts all episodes
    law.reset(env.tasks)
    state: Any = None
    steps: dict[str, list[Array]] = {name: [] for name in _EPISODE_ARRAYS[1:]}
    for _ in range(max(task.steps for task in tasks)):
        action, state = law.predict(observation, state)
        observation, _, _, _, info = env.step(action)
        steps["poses"].append(env.pose)
        steps["position"].append(info["tracking_error_peak"])
        steps["rotation"].append(info["rotation_error_peak"])
        # A law without memory does not saturate its actions.
        steps["action"].append(action if state is None else state.requested)
        steps["tension"].append(info["least_tensions"].min(axis=1))
        steps["largest_tension"].append(info["largest_tensions"].max(axis=1))
    rehearsals = []
    for index, task in enumerate(tasks):
        rows = task_of_row == index
        arrays = {}
        for name, values in steps.items():
            arrays[name] = np.stack([value[rows] for value in values[: task.steps]], axis=1)
        times = np.arange(1, task.steps + 1) / task.control_frequency
        rehearsals.append(Rehearsal(task=task, payloads=payload[rows], times=times, **arrays))
    return rehearsals


SPREADS = {"position": 3.5, "rotation": 4.0, "tension": 4.0, "action": 2.0}
"""Margins to the limits in standard deviations of what robots do. Saturated actions violate no limit:
the other robots then miss a little of the acceleration."""

LARGEST_ACTION_MARGIN = 0.08
"""Largest margin to the action limits ±1, which costs most payload."""

LARGEST_ERROR_MARGIN = 0.6
"""Largest margins to the error bounds, as a fraction of them."""

GROWTH = 1.5
"""Growth of a margin for an excess of 1."""

WINDOW = 0.03
"""Time within which the largest spread counts [s]: a motion that changes moves the instants of its
extremes."""


def keeps_least_tension(robot: Robot) -> bool:
    """Whether the law keeps the same least tension all the time, so that the margin to it is constant:
    of a rigid robot with redundant cables."""
    return robot.cables > robot.coordinates and not robot.flexible


def spread_margins(rehearsal: Rehearsal, motion: PlannedMotion) -> MarginProfile:
    """Margins for the spread of the robots about their motion.

    Args:
        rehearsal: episodes of a law that tracks the motion.
        motion: the planned motion.
    """
    payloads = np.unique(rehearsal.payloads)
    profile = {}
    for name, spreads in SPREADS.items():
        needed = None
        for payload in payloads:
            if name == "action" and payload < payloads[-1]:
                continue  # light payloads need less torque
            part = rehearsal.of(rehearsal.payloads == payload)
            deviation = _deviation(name, part, motion)
            margin = deviation.mean(axis=0) + spreads * deviation.std(axis=0)
            if name == "tension" and keeps_least_tension(rehearsal.task.robot):
                margin -= _lowest(part) - motion.minimum_tension
            needed = margin if needed is None else np.maximum(needed, margin)
        assert needed is not None
        profile[name] = _widened(np.maximum(needed, 0.0), rehearsal.task)
    profile["action"] = np.minimum(profile["action"], LARGEST_ACTION_MARGIN)
    bounds = rehearsal.task.error_bounds
    for name in ("position", "rotation"):
        profile[name] = np.minimum(profile[name], LARGEST_ERROR_MARGIN * getattr(bounds, name))
    return MarginProfile(times=rehearsal.times, **profile)


def _lowest(rehearsal: Rehearsal) -> Array:
    """Lowest mean of the least tensions within :data:`WINDOW`, (T,) [N]."""
    return -_widened(-rehearsal.tension.mean(axis=0), rehearsal.task)


def _deviation(name: str, rehearsal: Rehearsal, motion: Trajectory) -> Array:
    """How much closer to a limit each episode is than its motion, (N, T), of the actions (N, T, m).

    Tensions and actions change within a few periods where the motion's acceleration jumps, and
    robots with another delay do so a little earlier or later. They are therefore compared with the
    extremes of their mean within :data:`WINDOW`.
    """
    task = rehearsal.task
    if name == "tension":
        return np.maximum(_lowest(rehearsal) - rehearsal.tension, 0.0)
    if name == "action":
        action = np.abs(rehearsal.action)
        return np.maximum(action - _widened(action.mean(axis=0), task), 0.0)
    reference = task.trajectory(rehearsal.times).position
    split = task.robot.dimensions
    errors = []
    for pose in (rehearsal.poses, motion(rehearsal.times).position):
        error = pose - reference
        if name == "position":
            errors.append(np.linalg.norm(error[..., :split], axis=-1))
        else:
            errors.append(np.abs(error[..., split:]).max(axis=-1, initial=0.0))
    deviation: Array = errors[0] - errors[1]
    return deviation


def grown_margins(profile: MarginProfile, rehearsal: Rehearsal) -> MarginProfile:
    """A profile with larger margins at the times at which episodes exceed a limit."""
    grown = {"action": profile.action}
    for name, excess in rehearsal.excess().items():
        largest = GROWTH * np.maximum(excess.max(axis=0), 0.0)
        grown[name] = getattr(profile, name) + _widened(largest, rehearsal.task)
    return MarginProfile(times=profile.times, **grown)


def _widened(values: Array, task: Task) -> Array:
    """The largest value within :data:`WINDOW` of each control period."""
    size = 1 + 2 * round(WINDOW / 2 * task.control_frequency)
    widened: Array = maximum_filter1d(values, size, axis=0)
    return widened
