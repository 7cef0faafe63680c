"""The rigid-transmission robot as a MuJoCo model: an independent oracle for the plant, and the peer for its speed.

MuJoCo computes lengths, moment arms and accelerations from bodies, sites and tendons; only Euler angles are converted
here. Its cables push as well as pull, so it equals the plant with ``cable="bilateral"``, and the unilateral one while
every cable is taut. Motor limits are the caller's business. Needs the extra ``cablebot-gym[mujoco]``.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array, euler_rate_matrix, euler_rate_matrix_rate
from cablebot_gym.robots import Robot

_SWITCHED_OFF = ("contact", "constraint", "spring", "sensor", "warmstart", "island", "autoreset")
"""Flags: parts of MuJoCo that have nothing to do here, and its silent reset of a state that has blown up."""


def import_mujoco() -> Any:
    """The ``mujoco`` module.

    Raises:
        ImportError: if MuJoCo is not installed; the message names the command that installs it.
    """
    try:
        return importlib.import_module("mujoco")
    except ImportError as error:
        raise ImportError("MuJoCo is not installed; run: pip install 'cablebot-gym[mujoco]'") from error


def mjcf(robot: Robot, payload: float = 0.0, timestep: float = 1e-3) -> str:
    """The robot as MJCF XML: controls are motor torques [N·m], positive winding in; integrator RK4.

    Spatial: a free body, ``qpos = (p, quaternion of R)``, ``qvel = (ṗ, ω_body)``. Planar: two slides, ``qpos = X``.
    Reflected to its cable a pulley is a tendon with ``armature = J/r²`` and ``damping = c/r²``, its motor one with
    ``gear = −1/r``.

    Args:
        robot: any robot.
        payload: added to the mass at the centre of mass [kg]; the inertia stays.
        timestep: of one RK4 step [s].

    Raises:
        ValueError: if the total mass or the timestep is not greater than 0 and finite.
    """
    mass = robot.mass + payload
    if not 0 < mass < math.inf:
        raise ValueError(f"payload {payload} kg makes a platform of {mass} kg; the sum must be greater than 0")
    if not 0 < timestep < math.inf:
        raise ValueError(f"timestep must be greater than 0 s and finite, not {timestep}")
    gravity = 0.0 if robot.planar else robot.gravity
    flags = " ".join(f'{flag}="disable"' for flag in _SWITCHED_OFF)
    body = f"{_joints_and_inertia(robot, mass)}{_sites('platform', robot.platform)}"
    radii = robot.pulley_radius.tolist()
    tendons = "".join(
        f'<spatial name="cable{i}" armature="{inertia / radius**2!r}" damping="{damping / radius**2!r}">'
        f'<site site="base{i}"/><site site="platform{i}"/></spatial>'
        for i, (radius, inertia, damping) in enumerate(
            zip(radii, robot.pulley_inertia.tolist(), robot.damping.tolist(), strict=True)
        )
    )
    motors = "".join(
        f'<motor name="motor{i}" tendon="cable{i}" gear="{-1 / radius!r}"/>' for i, radius in enumerate(radii)
    )
    return f"""<mujoco model="{_escaped(robot.name)}">
<compiler angle="radian" inertiafromgeom="false"/>
<option timestep="{timestep!r}" integrator="RK4" jacobian="dense" gravity="0 0 {gravity!r}"><flag {flags}/></option>
<worldbody>{_sites("base", robot.base)}<body name="platform" {_body_frame(robot)}>{body}</body></worldbody>
<tendon>{tendons}</tendon>
<actuator>{motors}</actuator>
</mujoco>"""


def _body_frame(robot: Robot) -> str:
    if robot.planar:
        return 'pos="0 0 0"'
    return f'pos="{_numbers(robot.home[:3])}" quat="{_numbers(quaternion(robot.home[3:]))}"'


def _joints_and_inertia(robot: Robot, mass: float) -> str:
    if robot.planar:  # a point mass; the moments have no effect, but MuJoCo wants some
        slides = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
        return f'{slides}<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/>'
    # A plate's largest moment is the sum of the others; MuJoCo refuses the last digit that rounding may put on top.
    largest = sum(sorted(robot.inertia)[:2])
    moments = _numbers(min(moment, largest) for moment in robot.inertia)
    return f'<freejoint/><inertial pos="0 0 0" mass="{mass!r}" diaginertia="{moments}"/>'


def _sites(prefix: str, points: Array) -> str:
    padded = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    return "".join(f'<site name="{prefix}{i}" pos="{_numbers(point)}"/>' for i, point in enumerate(padded))


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def quaternion(euler: ArrayLike) -> Array:
    """``(w, x, y, z)`` of ``R = Rz(φ) Ry(θ) Rx(ψ)``, shape (4,), from ``(ψ, θ, φ)``."""
    psi, theta, phi = np.asarray(euler, float).tolist()
    cx, sx, cy, sy = math.cos(psi / 2), math.sin(psi / 2), math.cos(theta / 2), math.sin(theta / 2)
    cz, sz = math.cos(phi / 2), math.sin(phi / 2)
    return np.array(
        [
            cz * cy * cx + sz * sy * sx,
            cz * cy * sx - sz * sy * cx,
            cz * sy * cx + sz * cy * sx,
            sz * cy * cx - cz * sy * sx,
        ]
    )


def euler_angles(quat: ArrayLike) -> tuple[float, float, float]:
    """``(ψ, θ, φ)`` with θ in [−π/2, π/2], the inverse of :func:`quaternion`."""
    w, x, y, z = np.asarray(quat, float).tolist()
    along, across = w * w + x * x - y * y - z * z, 2 * (w * z + x * y)  # cos θ cos φ, cos θ sin φ
    psi = math.atan2(2 * (w * x + y * z), w * w - x * x - y * y + z * z)
    return psi, math.atan2(2 * (w * y - x * z), math.hypot(along, across)), math.atan2(across, along)


class MujocoRobot:
    """One robot in MuJoCo, in the paper's coordinates: ``X = (x, y)`` or ``(x, y, z, ψ, θ, φ)``.

    It starts at rest in ``robot.home_pose``. :attr:`model` and :attr:`data` are MuJoCo's own objects, to use freely.
    """

    def __init__(self, robot: Robot, payload: float = 0.0, timestep: float = 1e-3) -> None:
        """Compile the model; arguments as in :func:`mjcf`.

        Raises:
            ImportError: if MuJoCo is not installed.
            ValueError: if the total mass or the timestep is not greater than 0 and finite.
        """
        self._mujoco = import_mujoco()
        self.robot = robot
        self.model: Any = self._mujoco.MjModel.from_xml_string(mjcf(robot, payload, timestep))
        self.data: Any = self._mujoco.MjData(self.model)
        self.set_state(robot.home, np.zeros(robot.coordinates))

    def set_state(self, pose: ArrayLike, velocity: ArrayLike) -> None:
        """Put the platform at pose X with velocity Ẋ, each of shape (n,); the time becomes 0."""
        pose, velocity = np.asarray(pose, float), np.asarray(velocity, float)
        shape = (self.robot.coordinates,)
        if pose.shape != shape or velocity.shape != shape:
            raise ValueError(f"pose and velocity must each have shape {shape}, not {pose.shape} and {velocity.shape}")
        self._mujoco.mj_resetData(self.model, self.data)
        if self.robot.planar:
            self.data.qpos[:], self.data.qvel[:] = pose, velocity
            return
        self.data.qpos[:3], self.data.qpos[3:] = pose[:3], quaternion(pose[3:])
        self.data.qvel[:3], self.data.qvel[3:] = velocity[:3], euler_rate_matrix(pose[3:]) @ velocity[3:]

    def state(self) -> tuple[Array, Array]:
        """``(X, Ẋ)``, new arrays of shape (n,)."""
        if self.robot.planar:
            return np.array(self.data.qpos), np.array(self.data.qvel)
        euler = euler_angles(self.data.qpos[3:])
        rates = np.linalg.solve(euler_rate_matrix(euler), self.data.qvel[3:])
        return np.append(self.data.qpos[:3], euler), np.append(self.data.qvel[:3], rates)

    def lengths(self) -> Array:
        """Cable lengths q [m], shape (m,)."""
        self._mujoco.mj_fwdPosition(self.model, self.data)
        return np.array(self.data.ten_length)

    def accelerations(self, torques: ArrayLike) -> Array:
        """``Ẍ`` in the present state under motor torques of shape (m,) [N·m], shape (n,)."""
        self._command(torques)
        self._mujoco.mj_forward(self.model, self.data)
        qacc = np.array(self.data.qacc)
        if self.robot.planar:
            return qacc
        pose, velocity = self.state()
        turning = euler_rate_matrix_rate(pose[3:], velocity[3:]) @ velocity[3:]
        return np.append(qacc[:3], np.linalg.solve(euler_rate_matrix(pose[3:]), qacc[3:] - turning))

    def step(self, torques: ArrayLike, steps: int = 1) -> None:
        """Integrate so many RK4 steps under constant motor torques of shape (m,) [N·m]."""
        self._command(torques)
        self._mujoco.mj_step(self.model, self.data, nstep=steps)

    def _command(self, torques: ArrayLike) -> None:
        if not np.all(np.isfinite(torques)):  # MuJoCo would take them for zeros
            raise ValueError(f"torques must be finite, not {np.asarray(torques)}")
        self.data.ctrl[:] = torques
