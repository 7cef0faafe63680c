"""Policies in processes of their own: fresh processes, deadlines, and no process left. See also
tests/attacks."""

import gc
import itertools
import json
import os
import queue
import re
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from clock import HANG, Clock, wait_until

from cablebot_gym.isolation import IsolatedPolicy, isolated, process
from cablebot_gym.isolation.deadlines import TOTAL, WAITING_FOR_ALL, ProcessorTime
from cablebot_gym.isolation.process import ProcessorTimeError, processor_time_of
from cablebot_gym.isolation.server import ANSWER, LOAD
from cablebot_gym.policies import PolicyError
from cablebot_gym.robots import SPATIAL

MODULE = """
import json, os, subprocess, sys, tempfile, threading, time
from pathlib import Path
import numpy as np

weight = float(Path("weight.txt").read_text()) if Path("weight.txt").exists() else 0.0
calls = []

class Policy:
    stochastic, fallbacks = True, 3
    def __init__(self, robot): self.cables = robot.cables
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        calls.append(None)
        return np.full((len(observation), self.cables), self.value(observation, state)), (state or 0) + 1

class counts(Policy):
    def value(self, observation, state): return 10 * len(calls) + (state or 0) + weight

class leaves(Policy):
    def value(self, observation, state):
        for options in ({}, {"start_new_session": True}, {"start_new_session": True, "env": {}}):
            child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"], **options)
            with open("pids", "a") as file:
                print(child.pid, os.getpid(), tempfile.gettempdir(), file=file)
        return 0.0

class negative(counts):
    fallbacks = -1e308

class hangs(Policy):
    def value(self, observation, state):
        Path("pids").write_text(f"{os.getpid()} {os.getppid()} {tempfile.gettempdir()}")
        while True: pass

class lists(Policy):
    def reset(self, tasks):
        Path("seen").write_text(json.dumps([dict(os.environ), sys.argv, sorted(vars(tasks[0])), os.getcwd()]))

def missing(robot): return Path("missing").read_text()
"""


@pytest.fixture
def spec(tmp_path, monkeypatch):
    """Name of a policy of a module in the working directory, which is found as on the command
    line."""
    (tmp_path / "mine.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    yield lambda name: f"mine:{name}"
    sys.modules.pop("mine", None)


@pytest.fixture(scope="module")
def env():
    env = gym.make_vec("CableBot-Spatial-v0", num_envs=5).unwrapped
    env.reset(seed=0, options={"payload": np.linspace(0, 4, 5)})
    return env


def alive(pid):
    """Whether a process runs; a zombie does not."""
    try:
        return (
            Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]
            != "Z"
        )
    except FileNotFoundError:
        return False


def test_every_batch_gets_a_fresh_process(spec, env):
    Path("weight.txt").write_text("0.5", encoding="ascii")
    observation = np.zeros((5, 3))
    with IsolatedPolicy(spec("counts"), SPATIAL) as policy:
        assert (policy.stochastic, policy.fallbacks) == (True, 0.0)
        for _ in range(2):
            policy.reset(env.tasks)
            action, state = policy.predict(observation)
            assert set(action.flat) == {10.5}
            assert policy.predict(observation, state)[0][0, 0] == 21.5
            assert policy.predict(observation, None)[0][0, 0] == 30.5
        assert policy.predict(observation[0])[0].shape == (6,)
        assert policy.fallbacks == 3
    with IsolatedPolicy(spec("negative"), SPATIAL) as policy:
        policy.predict(observation)
        assert policy.fallbacks == 0


def test_process_gets_tasks_and_few_environment_variables(spec, env, monkeypatch):
    monkeypatch.setenv("MY_SECRET_SEED", "7")
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    with IsolatedPolicy(spec("lists"), SPATIAL) as policy:
        policy.reset(env.tasks)
    variables, arguments, task, folder = json.loads(Path("seen").read_text())
    assert "MY_SECRET_SEED" not in variables
    assert variables["OMP_NUM_THREADS"] == "1"
    assert arguments == ["-c"]
    assert folder == os.getcwd()
    assert not Path(variables["TMPDIR"]).exists()
    assert not any("seed" in name or name == "payload" for name in task)


def test_policy_that_cannot_be_loaded_gives_the_usual_error(spec):
    for name, message in (
        ("lqr", "unknown policy 'lqr'; choose one of"),
        (
            spec("missing"),
            r"policy 'mine:missing': the factory raised FileNotFoundError.*\(mine.py, line",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            IsolatedPolicy(name, SPATIAL)
    with pytest.raises(ValueError, match="deadline must"):
        IsolatedPolicy("fl", SPATIAL, deadline=0)


def test_tasks_that_cannot_be_pickled_are_rejected():
    with (
        IsolatedPolicy("fl", SPATIAL) as policy,
        pytest.raises(ValueError, match="cannot be passed to another process"),
    ):
        policy.reset((lambda: None,))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc")
def test_processes_of_a_policy_end_when_it_is_collected(spec):
    policy = IsolatedPolicy(spec("leaves"), SPATIAL)
    policy.predict(np.zeros((1, 3)))
    lines = [line.split() for line in Path("pids").read_text(encoding="ascii").splitlines()]
    pids = {int(pid) for line in lines for pid in line[:2]}
    folder = Path(lines[0][2])
    assert len(pids) == 4
    assert all(alive(pid) for pid in pids)
    assert folder.is_dir()
    del policy
    gc.collect()
    assert not any(alive(pid) for pid in pids)
    assert not folder.exists()


class Timed:
    """Stands for the process of a policy, whose answers take the given times.

    A computing policy uses a processor, and a sleeping one none.
    """

    def __init__(self, clock, times, *, computes):
        self.clock, self.times = clock, times
        self.processors = 1.0 if computes else 0.0

    def exchange(self, kind, body, largest, seconds, processor):
        needed = next(self.times)
        self.used = self.processors * min(needed, seconds)
        self.clock.sleep(min(needed, seconds))
        if self.used > processor:
            raise ProcessorTimeError
        if needed > seconds:
            raise queue.Empty
        return ANSWER, b"{}" if kind == LOAD else bytes(largest)

    def processor_time(self):
        return self.used

    def end(self):
        pass


def ask_for_batches(count, deadline):
    policy = IsolatedPolicy("any", SPATIAL, deadline=deadline)
    for _ in range(count):
        policy.reset(())
        policy.predict(np.zeros(3))
        policy.predict(np.zeros(3))


START = "loading, reset() and the first call"
COMPUTES_TOO_LONG = f"used more than 10 s of processor time, the deadline of {START}"
LATE = [
    ({"load": 11.0}, True, COMPUTES_TOO_LONG),
    ({"load": 4.0, "reset": 4.0, "first": 3.0}, True, COMPUTES_TOO_LONG),
    ({"second": 1.5}, True, "used more than 1 s of processor time, the deadline of a call"),
    # Each batch has a fresh process, but not a fresh budget.
    (
        {"load": 9.0, "reset": 0.5, "first": 0.4, "second": 0.9},
        True,
        "used more than 60 s of processor time, the deadline of all calls together",
    ),
    ({"load": 101.0}, False, f"did not answer within 100 s, 10 times the deadline of {START}"),
    ({"second": 10.1}, False, "did not answer within 10 s, 10 times the deadline of a call"),
    (
        {"load": 27.0, "second": 2.9},
        False,
        "did not answer within 120 s, 2 times the deadline of all calls together",
    ),
]


@pytest.mark.parametrize(("times", "computes", "message"), LATE)
def test_policy_that_computes_or_sleeps_for_too_long_raises(monkeypatch, times, computes, message):
    clock = Clock()
    needed = itertools.cycle(
        [times.get(call, 0.0) for call in ("load", "reset", "first", "second")]
    )
    monkeypatch.setattr(isolated, "time", clock)
    monkeypatch.setattr(
        isolated, "PolicyProcess", lambda names: Timed(clock, needed, computes=computes)
    )
    with pytest.raises(PolicyError, match=re.escape(f"it {message}")):
        ask_for_batches(100, deadline=1.0)
    assert clock.now <= WAITING_FOR_ALL * TOTAL


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_processor_time_of_ended_and_running_children_counts():
    burn = "import time\nwhile time.process_time() < 0.3: pass\n"
    before = processor_time_of(os.getpid())
    subprocess.run([sys.executable, "-c", burn], check=True)
    running = subprocess.Popen(
        [sys.executable, "-c", burn + "print(flush=True); input()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    running.stdout.readline()
    assert processor_time_of(os.getpid()) - before >= 0.55
    running.communicate(b"\n")


@pytest.mark.parametrize("is_endless", [False, True])
def test_processor_time_is_sampled_while_an_answer_is_awaited(monkeypatch, is_endless):
    """Between samples short calls cost nothing; a long one is stopped before it answers."""
    clock = Clock()
    waits = []

    class Replies:
        def get(self, timeout):
            clock.sleep(timeout if is_endless else 0.1)
            waits.append(clock.now)
            if is_endless:
                raise queue.Empty
            return ANSWER, b""

    samples = []

    def sampled(number):
        samples.append(clock.now)
        return clock.now

    monkeypatch.setattr(process, "time", clock)
    monkeypatch.setattr(process, "processor_time_of", sampled)
    awaited = SimpleNamespace(
        _replies=Replies(), _processor_time=ProcessorTime(), _popen=SimpleNamespace(pid=1)
    )
    reply = partial(process.PolicyProcess._reply, awaited, 100.0, 2.0)
    if is_endless:
        with pytest.raises(ProcessorTimeError):
            reply()
        assert clock.now == 2.0 + process.SAMPLING
        return
    for _ in range(20):
        assert reply() == (ANSWER, b"")
        awaited._processor_time.report()
    assert len(samples) == 4


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc")
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL], ids=lambda sent: sent.name)
def test_policy_that_hangs_ends_with_the_evaluation(spec, sent):
    code = "import sys; sys.path[:0] = ['']; import numpy as np\n" + (
        "from cablebot_gym.isolation import IsolatedPolicy\nfrom cablebot_gym.robots import SPATIAL\n"
        "IsolatedPolicy('mine:hangs', SPATIAL).predict(np.zeros((1, 3)))"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    wait_until(
        lambda: (
            parent.poll() is not None or (Path("pids").exists() and Path("pids").stat().st_size > 0)
        )
    )
    pid, seen, folder = Path("pids").read_text(encoding="ascii").split()
    assert int(seen) == parent.pid
    parent.send_signal(sent)
    parent.wait(HANG)
    wait_until(lambda: not alive(int(pid)))
    assert not Path(folder).exists()
