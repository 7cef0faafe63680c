"""Largest payload of a random robot for a planner that knows its draw of an uncertainty, as a fraction of
that of the nominal robot.

It is what anybody can hope for under the uncertainty. Both payloads are those of the nonlinear program
(:mod:`cablebot_gym.planning`) on the same mesh, without replays. Needs the extra ``optimal``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym

from cablebot_gym.bounds.optimum import Problem, find_optimum
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.kinematics import Array
from cablebot_gym.planning import Infeasible, PlannedMotion
from cablebot_gym.robots import Robot
from cablebot_gym.uncertainty import PARAMETERS, find_uncertainty, scaled_tensor
from cablebot_gym.utils.checks import whole


@dataclass(frozen=True, kw_only=True)
class DrawnPayload:
    """Largest payload of one draw of an uncertainty."""

    payload: float | None
    """Largest payload of the program as the judge counts it, the nominal one [kg]; None if the solver
    finds no motion."""
    intervals: int
    """Intervals of the mesh."""
    reference: float
    """Largest payload of the nominal robot on this mesh [kg]."""

    @property
    def ratio(self) -> float | None:
        """Payload of the draw as a fraction of the nominal one; None without a payload."""
        if self.payload is None or self.reference <= 0:
            return None
        return self.payload / self.reference


def find_drawn_payload(
    env_id: str, *, uncertainty: str, seed: int, cache: bool = True, **options: Any
) -> DrawnPayload:
    """Computes the largest payload of one draw of an uncertainty, for a planner that knows it.

    The environment makes the draw. The motion is that of the nominal robot, moved to the drawn one on
    the coarsest mesh. It knows mass, inertia, anchors, pulleys, friction, damping, stiffness and motor
    strength of the drawn robot, and the factor of its payload. Delay, lag, wrench and sensors do not
    enter: margins against them would reduce the payload.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        uncertainty: uncertainty, as for :func:`~cablebot_gym.uncertainty.find_uncertainty`.
        seed: seed of the draw.
        cache: whether to read the nominal result from the disk cache and to store it there.
        options: those of :func:`~cablebot_gym.bounds.optimum.find_optimum`.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if an argument is invalid, or if no motion of the nominal robot is found.
    """
    nominal = find_optimum(env_id, cache=cache, **options)
    problem = Problem.of(env_id, **options)
    checked = find_uncertainty(uncertainty, problem.robot)
    given = problem.conditions
    env = gym.make(env_id, uncertainty=checked, max_episode_steps=None, **given).unwrapped
    assert isinstance(env, CableBotEnv)
    env.reset(seed=whole("seed", seed))
    true = drawn_robot(problem.robot, env.truth)
    without_lag = true.replace(motors=true.motors.replace(lag=0.0))
    intervals, reference = nominal.meshes[0]
    motion = _optimum(replace(problem, robot=without_lag), intervals, nominal.first)
    payload = None
    if motion is not None:
        payload = _nominal_payload(env, seed, motion.payload)
    return DrawnPayload(payload=payload, intervals=intervals, reference=reference)


def drawn_robot(robot: Robot, truth: Mapping[str, Array]) -> Robot:
    """The nominal robot with the true parameters of an episode, without its payload.

    Args:
        robot: nominal robot.
        truth: true parameters by name, as ``env.unwrapped.truth``.
    """
    values = {PARAMETERS[name].attribute: value for name, value in truth.items()}
    motors = robot.motors.replace(stall_torque=values["stall_torque"], lag=values["motor_lag"])
    names = set(values) & set(vars(robot.transmission))
    transmission = robot.transmission.replace(**{name: values[name] for name in names})
    changes: dict[str, Any] = {"base_anchors": values["base"], "mass": float(values["mass"])}
    if not robot.point_mass:
        changes["platform_anchors"] = values["platform"]
        changes["inertia"] = values["moments"]
        if not robot.planar:
            (changes["inertia"],) = scaled_tensor(robot, values["moments"][None])
    return robot.replace(motors=motors, transmission=transmission, **changes)


def _optimum(problem: Problem, intervals: int, start: PlannedMotion) -> PlannedMotion | None:
    """The motion of a drawn robot with the largest payload, from that of the nominal one; None if the
    solver finds none."""
    program = problem.program(intervals)
    try:
        return program.solve(start, near=True)
    except Infeasible:
        pass
    # without friction the motion is smooth: a closer start
    robot = problem.robot
    transmission = robot.transmission.replace(coulomb_friction=0.0, load_friction=0.0)
    smooth = replace(problem, robot=robot.replace(transmission=transmission))
    try:
        return program.solve(smooth.program(intervals).solve(start))
    except Infeasible:
        return None


def _nominal_payload(env: CableBotEnv, seed: int, payload: float) -> float:
    """Nominal payload of a true payload of a draw [kg]. The true one is affine in the nominal one."""
    low = float(env.settings.robot.mass)
    high = 2 * low
    true_payloads = []
    for nominal in (low, high):
        env.reset(seed=seed, options={"payload": nominal})
        true_payloads.append(float(env.truth["payload"]))
    true_low, true_high = true_payloads
    return low + (payload - true_low) * (high - low) / (true_high - true_low)
