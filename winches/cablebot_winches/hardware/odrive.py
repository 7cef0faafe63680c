"""Winches behind the ASCII protocol of ODrive, firmware 0.5 [1]_.

Lines end with a line feed. Positions are in turns, speeds in turns per second and torques in N·m at
the encoder. Every line here has a checksum: a board ignores a line that was damaged on its way, and
its reply has a checksum too.

.. [1] https://docs.odriverobotics.com/v/0.5.5/ascii-protocol.html
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import number, record
from cablebot_gym.utils.files import read_text
from cablebot_winches.hardware.channel import Channel

IDLE = 1
"""State of an axis whose motor has no current."""

CLOSED_LOOP_CONTROL = 8
"""State of an axis that controls its motor."""

TORQUE_CONTROL = 1
VELOCITY_CONTROL = 2

AXES = 2
"""Number of axes of a board."""


@dataclass(frozen=True, kw_only=True)
class Winch:
    """Where the motor of a cable is connected, and how its encoder counts.

    Raises:
        ValueError: if a value is invalid.
    """

    port: str
    """Port of its board: ``/dev/ttyACM0``, ``COM3``, ``socket://host:port``."""
    axis: int = 0
    """Axis of the board, 0 or 1."""
    sign: int = 1
    """1 if the cable winds up while the position of the axis grows, else −1."""
    gear: float = 1.0
    """Turns of the encoder in one turn of the drum; > 0."""

    def __post_init__(self) -> None:
        if self.axis not in range(AXES) or self.sign not in (-1, 1):
            raise ValueError(f"winch at {self.port}: axis must be 0 or 1, and sign 1 or -1")
        number("gear", self.gear, above=0)


def plain_wiring(ports: Sequence[str], robot: Robot) -> tuple[Winch, ...]:
    """Winches in the order of the cables, two at each port.

    Raises:
        ValueError: if the number of ports does not fit the robot.
    """
    boards = -(-robot.cables // AXES)
    if len(ports) != boards:
        raise ValueError(
            f"{robot.name} has {robot.cables} winches on {boards} boards: give --port {boards} "
            f"times, not {len(ports)}, or a file with --wiring"
        )
    winches = []
    for cable in range(robot.cables):
        winches.append(Winch(port=ports[cable // AXES], axis=cable % AXES))
    return tuple(winches)


def read_wiring(path: str | Path, robot: Robot) -> tuple[Winch, ...]:
    """Winches from a TOML file with a table ``[[winch]]`` for each cable, whose keys are the fields
    of :class:`Winch`.

    Raises:
        ValueError: if the file cannot be read, or does not have one axis for each cable.
    """
    path = Path(path)
    try:
        tables = tomllib.loads(read_text(path)).get("winch", [])
    except OSError as error:
        raise ValueError(f"cannot read wiring {str(path)!r}: {error.strerror}") from error
    winches = tuple(record("winch", Winch, table) for table in tables)
    axes = {(winch.port, winch.axis) for winch in winches}
    if len(winches) != robot.cables or len(axes) < len(winches):
        raise ValueError(
            f"{path.name}: {robot.name} needs {robot.cables} tables [[winch]], each with its own "
            "port and axis"
        )
    return winches


def with_checksum(text: str) -> str:
    """A line with its checksum, the exclusive or of its characters, and its end."""
    return f"{text}*{reduce(xor, text.encode('ascii', 'replace'), 0)}\n"


def without_checksum(line: str) -> str | None:
    """The text of a line; None if it has no checksum, or a wrong one."""
    text = line.rpartition("*")[0]
    if with_checksum(text).rstrip() != line:
        return None
    return text


def parsed_numbers(line: str, count: int) -> list[float] | None:
    """Numbers of a reply; None if it is damaged, or does not consist of ``count`` finite numbers."""
    try:
        values = [float(word) for word in (without_checksum(line) or "").split()]
    except ValueError:
        return None
    if len(values) != count or not all(map(math.isfinite, values)):
        return None
    return values


class Winches:
    """All winches of a robot, with angles, speeds and torques of their drums.

    Args:
        wiring: winches in the order of the cables.
        channels: open channels by the name of the port.
    """

    def __init__(self, wiring: Sequence[Winch], channels: Mapping[str, Channel]) -> None:
        self._wiring = wiring
        self._channels = channels
        gear = np.array([winch.gear for winch in wiring])
        self._per_turn = 2 * np.pi * np.array([winch.sign for winch in wiring]) / gear
        """Angle of the drum per turn of the encoder [rad]."""
        self._per_torque = self._per_turn / (2 * np.pi)
        """Torque of the motor per torque of the drum."""
        self._zero = np.zeros(len(wiring))
        self._rounds: list[list[int]] = []
        for winch in range(len(wiring)):
            self._add_to_round(winch)

    def _add_to_round(self, winch: int) -> None:
        """Winches of one round have different ports, which work at the same time. A board drops a
        reply if it is still sending another one."""
        port = self._wiring[winch].port
        for winches in self._rounds:
            if port not in [self._wiring[member].port for member in winches]:
                winches.append(winch)
                return
        self._rounds.append([winch])

    def __len__(self) -> int:
        return len(self._wiring)

    def check_ready(self, deadline: float) -> None:
        """Checks that all axes control their motors and have no error.

        Raises:
            ConnectionError: if a winch does not answer, or is not ready.
        """
        for winch, item in enumerate(self._wiring):
            label = f"winch {winch + 1} (axis {item.axis} at {item.port})"
            error = self.error(winch, deadline)
            state = self._property(winch, "current_state", deadline)
            if error is None or state is None:
                raise ConnectionError(f"{label} does not answer: check power, port and wiring")
            if error:
                raise ConnectionError(f"{label} has error {error:#x}: find its cause and clear it")
            if state != CLOSED_LOOP_CONTROL:
                raise ConnectionError(
                    f"{label} is in state {state}, not CLOSED_LOOP_CONTROL "
                    f"({CLOSED_LOOP_CONTROL}): let it hold the platform at the start pose"
                )

    @property
    def questions(self) -> int:
        """Number of questions that :meth:`feedback` asks one after the other."""
        return len(self._rounds)

    def home(self, angles: Array, begin: float, reply_time: float) -> None:
        """Makes the present angles equal to ``angles``, (m,) [rad]. The times are those of
        :meth:`feedback`.

        Raises:
            ConnectionError: if a winch does not answer.
        """
        read, _ = self.feedback(begin, reply_time)
        if np.isnan(read).any():
            silent = int(np.flatnonzero(np.isnan(read))[0])
            raise ConnectionError(f"winch {silent + 1} does not answer at the start")
        self._zero = self._zero + angles - read

    def feedback(self, begin: float, reply_time: float) -> tuple[Array, Array]:
        """Angles [rad] and speeds [rad/s], each (m,); NaN of winches whose reply is damaged or does
        not come in time.

        Args:
            begin: present time [s].
            reply_time: longest time for the replies to a question [s]. A silent board does not take
                the time of the others.
        """
        turns = np.full((2, len(self)), np.nan)
        for channel in self._channels.values():
            channel.discard_input()
        # What comes late would be taken for the reply to the next question.
        lost: set[str] = set()
        for question, winches in enumerate(self._rounds, 1):
            deadline = begin + question * reply_time
            answering = [winch for winch in winches if self._wiring[winch].port not in lost]
            for winch in answering:
                self._write(winch, f"f {self._wiring[winch].axis}")
            for winch in answering:
                reply = parsed_numbers(self._channel(winch).read_line(deadline), 2)
                if reply is None:
                    lost.add(self._wiring[winch].port)
                else:
                    turns[:, winch] = reply
        angle, speed = turns * self._per_turn
        return self._zero + angle, speed

    def error(self, winch: int, deadline: float) -> int | None:
        """Error flags of an axis; None if the reply is lost."""
        return self._property(winch, "error", deadline)

    def start_watchdogs(self, timeout: float) -> None:
        """Makes an axis disarm its motor if no command comes for ``timeout`` [s]."""
        for winch, item in enumerate(self._wiring):
            name = f"axis{item.axis}.config"
            self._write(
                winch,
                f"w {name}.watchdog_timeout {timeout!r}",
                f"u {item.axis}",
                f"w {name}.enable_watchdog 1",
            )

    def end_watchdogs(self) -> None:
        """Makes all axes keep on without commands."""
        for winch, item in enumerate(self._wiring):
            self._write(winch, f"w axis{item.axis}.config.enable_watchdog 0")

    def send(self, torques: Array) -> None:
        """Commands torques (m,) [N·m]. This feeds the watchdogs."""
        lines: dict[str, list[str]] = {port: [] for port in self._channels}
        for item, torque in zip(self._wiring, (self._per_torque * torques).tolist(), strict=True):
            lines[item.port].append(with_checksum(f"c {item.axis} {torque!r}"))
        for port, commands in lines.items():
            self._channels[port].write("".join(commands))

    def hold(self, torques: Array) -> None:
        """Stops all winches at speed 0 and ends their watchdogs, so that they hold from now on.

        Args:
            torques: torques from which the speed controllers start, (m,) [N·m]. Torque control has
                cleared their integrators: without torques the platform would fall until they have
                found its weight.
        """
        for winch, torque in enumerate((self._per_torque * torques).tolist()):
            axis = self._wiring[winch].axis
            self._write(
                winch,
                f"w axis{axis}.controller.config.control_mode {VELOCITY_CONTROL}",
                f"v {axis} 0 {torque!r}",
            )
        self.end_watchdogs()

    def _property(self, winch: int, name: str, deadline: float) -> int | None:
        self._channel(winch).discard_input()
        self._write(winch, f"r axis{self._wiring[winch].axis}.{name}")
        reply = parsed_numbers(self._channel(winch).read_line(deadline), 1)
        if reply is None:
            return None
        return int(reply[0])

    def _channel(self, winch: int) -> Channel:
        return self._channels[self._wiring[winch].port]

    def _write(self, winch: int, *texts: str) -> None:
        self._channel(winch).write("".join(map(with_checksum, texts)))
