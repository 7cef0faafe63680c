"""A batch of robots in the memory of the compiled kernel. Its interface uses ordinary arrays, batch
axis first."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import kernel
from cablebot_gym.physics.kernel import rows
from cablebot_gym.physics.textbook import cable_lengths
from cablebot_gym.robots import Cable, Robot
from cablebot_gym.uncertainty import RobotArrays


def form_of(robot: RobotArrays) -> kernel.Form:
    """Form of a robot, for which the kernel is compiled."""
    is_lopsided = robot.kind == "planar-platform" or bool(
        np.any(robot.mass_center) or np.any(_products_of_inertia(robot))
    )
    return kernel.Form(
        dimensions=robot.dimensions,
        coordinates=robot.coordinates,
        cables=robot.cables,
        jointed=robot.jointed,
        elastic=robot.elastic,
        swivel=robot.swivel is not None,
        lopsided=is_lopsided,
        load_friction=bool(np.any(robot.load_friction)),
    )


def _products_of_inertia(robot: RobotArrays) -> Array:
    """xy, xz and yz components of the inertia tensor, shape (..., 3)."""
    return robot.inertia_tensor[..., (0, 0, 1), (1, 2, 2)]


def pack_parameters(robot: RobotArrays) -> Array:
    """Kernel parameters without payload: shape (parameter rows,) for one robot, (N, parameter rows)
    for N robots."""
    batch = robot.base.shape[:-2]
    form = form_of(robot)
    parameters = np.zeros((*batch, rows.parameter_rows(form)))
    d = robot.dimensions
    radius = robot.pulley_radius
    moments = np.diagonal(robot.inertia_tensor, axis1=-2, axis2=-1)
    parameters[..., rows.MASS] = robot.mass
    parameters[..., rows.INERTIA : rows.INERTIA + 3] = moments
    parameters[..., rows.GRAVITY] = robot.gravity_vector[-1]
    parameters[..., rows.FRICTION_SPEED] = robot.transmission.friction_speed
    if form.lopsided:
        body = parameters[..., rows.body_parameter(robot.cables) :]
        body[..., rows.PRODUCTS : rows.PRODUCTS + 3] = _products_of_inertia(robot)
        body[..., rows.CENTER : rows.CENTER + d] = robot.mass_center
    cables = np.zeros((*batch, robot.cables, rows.CABLE_PARAMETERS))
    cables[..., rows.BASE : rows.BASE + d] = robot.base
    cables[..., rows.PLATFORM : rows.PLATFORM + d] = robot.platform - robot.mass_center
    cables[..., rows.PER_RADIUS] = 1 / radius
    cables[..., rows.INERTIA_PER_RADIUS2] = robot.pulley_inertia / radius**2
    cables[..., rows.DAMPING_PER_RADIUS2] = robot.damping / radius**2
    cables[..., rows.STALL] = robot.stall_torque
    cables[..., rows.SLOPE] = robot.speed_slope
    cables[..., rows.LAG] = robot.motor_lag
    cables[..., rows.COULOMB_FRICTION] = robot.coulomb_friction
    if robot.flexible:
        home_length = cable_lengths(robot, robot.home)
    if robot.jointed:
        cables[..., rows.STIFFNESS] = robot.stiffness
        cables[..., rows.PER_MOTOR_INERTIA] = 1 / robot.motor_inertia
        cables[..., rows.MOTOR_DAMPING] = robot.motor_damping
        cables[..., rows.HOME_LENGTH] = home_length
    if form.stretches:
        stretch = np.zeros((*batch, robot.cables, rows.STRETCH_PARAMETERS))
        stretch[..., rows.RADIUS] = radius
        stretch[..., rows.LOAD_FRICTION] = robot.load_friction
        if robot.swivel is not None:
            stretch[..., rows.SWIVEL] = robot.swivel
        if robot.elastic:
            stretch[..., rows.PER_PULLEY_INERTIA] = 1 / robot.pulley_inertia
            stretch[..., rows.AXIAL_STIFFNESS] = robot.axial_stiffness
            stretch[..., rows.AXIAL_DAMPING] = robot.axial_damping
            stretch[..., rows.FULL_LENGTH] = home_length + robot.extra_length
            stretch[..., rows.EXTRA_LENGTH] = robot.extra_length
        start = rows.stretch_parameter(robot.cables, form.lopsided)
        parameters[..., start:] = stretch.reshape(*batch, -1)
    parameters[..., _cable_rows(robot)] = cables.reshape(*batch, -1)
    return parameters


def _cable_rows(robot: RobotArrays) -> slice:
    """Rows of the parameters of all cables."""
    return slice(rows.FIRST_CABLE_PARAMETER, rows.body_parameter(robot.cables))


def kernel_memory(*shape: int) -> Array:
    """Array of zeros that starts at a cache line; loads across two lines make the kernel 20 %
    slower."""
    count = math.prod(shape)
    line = 64  # bytes of a cache line
    memory = np.zeros(count + line // 8)
    start = -memory.ctypes.data % line // 8
    return memory[start : start + count].reshape(shape)


FEW_ROBOTS = 4
"""Largest number of robots that are computed one after the other: faster than a tile with unused
lanes, in Python, too."""


class Plant:
    """N robots of one kind, each with its own parameters, which the compiled kernel advances
    together.

    A batch of few robots runs the same source code, compiled for one lane. The unused lanes of the
    last tile of others repeat robot N − 1.

    Args:
        robot: nominal robot.
        count: number of robots N.
        cable: ``unilateral`` cables can only pull, ``bilateral`` cables can push too.
    """

    def __init__(self, robot: Robot, count: int, *, cable: Cable = "unilateral") -> None:
        self.robot = robot
        self.count = count
        self.unilateral = cable == "unilateral"
        self.lanes = 1 if count <= FEW_ROBOTS else rows.LANES
        tiles = -(-count // self.lanes)  # rounded up
        self.width = tiles * self.lanes
        """Number of lanes in memory: N plus the padding of the last tile."""
        self._form = form_of(robot)
        self._parameters = kernel_memory(tiles, self._parameter_rows * self.lanes)
        self.record = kernel_memory(tiles, rows.record_rows(self._form) * self.lanes)
        """The kernel's record; ``kernel`` defines its rows."""
        self.trajectory_index = np.zeros(self.width, np.int64)
        """Index of the reference trajectory of each lane, shape (width,)."""
        self.step_index = np.zeros(self.width, np.int64)
        """Control steps since the reset of each lane, shape (width,)."""
        # Never reset to False: code that has a lag or friction of zero gives the same result.
        self._has_lag = False
        """Whether some robot has had a motor lag so far."""
        self._has_friction = False
        """Whether some robot has had Coulomb friction so far."""
        self._bind()
        parameters = np.broadcast_to(pack_parameters(robot), (count, self._parameter_rows))
        self.set_parameters(np.arange(count), parameters)

    def __getstate__(self) -> dict[str, Any]:
        """The attributes without those of :meth:`_bind`."""
        bound = ("_advance", "_action", "_memory")
        return {name: value for name, value in self.__dict__.items() if name not in bound}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restores a copy or pickle with aligned memory."""
        self.__dict__.update(state)
        for name in ("_parameters", "record"):
            memory = kernel_memory(*state[name].shape)
            memory[...] = state[name]
            setattr(self, name, memory)
        self._bind()

    def _bind(self) -> None:
        """Makes the views of the arrays, which copies and pickles lose, and finds the function."""
        self._advance = kernel.compiled(self._form, self.lanes).advance
        start = rows.FIRST_CABLE_RECORD + rows.DEMAND
        self._action = self._view(self.record, start, self.robot.cables, rows.CABLE_RECORDS)
        scratch = kernel_memory(rows.scratch_rows(self._form) * self.lanes)
        self._memory = self._parameters, self.record, scratch

    @property
    def _parameter_rows(self) -> int:
        return rows.parameter_rows(self._form)

    def _view(self, memory: Array, row: int, row_count: int, stride: int = 1) -> Array:
        """View of rows of a tiled memory, shape (tiles, rows, lanes)."""
        tiled = memory.reshape(memory.shape[0], -1, self.lanes)
        return tiled[:, row : row + row_count * stride : stride]

    def _read(self, memory: Array, row: int, row_count: int, stride: int = 1) -> Array:
        view = self._view(memory, row, row_count, stride)
        return view.transpose(0, 2, 1).reshape(self.width, row_count)[: self.count].copy()

    def _write(self, memory: Array, row: int, index: Array, values: Array, stride: int = 1) -> None:
        view = self._view(memory, row, values.shape[-1], stride)
        tile, lane = np.divmod(index, self.lanes)
        view[tile, :, lane] = values
        if self.count - 1 in index:  # the padding repeats the last robot
            tile, lane = np.divmod(np.arange(self.count - 1, self.width), self.lanes)
            view[tile[1:], :, lane[1:]] = view[tile[0], :, lane[0]]

    def _write_cables(self, row: int, index: ArrayLike, values: ArrayLike) -> None:
        """Writes a row of the record per cable, values (len(index), m)."""
        start = rows.FIRST_CABLE_RECORD + row
        values = np.asarray(values, float)
        self._write(self.record, start, np.asarray(index), values, rows.CABLE_RECORDS)

    def set_parameters(self, index: Array, parameters: Array) -> None:
        """Sets the parameters of the robots at ``index`` and resets their external wrench to zero.

        Args:
            index: robots, shape (k,).
            parameters: values from :func:`pack_parameters`, shape (k, parameter rows).
        """
        parameters = np.asarray(parameters, float)
        self._write(self._parameters, 0, np.asarray(index), parameters)
        cables = parameters[:, _cable_rows(self.robot)]
        lags = cables[:, rows.LAG :: rows.CABLE_PARAMETERS]
        frictions = cables[:, rows.COULOMB_FRICTION :: rows.CABLE_PARAMETERS]
        self._has_lag |= bool(np.any(lags))
        self._has_friction |= bool(np.any(frictions))

    def set_wrench(self, index: Array, force: Array, moment: Array | None = None) -> None:
        """Sets the external wrench on the platforms of the robots at ``index``. It stays until it
        is changed.

        Args:
            index: robots, shape (k,).
            force: force at the centre of mass in the base frame [N], shape (k, 3), or (k, 2) if
                planar.
            moment: moment in the base frame [N·m], shape (k, 3), or (k, 1) about the normal of a
                plane; None for zero. Has no effect on a point mass.
        """
        wrench = np.zeros((len(index), 6))
        wrench[:, : np.shape(force)[-1]] = force
        if moment is not None:
            wrench[:, 6 - np.shape(moment)[-1] :] = moment
        self._write(self._parameters, rows.FORCE, np.asarray(index), wrench)

    def set_state(self, index: Array, pose: Array, velocity: Array) -> None:
        """Resets the robots at ``index`` to poses X and velocities Ẋ, each (len(index), n), and to
        control step 0."""
        index = np.asarray(index)
        self._write(self.record, 0, index, np.zeros((len(index), rows.record_rows(self._form))))
        self._write(self.record, rows.POSE, index, np.asarray(pose, float))
        self._write(self.record, rows.VELOCITY, index, np.asarray(velocity, float))
        self.step_index[index] = 0
        if self.count - 1 in index:
            self.step_index[self.count :] = 0

    def set_motors(self, index: Array, angle: Array, speed: Array) -> None:
        """Sets motor angles β′ and speeds β̇′, each (len(index), m), of flexible robots after
        :meth:`set_state`."""
        self._write_cables(rows.MOTOR_ANGLE, index, angle)
        self._write_cables(rows.MOTOR_SPEED, index, speed)

    def set_torques(self, index: Array, torques: Array) -> None:
        """Sets the recorded motor torques (len(index), m) [N·m] after :meth:`set_state`.

        A lag starts from them, within the stall torques.
        """
        row = rows.FIRST_CABLE_PARAMETER + rows.STALL
        stall = self._read(self._parameters, row, self.robot.cables, rows.CABLE_PARAMETERS)[index]
        self._write_cables(rows.TORQUE, index, torques)
        self._write_cables(rows.LAGGED, index, np.clip(torques, -stall, stall))

    def set_action(self, action: Array) -> None:
        """Sets the actions of all robots, shape (N, m), or (m,) for one robot."""
        if self.count == 1:
            self._action[0, :, 0] = action
        elif self.width == self.count:
            self._action[...] = action.reshape(-1, self.lanes, self.robot.cables).transpose(0, 2, 1)
        else:
            self._write_cables(rows.DEMAND, np.arange(self.count), action)

    def advance(self, references: Array, ends: Array, *, substeps: int, step: float) -> None:
        """Advances all robots by one control period of ``substeps`` RK4 steps.

        Args:
            references: reference poses at every physics step from 0 on, shape (trajectories, lines,
                n). After the last line the reference stays constant.
            ends: index of the last line of each trajectory, shape (trajectories,).
            substeps: physics steps per control period.
            step: length of a physics step [s].
        """
        self.advance_call(references, ends, substeps=substeps, step=step)()

    def advance_call(
        self, references: Array, ends: Array, *, substeps: int, step: float
    ) -> Callable[[], None]:
        """The call of :meth:`advance`. It can be used until parameters of the robots change."""
        return partial(
            self._advance.present,
            self.unilateral,
            self._has_lag,
            self._has_friction,
            *self._memory,
            references,
            ends,
            self.trajectory_index,
            self.step_index,
            substeps,
            step,
        )

    @property
    def pose(self) -> Array:
        """Poses X, shape (N, n)."""
        return self._read(self.record, rows.POSE, self.robot.coordinates)

    @property
    def velocity(self) -> Array:
        """Velocities Ẋ, shape (N, n)."""
        return self._read(self.record, rows.VELOCITY, self.robot.coordinates)

    @property
    def motor_angle(self) -> Array:
        """Motor angles β′ of flexible robots, shape (N, m) [rad]."""
        return self.per_cable(rows.MOTOR_ANGLE)

    @property
    def motor_speed(self) -> Array:
        """Motor speeds β̇′ of flexible robots, shape (N, m) [rad/s]."""
        return self.per_cable(rows.MOTOR_SPEED)

    def per_cable(self, row: int) -> Array:
        """A row of the record per cable, such as ``rows.TENSION``, shape (N, m)."""
        start = rows.FIRST_CABLE_RECORD + row
        return self._read(self.record, start, self.robot.cables, rows.CABLE_RECORDS)
