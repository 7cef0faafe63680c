"""Simulated boards in the process of the test: no time passes but that of the robot."""

from cablebot_gym.envs.simulation import Simulation
from cablebot_gym.policies import load
from cablebot_winches.hardware.loop import Pace, drive
from cablebot_winches.hardware.odrive import Winch, Winches
from cablebot_winches.hardware.simulator import SimulatedBoards

FREQUENCY = 500.0


class Loopback:
    """A channel to a simulated board, which notes what is written."""

    def __init__(self, boards, port):
        self._boards = boards
        self._port = port
        self.written = []

    def write(self, text):
        for line in text.splitlines():
            self.written.append(line.partition("*")[0])
            self._boards.receive(self._port, line)

    def read_line(self, deadline):
        output = self._boards.output[self._port]
        return output.pop(0).strip() if output else ""

    def discard_input(self):
        self._boards.output[self._port].clear()


class Rig:
    """A robot on simulated boards, whose winches wind in both directions behind gears."""

    def __init__(self, robot, trajectory, *, payload=0.0, faults=(), real_time=False):
        self.robot = robot
        self.keywords = {"robot": robot, "trajectory": trajectory, "payload": payload}
        self.wiring = []
        for cable in range(robot.cables):
            self.wiring.append(
                Winch(port=f"{cable // 2}", axis=cable % 2, sign=(-1) ** cable, gear=1 + cable)
            )
        episode = Simulation(robot, (), {"trajectory": trajectory})
        episode.reset(episode.motion_steps * 0)
        self.boards = SimulatedBoards(
            robot,
            self.wiring,
            start_pose=episode.task(0).start_pose,
            payload=payload,
            control_frequency=FREQUENCY,
            faults=faults,
            real_time=real_time,
        )
        self.channels = {port: Loopback(self.boards, port) for port in self.boards.output}
        self.winches = Winches(self.wiring, self.channels)

    def drive(self, policy, *, pace=None, armed=True, **keywords):
        loaded = load(policy, self.robot)
        pace = pace or Pace(real_time=False)
        return drive(loaded, self.winches, pace=pace, armed=armed, **self.keywords | keywords)
