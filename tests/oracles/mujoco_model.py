"""A robot, rigid or flexible, as a MuJoCo model: an independent oracle for the plant, and the peer
for its speed.

MuJoCo computes lengths, moment arms and accelerations from bodies, sites and tendons; only Euler
angles are converted here. Its cables push as well as pull, so it equals the plant with
``cable="bilateral"``, and the unilateral one while every cable is taut. Motor limits are the
caller's business. Needs the extra ``cablebot-gym[mujoco]``.
"""

import importlib

import numpy as np
from scipy.spatial.transform import Rotation

from cablebot_gym.kinematics import (
    cable_lengths,
    euler_rate_matrix,
    euler_rate_matrix_rate,
)

_SWITCHED_OFF = (
    "contact",
    "constraint",
    "sensor",
    "warmstart",
    "island",
    "autoreset",
)
"""Flags: parts of MuJoCo that have nothing to do here, and its silent reset of a state that has
blown up."""

_WINCH_ROOM = 10
"""How far off a winch stands in front of its base anchor, in diagonals of the workspace plus the
spring's give at stall: nothing winds that far back, where the segment between them would turn
round. Not farther: its digits are lost to the spring."""


def mjcf(robot, payload=0.0, timestep=1e-3):
    """The robot as MJCF XML: controls are motor torques [N·m], positive winding in; integrator RK4.

    In space: a free body, ``qpos = (p, quaternion of R)``, ``qvel = (ṗ, ω_body)``. A point mass
    slides along the axes, and a platform in a plane turns on a hinge too, ``qpos = X``. Reflected
    to its cable a pulley is a tendon with ``armature = J/r²`` and ``damping = c/r²``, its motor one
    with ``gear = −1/r``.

    Flexible: a motor is a winch, a body of mass ``J′/r²`` with damping ``c′/r²`` that slides across
    gravity away from its base anchor by ``r β′``; ``qpos`` and ``qvel`` end in these. A second
    tendon, of stiffness ``K/r²``, runs from the platform over the base anchor to the winch, so that
    its length is ``q + r β′`` and a constant.

    Args:
        robot: any robot.
        payload: added to the mass at the centre of mass [kg]; the inertia stays.
        timestep: of one RK4 step [s].
    """
    mass = robot.mass + payload
    gravity = _numbers(_padded(robot.gravity_vector))
    switched_off = _SWITCHED_OFF if robot.flexible else (*_SWITCHED_OFF, "spring")
    flags = " ".join(f'{flag}="disable"' for flag in switched_off)
    body = f"{_joints_and_inertia(robot, mass)}{_sites('platform', robot.platform)}"
    radii = robot.pulley_radius.tolist()
    tendons = "".join(
        f'<spatial name="cable{i}" armature="{inertia / radius**2!r}" damping="{damping / radius**2!r}">'
        f'<site site="base{i}"/><site site="platform{i}"/></spatial>'
        for i, (radius, inertia, damping) in enumerate(
            zip(
                radii,
                robot.pulley_inertia.tolist(),
                robot.damping.tolist(),
                strict=True,
            )
        )
    )
    winches, springs = _winches_and_springs(robot) if robot.jointed else ("", "")
    kind, sign = ("joint", 1) if robot.jointed else ("tendon", -1)
    driven = "winch" if robot.jointed else "cable"
    motors = "".join(
        f'<motor name="motor{i}" {kind}="{driven}{i}" gear="{sign / radius!r}"/>'
        for i, radius in enumerate(radii)
    )
    return f"""<mujoco>
<compiler angle="radian" inertiafromgeom="false"/>
<option timestep="{timestep!r}" integrator="RK4" jacobian="dense" gravity="{gravity}"><flag {flags}/></option>
<worldbody>{_sites("base", robot.base)}<body name="platform" {_body_frame(robot)}>{body}</body>{winches}</worldbody>
<tendon>{tendons}{springs}</tendon>
<actuator>{motors}</actuator>
</mujoco>"""


def _winches_and_springs(robot):
    """Bodies and tendons of the motors behind their springs; all springs are unwound at home with
    β′ = 0."""
    home = cable_lengths(robot.base, robot.platform, robot.home)
    per_radius2 = 1 / robot.pulley_radius**2
    diagonal = np.linalg.norm(np.diff(robot.pose_bounds[:, : robot.dimensions], axis=0))
    room = _WINCH_ROOM * (diagonal + robot.pulley_radius * robot.stall_torque / robot.stiffness)
    columns = (
        robot.motor_inertia * per_radius2,
        robot.motor_damping * per_radius2,
        robot.stiffness * per_radius2,
    )
    winches = ""
    springs = ""
    for i, (mass, damping, stiffness) in enumerate(np.stack(columns, axis=1).tolist()):
        at = np.zeros(3)
        at[: robot.base.shape[1]] = robot.base[i]
        at[0] += room[i]
        winches += (
            f'<body pos="{_numbers(at)}"><joint name="winch{i}" type="slide" axis="1 0 0" damping="{damping!r}"/>'
            f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/><site name="winch{i}"/></body>'
        )
        springs += (
            f'<spatial name="spring{i}" stiffness="{stiffness!r}" springlength="{float(home[i] + room[i])!r}">'
            f'<site site="platform{i}"/><site site="base{i}"/><site site="winch{i}"/></spatial>'
        )
    return winches, springs


def _body_frame(robot):
    if robot.kind != "spatial":
        return 'pos="0 0 0"'
    return f'pos="{_numbers(robot.home[:3])}" quat="{_numbers(quaternion(robot.home[3:]))}"'


def _joints_and_inertia(robot, mass):
    inertial = f'<inertial pos="{_numbers(_padded(robot.mass_center))}" mass="{mass!r}"'
    if robot.kind != "spatial":  # the moments that have no effect are the same: MuJoCo wants some
        axes = ("1 0 0", "0 1 0", "0 0 1")[: robot.dimensions]
        joints = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in axes)
        if robot.kind == "planar-platform":
            joints += '<joint type="hinge" axis="0 0 1"/>'
        return f'{joints}{inertial} diaginertia="{_numbers([1.0 if robot.point_mass else robot.inertia[0]] * 3)}"/>'
    tensor = robot.inertia_tensor
    if np.any(products := tensor[(0, 0, 1), (1, 2, 2)]):
        return f'<freejoint/>{inertial} fullinertia="{_numbers([*tensor.diagonal(), *products])}"/>'
    # A plate's largest moment is the sum of the others; MuJoCo refuses the last digit that rounding
    # may put on top.
    largest = sum(sorted(robot.inertia)[:2])
    moments = _numbers(min(moment, largest) for moment in robot.inertia)
    return f'<freejoint/>{inertial} diaginertia="{moments}"/>'


def _padded(points):
    """Points or vectors in space, z = 0 for those in a plane."""
    return np.pad(points, ((0, 0),) * (points.ndim - 1) + ((0, 3 - points.shape[-1]),))


def _sites(prefix, points):
    return "".join(
        f'<site name="{prefix}{i}" pos="{_numbers(point)}"/>'
        for i, point in enumerate(_padded(points))
    )


def _numbers(values):
    return " ".join(repr(float(value)) for value in values)


def quaternion(euler):
    """``(w, x, y, z)`` of ``R = Rz(φ) Ry(θ) Rx(ψ)``, shape (4,), from ``(ψ, θ, φ)``."""
    return Rotation.from_euler("ZYX", euler[::-1]).as_quat(scalar_first=True)


def euler_angles(quat):
    """``(ψ, θ, φ)`` with θ in [−π/2, π/2], of ``quat``, the inverse of :func:`quaternion`."""
    return Rotation.from_quat(quat, scalar_first=True).as_euler("ZYX")[::-1]


class MujocoRobot:
    """One robot in MuJoCo, in the pose X of its kind, and β′ if flexible.

    It starts at rest in ``robot.home_pose``; ``timestep`` is MuJoCo's [s].
    :attr:`model` and :attr:`data` are MuJoCo's own objects, to use freely.
    """

    def __init__(self, robot, payload=0.0, timestep=1e-3):
        """Compile the model; arguments as in :func:`mjcf`.

        Raises:
            ImportError: if MuJoCo is not installed.
        """
        self._mujoco = importlib.import_module("mujoco")
        self.robot = robot
        self.model = self._mujoco.MjModel.from_xml_string(mjcf(robot, payload, timestep))
        self.data = self._mujoco.MjData(self.model)
        self._platform_speeds = robot.coordinates
        # a quaternion has four numbers
        self._platform_positions = robot.coordinates + (robot.kind == "spatial")
        self.set_state(robot.home, np.zeros(robot.coordinates))

    def set_state(self, pose, velocity):
        """Put the platform at pose X with velocity Ẋ, each of shape (n,); the time becomes 0.

        A flexible robot's motors come to rest at β′ = 0; see :meth:`set_motors`.
        """
        self._mujoco.mj_resetData(self.model, self.data)
        positions = self._platform_qpos
        speeds = self._platform_qvel
        if self.robot.kind != "spatial":
            positions[:] = pose
            speeds[:] = velocity
        else:
            positions[:3] = pose[:3]
            positions[3:] = quaternion(pose[3:])
            speeds[:3] = velocity[:3]
            speeds[3:] = euler_rate_matrix(pose[3:]) @ velocity[3:]

    def set_motors(self, angle, speed):
        """Motor angles β′ and speeds β̇′ of a flexible robot, each of shape (m,), after
        :meth:`set_state`."""
        self.data.qpos[self._platform_positions :] = np.asarray(angle) * self.robot.pulley_radius
        self.data.qvel[self._platform_speeds :] = np.asarray(speed) * self.robot.pulley_radius

    def set_free_lengths(self, lengths):
        """Makes the cables elastic with free lengths l (m,) [m]: one-sided springs EA/l, and
        dampers also if slack.

        The pulleys stand still, so the robot must not have joint springs.
        """
        robot = self.robot
        free = np.asarray(lengths)
        self.model.tendon_stiffness[:] = robot.axial_stiffness / free
        self.model.tendon_damping[:] = robot.axial_damping / free
        self.model.tendon_armature[:] = 0.0
        self.model.tendon_lengthspring[:, 0] = 0.0
        self.model.tendon_lengthspring[:, 1] = free - robot.extra_length

    def set_wrench(self, force, moment=(0.0, 0.0, 0.0)):
        """External force [N] and moment [N·m] at the platform's centre of mass, in the base frame,
        each of shape (3,).

        They last until the next :meth:`set_state`.
        """
        self.data.body("platform").xfrc_applied[:] = np.concatenate([force, moment])

    def state(self):
        """``(X, Ẋ)``, new arrays of shape (n,)."""
        positions = np.array(self._platform_qpos)
        speeds = np.array(self._platform_qvel)
        if self.robot.kind != "spatial":
            return positions, speeds
        euler = euler_angles(positions[3:])
        rates = np.linalg.solve(euler_rate_matrix(euler), speeds[3:])
        return np.append(positions[:3], euler), np.append(speeds[:3], rates)

    def motors(self):
        """``(β′, β̇′)`` of a flexible robot, new arrays of shape (m,)."""
        radius = self.robot.pulley_radius
        return self.data.qpos[self._platform_positions :] / radius, self.data.qvel[
            self._platform_speeds :
        ] / radius

    def accelerations(self, torques):
        """``Ẍ`` in the present state under motor torques of shape (m,) [N·m], shape (n,)."""
        qacc = self._forward(torques)[: self._platform_speeds]
        if self.robot.kind != "spatial":
            return qacc
        pose, velocity = self.state()
        turning = euler_rate_matrix_rate(pose[3:], velocity[3:]) @ velocity[3:]
        return np.append(
            qacc[:3],
            np.linalg.solve(euler_rate_matrix(pose[3:]), qacc[3:] - turning),
        )

    def motor_accelerations(self, torques):
        """``β̈′`` of a flexible robot in the present state under motor torques of shape (m,) [N·m],
        shape (m,)."""
        return self._forward(torques)[self._platform_speeds :] / self.robot.pulley_radius

    def step(self, torques, steps=1):
        """Integrate so many RK4 steps under constant motor torques of shape (m,) [N·m]."""
        self._command(torques)
        self._mujoco.mj_step(self.model, self.data, nstep=steps)

    @property
    def _platform_qpos(self):
        return self.data.qpos[: self._platform_positions]

    @property
    def _platform_qvel(self):
        return self.data.qvel[: self._platform_speeds]

    def _forward(self, torques):
        """MuJoCo's accelerations of all its coordinates."""
        self._command(torques)
        self._mujoco.mj_forward(self.model, self.data)
        return np.array(self.data.qacc)

    def _command(self, torques):
        self.data.ctrl[:] = torques
