"""The loop on simulated boards: the motion is that of the environment, and faults stop all
winches."""

import gymnasium as gym
import numpy as np
import pytest
from clock import Clock
from hardware.loopback import Rig
from numpy.testing import assert_allclose

from cablebot_gym.envs import fitting_env_id
from cablebot_gym.policies import load
from cablebot_gym.robots import find_robot
from cablebot_winches.hardware import loop
from cablebot_winches.hardware.limits import DriveLimits
from cablebot_winches.hardware.loop import Pace, estimated_pose
from cablebot_winches.hardware.odrive import IDLE, VELOCITY_CONTROL
from cablebot_winches.hardware.simulator import MOTOR_FAILED, WATCHDOG_TIMER_EXPIRED, Fault
from cablebot_winches.identification import identify, read_log

TTK = find_robot("ttk4900")
LINE = {"name": "line-planar-platform", "duration": 1.0, "dwell": 0.1}


def episode(robot, name, trajectory, payload):
    """Angles and actions of an episode of the environment."""
    env = gym.make(
        fitting_env_id(robot),
        robot=robot,
        trajectory=trajectory,
        payload=payload,
        measurement="winches",
    ).unwrapped
    policy = load(name, robot)
    observation, _ = env.reset(seed=0)
    policy.reset(lambda: (env.task,))
    state = None
    angles, torques = [], []
    is_complete = False
    while not is_complete:
        angles.append(env.layout.split(observation)["motor_angle"])
        action, state = policy.act(
            observation[None],
            state,
            np.array([state is None]),
            cables=robot.cables,
            payloads=np.zeros(1),
            time=0.0,
        )
        observation, _, _, is_complete, info = env.step(action[0])
        torques.append(info["torques"])
    return np.array(angles), np.array(torques)


@pytest.mark.parametrize(
    ("name", "policy", "trajectory", "payload"),
    [
        ("ttk4900", "ekf+fl", LINE, 0.5),
        ("flex-planar", "ekf+motor-pd", None, 1.0),
        ("flex-ttk4900", "fk+motor-pd", LINE, 0.5),
    ],
)
def test_drive_is_the_episode_of_the_environment(name, policy, trajectory, payload):
    """Any wrong unit, sign, gear, zero, delay or order of a reading or a torque makes another one.
    Only the rounding of turns to radians is different."""
    robot = find_robot(name)
    result = Rig(robot, trajectory, payload=payload).drive(policy)
    angles, torques = episode(robot, policy, trajectory, payload)
    assert result.stop is None
    for motor in range(robot.cables):
        assert_allclose(result.log[f"angle_{motor + 1}"], angles[:, motor], atol=1e-9)
        assert_allclose(result.log[f"torque_{motor + 1}"], torques[:, motor], atol=1e-9)
    assert result.tracking_error < 0.006


class Holds:
    """FL behind forward kinematics until a step, at which it does something else."""

    measurement = "winches"

    def __init__(self, at, otherwise):
        self._policy = load("fk+fl", TTK).policy
        self._at = at
        self._otherwise = otherwise

    def reset(self, tasks):
        self._policy.reset(tasks)
        self._step = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = self._policy.predict(observation, state, episode_start)
        self._step += 1
        if self._step > self._at:
            action = self._otherwise(action)
        return action, state


CLOCK = Clock()


def broken(action):
    raise RuntimeError("lost")


def interrupted(action):
    raise KeyboardInterrupt


def slow(action):
    CLOCK.now += 0.01
    return action


def limp(action):
    return 0.0 * action


FALLS = {"error_limit": 1e9, "slack_limit": 1e9}
STOPS = {
    "silent board": ("silence@0.1:3", None, {}, "lost messages of winch 3 at t = 0.102 s"),
    "patient": ("silence@0.1:3", None, {"lost_limit": 4}, "messages of winch 3 at t = 0.106 s"),
    "axis error": ("error@0.1:2", None, {}, f"axis error {MOTOR_FAILED:#x} of winch 2 at"),
    "speed": (None, None, {"speed_limit": 0.1}, "motor speed limit of winch"),
    "torque": (None, None, {"torque_limit": 0.65}, "torque limit of winch 3 at t = 0."),
    "error": (None, limp, {"error_limit": 1.0}, "position error limit at t = 0."),
    "limp": (None, limp, {"error_limit": 1e9}, "too little tension of winch"),
    "falls": (None, limp, FALLS, "workspace left at t = "),
    "policy": (None, broken, {}, "it raised RuntimeError: lost"),
    "Ctrl-C": (None, interrupted, {}, "interrupted at t = 0.100 s"),
    "slow": (None, slow, {}, "computer too slow at t = "),
}


@pytest.mark.parametrize("case", STOPS)
def test_stop_has_a_cause_and_all_winches_hold(case, tmp_path):
    fault, otherwise, limits, cause = STOPS[case]
    faults = [Fault.parse(fault)] if fault else []
    rig = Rig(TTK, LINE, payload=0.5, faults=faults)
    policy = Holds(50, otherwise) if otherwise else "fk+fl"
    pace = Pace(real_time=case == "slow", clock=CLOCK)
    result = rig.drive(policy, limits=DriveLimits(**limits), pace=pace)
    assert cause in str(result.stop)
    for winch in rig.wiring:
        commands = rig.channels[winch.port].written
        mode = f"w axis{winch.axis}.controller.config.control_mode {VELOCITY_CONTROL}"
        assert mode in commands
        assert commands[commands.index(mode) + 1].startswith(f"v {winch.axis} 0 ")
        assert not any(line.startswith("c") for line in commands[commands.index(mode) :])
    result.save(tmp_path / "run.csv")
    assert len(read_log(tmp_path / "run.csv", TTK).columns["time"]) == result.periods


@pytest.fixture(scope="module")
def undisturbed():
    return Rig(TTK, LINE, payload=0.5).drive("fk+fl")


@pytest.mark.parametrize("kind", ["drop", "garble", "nan", "delay"])
def test_single_lost_reply_is_extrapolated(kind, undisturbed):
    """A reply that comes late must not be taken for that of the next question."""
    fault = Fault(kind=kind, time=0.4, winch=2)
    result = Rig(TTK, LINE, payload=0.5, faults=[fault]).drive("fk+fl")
    assert result.stop is None
    assert result.lost == (0, 1, 0, 0)
    assert np.isnan(result.log["angle_2"]).sum() == 1
    for motor in range(TTK.cables):
        name = f"torque_{motor + 1}"
        assert_allclose(result.log[name], undisturbed.log[name], atol=0.005)


def test_single_late_period_shifts_the_motion():
    CLOCK.now = 0.0
    late = []

    def once(action):
        CLOCK.now += 0.0 if late else 0.01
        late.append(True)
        return action

    result = Rig(TTK, LINE).drive(Holds(50, once), pace=Pace(clock=CLOCK))
    assert (result.stop, result.late, result.periods) == (None, 1, 600)
    assert_allclose(result.log["time"][[50, 51, 52]], [0.1, 0.11, 0.112])


def test_platform_stays_after_a_stop():
    """Without the torque from which the speed controllers start, it would fall by centimetres."""
    rig = Rig(TTK, LINE, payload=0.5, faults=[Fault(kind="drop", time=0.05)])
    result = rig.drive("fk+fl", limits=DriveLimits(lost_limit=1))
    assert result.stop.cause == "lost messages"
    before = rig.boards.pose.copy()
    for _ in range(1000):
        rig.boards.advance()
    assert np.linalg.norm((rig.boards.pose - before)[:2]) < 0.005


def test_winches_that_hold_are_left_alone():
    """Their integrators carry the platform: further torques would pull it up."""
    rig = Rig(TTK, LINE, payload=0.5)
    result = rig.drive("fk+fl", limits=DriveLimits(torque_limit=0.01))
    assert (result.stop.cause, result.stop.time) == ("torque limit", 0.0)
    before = rig.boards.pose.copy()
    for _ in range(1000):
        rig.boards.advance()
    assert np.linalg.norm((rig.boards.pose - before)[:2]) < 1e-6
    for axis in rig.boards.axes:
        assert not axis["config.enable_watchdog"]


def test_all_that_may_compile_is_called_before_motors_follow(monkeypatch):
    """The first call of a function may compile for seconds."""
    rig = Rig(TTK, LINE)
    calls = []

    class Listed(Holds):
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            calls.append(f"start {episode_start[0]}")
            return super().predict(observation, state, episode_start)

    def listed_pose(*arguments):
        calls.append("pose")
        return estimated_pose(*arguments)

    monkeypatch.setattr(loop, "estimated_pose", listed_pose)
    monkeypatch.setattr(rig.winches, "start_watchdogs", lambda _: calls.append("armed"))
    rig.drive(Listed(99, None), limits=DriveLimits(torque_limit=0.01))
    armed = calls.index("armed")
    assert set(calls[armed + 1 :]) <= set(calls[:armed]) == {"start True", "start False", "pose"}


def test_watchdog_disarms_motors_whose_computer_is_gone():
    rig = Rig(TTK, LINE)
    rig.winches.start_watchdogs(0.1)
    for _ in range(60):
        rig.boards.advance()
    for axis in rig.boards.axes:
        assert (axis["error"], axis["current_state"]) == (WATCHDOG_TIMER_EXPIRED, IDLE)


def test_dry_run_commands_nothing():
    rig = Rig(TTK, LINE)
    result = rig.drive("fk+fl", armed=False)
    assert (result.stop, result.periods) == (None, 600)
    assert np.isnan(result.log["torque_1"]).all()
    for channel in rig.channels.values():
        assert {line[0] for line in channel.written} == {"f", "r"}


def test_winch_that_is_not_ready_is_named():
    rig = Rig(TTK, LINE)
    rig.boards.axes[2]["current_state"] = IDLE
    with pytest.raises(ConnectionError, match=r"winch 3 \(axis 0 at 1\) is in state 1"):
        rig.drive("fk+fl")


@pytest.mark.parametrize(
    ("policy", "keywords", "message"),
    [
        ("fl", {}, "name an estimator, such as ekf"),
        ("fk+fl", {"measurement": "winches+tensions"}, "encoders only"),
    ],
)
def test_drive_that_cannot_start_is_refused(policy, keywords, message):
    with pytest.raises(ValueError, match=message):
        Rig(TTK, LINE).drive(policy, **keywords)


def test_log_identifies_the_winches(tmp_path):
    robot = find_robot("planar")
    Rig(robot, None, payload=1.0).drive("fk+fl").save(tmp_path / "run.csv")
    result = identify(robot, [read_log(tmp_path / "run.csv", robot)], payload=1.0)
    inertia = next(item for item in result.estimates if item.name == "pulley_inertia")
    assert inertia.value == pytest.approx(robot.pulley_inertia[0], rel=0.1)
