"""``cablebot drive``."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from cablebot_gym.cli.options import (
    Payload,
    PolicyName,
    TaskOptions,
    fitting_id,
    robot_of,
)
from cablebot_gym.cli.records import Options
from cablebot_gym.utils.console import say
from cablebot_winches.hardware.limits import DriveLimits

if TYPE_CHECKING:
    from cablebot_gym.robots import Robot
    from cablebot_winches.hardware.channel import Channel
    from cablebot_winches.hardware.odrive import Winch
    from cablebot_winches.hardware.result import DriveResult


@dataclass(frozen=True, kw_only=True)
class LimitOptions(DriveLimits, Options):
    """Limits of a drive."""

    title: ClassVar[str] = "Limits, which stop all winches"


@dataclass(frozen=True, kw_only=True)
class WinchOptions(Options):
    """The boards of the winches."""

    title: ClassVar[str] = "Winches"

    port: Annotated[
        list[str] | None,
        "Port of an ODrive with two winches, such as /dev/ttyACM0, COM3 or socket://host:4000; again for each "
        "further one, in the order of the cables.",
    ] = None
    wiring: Annotated[
        Path | None,
        "TOML file with a table [[winch]] for each cable: port, axis, sign and gear. Replaces --port.",
    ] = None
    armed: Annotated[
        bool, typer.Option("--armed", help="Command torques. Without it, winches are only read.")
    ] = False
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Drive simulated winches, which are always armed.")
    ] = False
    real_time: Annotated[
        bool,
        typer.Option(
            "--real-time",
            help="Simulated winches move by the clock. Otherwise they wait for their commands.",
        ),
    ] = False
    fault: Annotated[
        list[str] | None,
        "Fault of a simulated winch, KIND@TIME:WINCH such as drop@0.5:2; again for each further one. Kinds are "
        "drop, garble, nan and delay of a reply, error of an axis, and silence of a board.",
    ] = None

    def check(self) -> None:
        """Checks that the options fit each other.

        Raises:
            ValueError: if the winches are both real and simulated, or neither.
        """
        is_real = bool(self.port) or self.wiring is not None
        if not is_real and not self.simulate:
            raise ValueError("give --port or --wiring of real winches, or --simulate")
        if self.port and (self.simulate or self.wiring is not None):
            raise ValueError("--port excludes --simulate and --wiring: leave one of them out")
        if (self.real_time or self.fault) and not self.simulate:
            raise ValueError("--real-time and --fault need --simulate: real winches have both")


def drive(
    *,
    policy: PolicyName,
    winches: WinchOptions,
    conditions: TaskOptions,
    payload: Payload = None,
    payload_known: Annotated[
        bool,
        typer.Option(
            "--payload-known/--payload-unknown",
            help="Whether the policy's model includes the payload.",
        ),
    ] = True,
    log: Annotated[
        Path | None,
        "CSV file for the log, which `cablebot identify` reads. Written after a stop, too.",
    ] = None,
    limits: LimitOptions,
) -> None:
    """Drive real winches with ODrive controllers along a motion, or simulated ones.

    The platform has to rest at the start pose, held by its winches. Policies read the sensors of
    winches: ekf+NAME runs any policy behind an estimator. At the end, at a limit, after lost
    messages and after Ctrl-C, all winches hold.

    Examples:

    cablebot drive --robot ttk4900 --policy ekf+fl --simulate --log run.csv

    cablebot drive --robot my.toml --policy ekf+fl --port /dev/ttyACM0 --port /dev/ttyACM1 --armed
    """
    from cablebot_gym.policies import load
    from cablebot_gym.utils.files import check_writable_file
    from cablebot_winches.hardware import loop
    from cablebot_winches.hardware.odrive import Winches

    winches.check()
    if log is not None:
        check_writable_file(log)
    robot = robot_of(fitting_id(None, conditions.robot), conditions)
    if payload is None:
        payload = robot.defaults.payload()
    loaded = load(policy, robot)
    pace = loop.Pace(real_time=winches.real_time or not winches.simulate)
    with _open_channels(robot, winches, conditions, payload) as (wiring, channels):
        # A process that is ended has to stop the winches as after Ctrl-C.
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            result = loop.drive(
                loaded,
                Winches(wiring, channels),
                limits=limits,
                armed=winches.armed or winches.simulate,
                pace=pace,
                payload=payload,
                payload_known=payload_known,
                **conditions.keywords() | {"robot": robot},
            )
        finally:
            signal.signal(signal.SIGTERM, before)
    if log is not None:
        result.save(log)
        say(f"wrote {log}")
    frequency = conditions.control_frequency or robot.defaults.control_frequency
    print("\n".join(_lines(result, 1 / frequency)))
    raise typer.Exit(_status(result))


@contextmanager
def _open_channels(
    robot: Robot, options: WinchOptions, conditions: TaskOptions, payload: float
) -> Iterator[tuple[Sequence[Winch], Mapping[str, Channel]]]:
    """The winches and the open channels by port, to real or simulated boards."""
    from cablebot_gym.envs.settings import default_trajectory
    from cablebot_gym.motions import find_trajectory
    from cablebot_gym.task import find_error_bounds, start_pose
    from cablebot_winches.hardware.channel import SerialChannel
    from cablebot_winches.hardware.odrive import AXES, plain_wiring, read_wiring
    from cablebot_winches.hardware.simulator import Fault, simulated_boards

    ports = options.port
    if options.simulate:
        ports = [f"board {board + 1}" for board in range(-(-robot.cables // AXES))]
    if options.wiring is not None:
        wiring = read_wiring(options.wiring, robot)
    else:
        wiring = plain_wiring(ports or [], robot)
    addresses: Mapping[str, str] = {winch.port: winch.port for winch in wiring}
    with ExitStack() as stack:
        if options.simulate:
            motion = find_trajectory(conditions.trajectory or default_trajectory(robot), robot.kind)
            bounds = find_error_bounds(conditions.error_bounds, robot)
            boards = simulated_boards(
                robot,
                wiring,
                real_time=options.real_time,
                start_pose=start_pose(robot, motion, bounds).tolist(),
                payload=payload,
                control_frequency=conditions.control_frequency or robot.defaults.control_frequency,
                faults=[Fault.parse(text) for text in options.fault or []],
            )
            addresses = stack.enter_context(boards)
        channels: dict[str, Channel] = {}
        for port, address in addresses.items():
            channels[port] = stack.enter_context(closing(SerialChannel(address)))
        yield wiring, channels


def _status(result: DriveResult) -> int:
    """Exit status of the command."""
    from cablebot_winches.hardware import loop

    if result.stop is None:
        return 0
    if result.stop.cause == loop.INTERRUPTED:
        return 128 + signal.SIGINT
    return 1


def _lines(result: DriveResult, period: float) -> list[str]:
    """The result as text."""
    outcome = "complete"
    if result.stop is not None:
        outcome = f"stopped: {result.stop}"
    if not result.armed:
        outcome += " (dry run: no torque was commanded, --armed does)"
    lost = "none"
    if any(result.lost):
        counts = []
        for winch, count in enumerate(result.lost):
            counts.append(f"{count} of winch {winch + 1}")
        lost = ", ".join(counts)
    return [
        f"{result.robot}, {result.policy}, {result.motion}: {outcome}",
        f"position error  {1e3 * result.tracking_error:.3g} mm at most, by forward kinematics",
        f"torque          {result.torque_fraction:.1%} of that of a motor at most",
        f"lost replies    {lost}",
        f"late periods    {result.late} of {result.periods}",
        f"computing       {1e3 * result.computing_time:.3g} ms at most, of {1e3 * period:.3g} ms",
    ]
