"""Simulated boards: a process that speaks the protocol of ODrive for all winches of a robot.

In lock-step, the robot moves by one control period when each winch has got a command. In real time
it moves by the clock, and the watchdogs work.
"""

from __future__ import annotations

import math
import multiprocessing
import selectors
import signal
import socket
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Literal, get_args

import numpy as np

from cablebot_gym.envs.simulation import Simulation
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.textbook import normalised_action
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import choice, whole
from cablebot_winches.hardware.odrive import (
    CLOSED_LOOP_CONTROL,
    IDLE,
    TORQUE_CONTROL,
    VELOCITY_CONTROL,
    Winch,
    with_checksum,
    without_checksum,
)

MOTOR_FAILED = 0x40
"""Error flag of an axis whose motor has an error of its own."""

WATCHDOG_TIMER_EXPIRED = 0x800
"""Error flag of an axis whose watchdog has not been fed."""

SPEED_GAIN = 0.2
"""Fraction of a speed error that the simulated speed controllers remove in a control period."""

INTEGRATOR_RATE = 10.0
"""Rate of the integrators of the simulated speed controllers [1/s]."""

GRACE = 5.0
"""Time that the process of the boards has to end [s]."""

FaultKind = Literal["drop", "garble", "nan", "delay", "error", "silence"]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault of a simulated board."""

    kind: FaultKind
    """``drop``, ``garble``, ``nan`` and ``delay`` spoil one reply of the winch, ``error`` disarms
    its motor, and ``silence`` ends its board."""
    time: float
    """Time from which it acts [s]."""
    winch: int = 1
    """Winch, from 1."""

    @classmethod
    def parse(cls, text: str) -> Fault:
        """A fault from text such as ``drop@0.5`` or ``drop@0.5:2``.

        Raises:
            ValueError: if the text is no fault.
        """
        name, _, when = text.partition("@")
        kind = choice("fault", name, get_args(FaultKind), ", such as drop@0.5:2")
        instant, _, winch = when.partition(":")
        try:
            return cls(kind=kind, time=float(instant), winch=int(winch or 1))  # type: ignore[arg-type]
        except ValueError:
            raise ValueError(
                f"fault {text!r} must have the form KIND@TIME:WINCH, such as drop@0.5:2"
            ) from None


class SimulatedBoards:
    """Boards with the winches of a robot, whose platform they hold at rest at the start.

    Args:
        robot: nominal robot.
        wiring: winches in the order of the cables.
        start_pose: pose at rest, (n,).
        payload: payload [kg].
        control_frequency: control periods per second [Hz].
        faults: faults.
        real_time: whether the robot moves by :meth:`advance` alone, which a clock calls.
    """

    def __init__(
        self,
        robot: Robot,
        wiring: Sequence[Winch],
        *,
        start_pose: Sequence[float],
        payload: float = 0.0,
        control_frequency: float,
        faults: Sequence[Fault] = (),
        real_time: bool = False,
    ) -> None:
        motion = {"name": f"dwell-{robot.kind}", "pose": list(robot.home_pose), "duration": 1.0}
        keywords = {
            "trajectory": motion,
            "initial_error": np.asarray(start_pose) - robot.home,
            "payload": payload,
            "control_frequency": control_frequency,
            "measurement": "winches",
        }
        self._robot = robot
        self._plant = Simulation(robot, (), keywords)
        index = np.zeros(1, np.int64)
        self._plant.reset(index)
        self._plant.step(np.zeros(robot.cables))  # compiles, so that no reply is late later
        self._plant.reset(index)
        self._wiring = wiring
        self._winches = {(winch.port, winch.axis): index for index, winch in enumerate(wiring)}
        self._per_turn = np.array([2 * np.pi * winch.sign / winch.gear for winch in wiring])
        self.period = 1 / control_frequency
        """Control period [s]."""
        self._faults = list(faults)
        for fault in faults:
            whole("winch of a fault", fault.winch, least=1, most=robot.cables)
        self._real_time = real_time
        self._start_angle, _ = self._motors()
        inertia = robot.pulley_inertia
        if robot.jointed:
            inertia = robot.motor_inertia
        self._speed_gain = SPEED_GAIN * inertia / self.period
        self._integral = self._plant.torques[0].copy()
        """Torques of the integrators, which hold the platform at first, (m,) [N·m]."""
        self.axes = [_holding_axis() for _ in wiring]
        """Properties of each axis, by winch."""
        self._waiting = set(range(robot.cables))
        """Winches without a command in this control period."""
        self._early: list[tuple[str, str]] = []
        """Port and text of lines for the next control period."""
        self._fed = np.zeros(robot.cables)
        self._silent: set[str] = set()
        self._delayed: list[tuple[float, str, str]] = []
        self.output: dict[str, list[str]] = {winch.port: [] for winch in wiring}
        """Lines that have not been sent yet, by port."""
        self.time = 0.0
        """Time of the robot [s]."""
        self.moves = False
        """Whether the robot moves by the clock: in real time, from the first torque on."""

    @property
    def pose(self) -> Array:
        """True pose X, (n,)."""
        pose: Array = self._plant.pose[0]
        return pose

    def receive(self, port: str, line: str) -> None:
        """Obeys a line. Replies appear in :attr:`output`."""
        if not self._real_time and not self._waits_for(port):
            # The commands to another board have not come yet, and the robot has not moved.
            self._early.append((port, line))
            return
        self._obey(port, line)

    def _waits_for(self, port: str) -> bool:
        """Whether a winch of a board lacks its command of this control period."""
        return any(self._wiring[winch].port == port for winch in self._waiting)

    def _obey(self, port: str, line: str) -> None:
        text = without_checksum(line)
        if text is None or port in self._silent:
            return
        words = text.split()
        if words[0] in ("r", "w"):
            axis, _, name = words[1].partition(".")
            winch = self._winches[port, int(axis.removeprefix("axis"))]
            self._access(port, winch, name, *words[2:])
            return
        winch = self._winches[port, int(words[1])]
        if words[0] == "f":
            angle, speed = self._motors()
            turns = (np.array([angle - self._start_angle, speed]) / self._per_turn)[:, winch]
            self._reply(port, winch, " ".join(map(repr, turns.tolist())))
        elif words[0] in ("c", "v", "u"):
            self._command(winch, words[0], [float(word) for word in words[2:]])
        else:
            self.output[port].append(with_checksum("unknown command"))

    def _access(self, port: str, winch: int, name: str, *value: str) -> None:
        axis = self.axes[winch]
        if name not in axis:
            self.output[port].append(with_checksum("invalid property"))
        elif value:
            axis[name] = float(value[0])
        else:
            self.output[port].append(with_checksum(f"{axis[name]:g}"))

    def _command(self, winch: int, name: str, values: Sequence[float]) -> None:
        """Obeys a command, and feeds the watchdog."""
        axis = self.axes[winch]
        if name == "c":
            axis["controller.config.control_mode"] = TORQUE_CONTROL
            axis["controller.input_torque"] = values[0]
            self._integral[winch] = 0.0
            self.moves = self._real_time
        elif name == "v":
            axis["controller.config.control_mode"] = VELOCITY_CONTROL
            axis["controller.input_vel"], axis["controller.input_torque"] = values
        self._fed[winch] = self.time
        if name == "u" or self._real_time:
            return
        self._waiting.discard(winch)
        if not self._waiting:
            self.advance()

    def _reply(self, port: str, winch: int, text: str) -> None:
        """Sends a reading, unless a fault spoils it."""
        line = with_checksum(text)
        for fault in self._faults:
            if fault.winch - 1 != winch or self.time < fault.time or fault.kind == "error":
                continue
            self._faults.remove(fault)
            if fault.kind == "nan":
                self.output[port].append(with_checksum("nan nan"))
            elif fault.kind == "garble":
                self.output[port].append(line.replace(".", "#", 1))
            elif fault.kind == "delay":
                self._delayed.append((self.time + self.period, port, line))
            elif fault.kind == "silence":
                self._silent.add(port)
            return
        self.output[port].append(line)

    def advance(self) -> None:
        """Moves the robot by one control period."""
        self._fail_axes()
        robot = self._robot
        _, speed = self._motors()
        torque = self._torques(speed)
        action = normalised_action(robot, torque, speed)
        self._plant.step(np.clip(action, -1.0, 1.0))
        self.time += self.period
        for winch, item in enumerate(self._wiring):
            if item.port not in self._silent:
                self._waiting.add(winch)
        for entry in list(self._delayed):
            due, port, line = entry
            if due <= self.time:
                self._delayed.remove(entry)
                self.output[port].append(line)
        early = self._early
        self._early = []
        for port, line in early:
            self._obey(port, line)

    def _fail_axes(self) -> None:
        """Disarms axes with a fault, or whose watchdog is not fed."""
        for fault in self._faults:
            if fault.kind == "error" and self.time >= fault.time:
                self._disarm(fault.winch - 1, MOTOR_FAILED)
        for winch, axis in enumerate(self.axes):
            unfed = self.time - self._fed[winch]
            if axis["config.enable_watchdog"] and unfed > axis["config.watchdog_timeout"]:
                self._disarm(winch, WATCHDOG_TIMER_EXPIRED)

    def _disarm(self, winch: int, error: int) -> None:
        self.axes[winch]["error"] = int(self.axes[winch]["error"]) | error
        self.axes[winch]["current_state"] = IDLE

    def _torques(self, speed: Array) -> Array:
        """Torques of the drums by the controllers of the axes, (m,) [N·m]."""
        torques = np.zeros(len(self.axes))
        for winch, axis in enumerate(self.axes):
            if axis["current_state"] != CLOSED_LOOP_CONTROL:
                continue
            to_drum = 2 * np.pi / self._per_turn[winch]
            torque = to_drum * axis["controller.input_torque"]
            if axis["controller.config.control_mode"] == VELOCITY_CONTROL:
                set_speed = axis["controller.input_vel"] * self._per_turn[winch]
                push = self._speed_gain[winch] * (set_speed - speed[winch])
                self._integral[winch] += INTEGRATOR_RATE * self.period * push
                torque += push + self._integral[winch]
            torques[winch] = torque
        return torques

    def _motors(self) -> tuple[Array, Array]:
        """Angles [rad] and speeds [rad/s] of the motors, each (m,)."""
        blocks = self._plant.layout.split(self._plant.observation[0])
        return blocks["motor_angle"].copy(), blocks["motor_speed"].copy()


def _holding_axis() -> dict[str, float]:
    """Properties of an axis that holds its winch."""
    return {
        "error": 0,
        "current_state": CLOSED_LOOP_CONTROL,
        "controller.config.control_mode": VELOCITY_CONTROL,
        "controller.input_vel": 0.0,
        "controller.input_torque": 0.0,
        "config.watchdog_timeout": 0.0,
        "config.enable_watchdog": 0,
    }


@contextmanager
def simulated_boards(
    robot: Robot, wiring: Sequence[Winch], *, real_time: bool, **keywords: Any
) -> Iterator[Mapping[str, str]]:
    """Starts a process with simulated boards, and ends it after the block.

    Args:
        robot: nominal robot.
        wiring: winches in the order of the cables.
        real_time: whether the robot moves by the clock.
        keywords: further arguments of :class:`SimulatedBoards`.

    Yields:
        The address of each board by its port, for a channel.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    arguments = robot, wiring, keywords, real_time, theirs
    process = context.Process(target=_run, args=arguments, daemon=True)
    process.start()
    theirs.close()
    try:
        answer = ours.recv()
        if isinstance(answer, ValueError):
            raise answer
        yield answer
    except EOFError:
        raise RuntimeError("the process of the simulated boards ended at its start") from None
    finally:
        ours.close()
        process.join(GRACE)
        if process.is_alive():
            process.kill()
            process.join()


def _run(
    robot: Robot,
    wiring: Sequence[Winch],
    keywords: dict[str, Any],
    real_time: bool,
    parent: Connection,
) -> None:
    """Serves the boards at local sockets until the parent's end of the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the loop has to stop the winches first
    try:
        boards = SimulatedBoards(robot, wiring, real_time=real_time, **keywords)
    except ValueError as error:
        parent.send(error)
        return
    listeners = {port: socket.create_server(("127.0.0.1", 0)) for port in boards.output}
    addresses = {}
    for port, listener in listeners.items():
        addresses[port] = f"socket://127.0.0.1:{listener.getsockname()[1]}"
    threading.Thread(target=_serve, args=(boards, listeners), daemon=True).start()
    parent.send(addresses)
    with suppress(EOFError):
        parent.recv()


def _serve(boards: SimulatedBoards, listeners: Mapping[str, socket.socket]) -> None:
    """Serves the boards for ever."""
    connections: list[_Connection] = []
    due = math.inf
    with selectors.DefaultSelector() as selector:
        for port, listener in listeners.items():
            selector.register(listener, selectors.EVENT_READ, _Connection(port))
        while True:
            timeout = None
            if due < math.inf:
                timeout = max(0.0, due - time.monotonic())
            for key, _ in selector.select(timeout):
                if key.data.socket is None:
                    connections.append(_accept(selector, key))
                elif not key.data.obey(boards):
                    selector.unregister(key.fileobj)
                    connections.remove(key.data)
            if boards.moves and due == math.inf:
                due = time.monotonic()
            while time.monotonic() >= due:
                boards.advance()
                due += boards.period
            for connection in connections:  # the command to one board may free replies of others
                connection.answer(boards)


def _accept(selector: selectors.BaseSelector, key: selectors.SelectorKey) -> _Connection:
    """Accepts a connection to a board."""
    listener: Any = key.fileobj
    accepted, _ = listener.accept()
    accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection = _Connection(key.data.port, accepted)
    selector.register(accepted, selectors.EVENT_READ, connection)
    return connection


class _Connection:
    """A socket of a board: the listener, or a connection.

    Args:
        port: port of the board.
        connected: the connected socket; None for the listener.
    """

    def __init__(self, port: str, connected: socket.socket | None = None) -> None:
        self.port = port
        self.socket = connected
        self._partial = b""

    def obey(self, boards: SimulatedBoards) -> bool:
        """Passes on the lines that have come; returns whether the connection is still open."""
        assert self.socket is not None
        received = self.socket.recv(4096)
        *lines, self._partial = (self._partial + received).split(b"\n")
        for line in lines:
            boards.receive(self.port, line.decode("ascii", "replace").strip())
        return bool(received)

    def answer(self, boards: SimulatedBoards) -> None:
        """Sends what the board has to say."""
        assert self.socket is not None
        self.socket.sendall("".join(boards.output[self.port]).encode("ascii"))
        boards.output[self.port].clear()
