"""Reference for speed comparisons: an environment for the same robot, written directly on MuJoCo.

``bench_throughput.py`` measures it. The package does not import this file.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from cablebot_gym.physics import textbook

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from oracles.mujoco_model import MujocoRobot

from cablebot_gym.robots import Robot

Array = NDArray[np.float64]

REWARD_SCALE = 0.01
"""Tracking error at which the reward is one half [m]."""

TERMINATION_ERROR = 0.1
"""Position error that ends an episode [m]."""


class MujocoCableBotEnv(gymnasium.Env[Array, Array]):
    """Tracking with a cable robot in MuJoCo's RK4; the action is one value in [-1, 1] per motor.

    At a control instant the requested torque is ``τ_s a − (τ_s/ω_n) β̇``, constant for ``substeps``
    RK4 steps. ``clip_each_step`` clips it to U± at the motor speed at the start of each RK4 step,
    which needs one ``mj_step`` call per step. Without it, one call makes all steps, which is
    faster.

    Observation: pose (n), velocity (n), time to go [s], the row of ``reference_table`` for this
    instant, payload [kg]. An episode terminates when the position error exceeds 0.1 m or is NaN,
    and is truncated after K steps.
    """

    def __init__(
        self,
        robot: Robot,
        reference_table: Array,
        substeps: int = 10,
        timestep: float = 1e-3,
        *,
        payload: float = 0.0,
        clip_each_step: bool = False,
    ) -> None:
        """Build the model.

        Args:
            robot: any robot without joint springs, elastic cables and swivel pulleys.
            reference_table: shape (K + 1, columns), one row per control instant: reference pose,
                velocity and acceleration (3 n columns), then any previews.
            substeps: RK4 steps per control period.
            timestep: duration of one RK4 step [s].
            payload: payload of the plant, also in the observation [kg].
            clip_each_step: whether to clip the torque at each RK4 step, see the class.
        """
        self._plant = MujocoRobot(robot, payload, timestep)
        self._model = self._plant.model
        self._data = self._plant.data
        self._qpos = self._data.qpos
        self._qvel = self._data.qvel
        self._ctrl = self._data.ctrl
        self._spatial = robot.kind == "spatial"
        self._n = robot.coordinates
        self._substeps = substeps
        self._axes = robot.dimensions
        self._clip_each_step = clip_each_step
        self._period, self._payload = substeps * timestep, payload
        self._stall = robot.stall_torque.copy()
        self._slope = robot.speed_slope
        self._per_radius = 1 / robot.pulley_radius
        # a view; the model option makes it dense
        self._tendon_jacobian = self._data.ten_J.reshape(robot.cables, -1)
        self._to_motor = -self._per_radius

        self._table = np.array(reference_table, dtype=float)
        self._goals = [tuple(row) for row in self._table[:, : self._axes].tolist()]
        self._last = len(self._table) - 1
        self._after_state = 2 * self._n + 1
        self._after_table = 2 * self._n + 1 + self._table.shape[1]
        self._step_count = 0
        self._speeds = np.zeros(robot.cables)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (robot.cables,), np.float64)
        self.observation_space = gymnasium.spaces.Box(
            -np.inf, np.inf, (self._after_table + 1,), np.float64
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start on the reference, at its velocity."""
        super().reset(seed=seed)
        n = self._n
        self._plant.set_state(self._table[0, :n], self._table[0, n : 2 * n])
        self._step_count = 0
        self._speeds = self._motor_speeds()
        return self._observation(), {"tracking_error": 0.0, "motor_speeds": self._speeds}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """One control period."""
        torques: Array = (
            self._stall * np.minimum(np.maximum(action, -1.0), 1.0) - self._slope * self._speeds
        )
        if self._clip_each_step:
            torques = self._step_clipped(torques)
        else:
            self._ctrl[:] = torques
            mujoco.mj_step(self._model, self._data, self._substeps)
        self._speeds = self._motor_speeds()
        self._step_count += 1
        observation = self._observation()
        error = math.dist(self._qpos[: self._axes].tolist(), self._goals[self._step_count])
        info = {
            "tracking_error": error,
            "tensions": torques
            * self._per_radius,  # actuator forces on the tendons, without the pulleys' inertia
            "torques": torques,
            "motor_speeds": self._speeds,
            "time": self._step_count * self._period,
        }
        reward = 1 / (1 + (error / REWARD_SCALE) ** 2)
        terminated = not error <= TERMINATION_ERROR
        return observation, reward, terminated, self._step_count >= self._last, info

    def _step_clipped(self, requested: Array) -> Array:
        torques, speeds = np.empty_like(requested), self._speeds
        for substep in range(self._substeps):
            if substep:
                speeds = self._motor_speeds()
            line = self._slope * speeds
            np.maximum(requested, -self._stall - line, out=torques)
            np.minimum(torques, self._stall - line, out=torques)
            self._ctrl[:] = torques
            mujoco.mj_step(self._model, self._data)
        return torques

    def _motor_speeds(self) -> Array:
        """Motor speeds β̇ in the present state; RK4 leaves the tendons at its last stage, so they
        are updated first."""
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_tendon(self._model, self._data)
        speeds: Array = self._to_motor * (self._tendon_jacobian @ self._qvel)
        return speeds

    def _observation(self) -> Array:
        n, observation = self._n, np.empty(self._after_table + 1)
        if self._spatial:
            observation[:12] = _paper_state(self._qpos.tolist(), self._qvel.tolist())
        else:
            observation[:n], observation[n : 2 * n] = self._qpos, self._qvel
        observation[2 * n] = (self._last - self._step_count) * self._period
        observation[self._after_state : self._after_table] = self._table[self._step_count]
        observation[-1] = self._payload
        return observation


def _paper_state(qpos: list[float], qvel: list[float]) -> tuple[float, ...]:
    """``(X, Ẋ)`` from a free joint's position and velocity, in floats, which are faster than small
    arrays."""
    x, y, z, w, i, j, k = qpos
    dx, dy, dz, p, q, r = qvel
    along = w * w + i * i - j * j - k * k
    across = 2 * (w * k + i * j)
    sin_theta = 2 * (w * j - i * k)
    cos_theta = math.hypot(along, across)
    psi = math.atan2(2 * (w * i + j * k), w * w - i * i - j * j + k * k)
    theta = math.atan2(sin_theta, cos_theta)
    phi = math.atan2(across, along)
    cos_psi, sin_psi = math.cos(psi), math.sin(psi)
    phi_rate = (sin_psi * q + cos_psi * r) / cos_theta
    theta_rate = cos_psi * q - sin_psi * r
    return x, y, z, psi, theta, phi, dx, dy, dz, p + sin_theta * phi_rate, theta_rate, phi_rate


def holding_torques(robot: Robot) -> Array:
    """Motor torques in equilibrium at the home pose, shape (m,); the paper's planar robots: 0.5 N·m
    each."""
    minimum = textbook.allocated_minimum(robot, 10.0)
    return textbook.static_torque(robot, robot.mass, robot.home, minimum=minimum)


def home_table(robot: Robot, instants: int = 501, previews: int = 2) -> Array:
    """A reference that stays at the home pose, with the columns of an environment's reference."""
    n = robot.coordinates
    row = np.concatenate([robot.home, np.zeros(2 * n), np.tile(robot.home, previews)])
    return np.tile(row, (instants, 1))
