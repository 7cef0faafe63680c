"""A robot, rigid or flexible, as a MuJoCo model: an independent oracle for the plant, and the peer
for its speed.

MuJoCo computes lengths, moment arms and accelerations from the bodies, sites and tendons of the
file that users export; only Euler angles are converted here. Its cables push as well as pull, so it
equals the plant with ``cable="bilateral"``, and the unilateral one while every cable is taut. Motor
limits are the caller's business. Needs the extra ``cablebot-gym[mujoco]``.
"""

import importlib
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from cablebot_gym.exporters.mjcf import mjcf_tree
from cablebot_gym.kinematics import euler_rate_matrix, euler_rate_matrix_rate

_SWITCHED_OFF = ("contact", "constraint", "sensor", "warmstart", "island", "autoreset")
"""Flags: parts of MuJoCo that have nothing to do here, and its silent reset of a state that has
blown up."""


def quaternion(euler):
    """``(w, x, y, z)`` of ``R = Rz(φ) Ry(θ) Rx(ψ)``, shape (4,), from ``(ψ, θ, φ)``."""
    return Rotation.from_euler("ZYX", euler[::-1]).as_quat(scalar_first=True)


def euler_angles(quat):
    """``(ψ, θ, φ)`` with θ in [−π/2, π/2], of ``quat``, the inverse of :func:`quaternion`."""
    return Rotation.from_quat(quat, scalar_first=True).as_euler("ZYX")[::-1]


class MujocoRobot:
    """One robot in MuJoCo, in the pose X of its kind, and β′ if flexible.

    It starts at rest in ``robot.home_pose``.
    :attr:`model` and :attr:`data` are MuJoCo's own objects, to use freely.
    """

    def __init__(self, robot, payload=0.0, *, exported=None):
        """Compile the model, with motor torques [N·m] as controls; arguments as in
        :func:`mjcf_tree`.

        The text of an ``exported`` robot is compiled as it is. Its actions take the place of the
        torques.

        Raises:
            ImportError: if MuJoCo is not installed.
        """
        self._mujoco = importlib.import_module("mujoco")
        self.robot = robot
        if exported is not None:
            self.model = self._mujoco.MjModel.from_xml_string(exported)
        else:
            self.model = self._torque_driven(payload)
        self.data = self._mujoco.MjData(self.model)
        self._platform_speeds = robot.coordinates
        # a quaternion has four numbers
        self._platform_positions = robot.coordinates + (robot.kind == "spatial")
        self.set_state(robot.home, np.zeros(robot.coordinates))

    def _torque_driven(self, payload):
        robot = self.robot
        tree = mjcf_tree(
            robot.with_rigid_cables(), payload=payload, timestep=1e-3, controls="torques"
        )
        switched_off = _SWITCHED_OFF if robot.flexible else (*_SWITCHED_OFF, "spring")
        ElementTree.SubElement(tree.find("option"), "flag", dict.fromkeys(switched_off, "disable"))
        text = ElementTree.tostring(tree, encoding="unicode")
        model = self._mujoco.MjModel.from_xml_string(text)
        # joint springs push, too
        model.tendon_lengthspring[:, 0] = model.tendon_lengthspring[:, 1]
        return model

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

    def set_keyframe(self, index):
        """Put robot, controls and time at a keyframe of an exported robot."""
        self._mujoco.mj_resetDataKeyframe(self.model, self.data, index)

    def set_motors(self, angle, speed):
        """Motor angles β′ and speeds β̇′ of a flexible robot, each of shape (m,), after
        :meth:`set_state`."""
        self.data.qpos[self._platform_positions :] = np.asarray(angle) * self.robot.pulley_radius
        self.data.qvel[self._platform_speeds :] = np.asarray(speed) * self.robot.pulley_radius

    def set_lane(self, state, lane):
        """The state of one robot of a batch, with its motors."""
        self.set_state(state.pose[lane], state.velocity[lane])
        if self.robot.flexible:
            self.set_motors(state.angle[lane], state.speed[lane])

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

    def set_wrench(self, force, moment):
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

    def accelerations(self, torques):
        """``Ẍ`` in the present state under motor torques of shape (m,) [N·m], shape (n,)."""
        qacc = self._forward(torques)[: self._platform_speeds]
        if self.robot.kind != "spatial":
            return qacc
        pose, velocity = self.state()
        turning = euler_rate_matrix_rate(pose[3:], velocity[3:]) @ velocity[3:]
        return np.append(qacc[:3], np.linalg.solve(euler_rate_matrix(pose[3:]), qacc[3:] - turning))

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
