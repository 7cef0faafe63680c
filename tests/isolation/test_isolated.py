"""Policies in processes of their own: fresh processes, deadlines, and no process left. See also
tests/attacks."""

import json
import os
import queue
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from clock import HANG, Clock, wait_until

from cablebot_gym.isolation import IsolatedPolicy, process
from cablebot_gym.isolation.process import DeadlineError, PolicyProcess, processor_time
from cablebot_gym.isolation.server import ANSWER
from cablebot_gym.robots import SPATIAL

MODULE = """
import json, os, subprocess, sys, tempfile, threading, time
from pathlib import Path
import numpy as np

weight = float(Path(__file__).with_name("weight.txt").read_text())
here = Path(__file__).parent
calls = []

class Policy:
    fallbacks = 3
    def __init__(self, robot): self.cables = robot.cables
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        calls.append(None)
        return np.full((len(observation), self.cables), self.value(observation, state)), (state or 0) + 1

class counts(Policy):
    def value(self, observation, state): return 10 * len(calls) + (state or 0) + weight

class negative(counts):
    fallbacks = -1e308

class hangs(Policy):
    def value(self, observation, state):
        (here / "pids").write_text(f"{os.getpid()} {os.getppid()} {tempfile.gettempdir()}")
        while True: pass

class lists(Policy):
    def reset(self, tasks):
        places = [Path.home(), Path.cwd(), Path(tempfile.gettempdir())]
        empty = [not any(path.iterdir()) for path in places]
        for path in places: (path / "left").touch()
        data = [dict(os.environ), sys.argv, sorted(vars(tasks[0])), empty, list(map(str, places))]
        (here / "seen").write_text(json.dumps(data))

class draws(Policy):
    stochastic, generator = True, np.random.default_rng()
    def value(self, observation, state): return self.generator.random()

class threads(counts):
    def __init__(self, robot):
        super().__init__(robot)
        threading.Thread(target=threading.Event().wait, daemon=True).start()

def missing(robot): return Path("missing").read_text()
"""


@pytest.fixture
def spec(tmp_path, monkeypatch):
    """Name of a policy of a module in the working directory, which is found as on the command
    line."""
    (tmp_path / "mine.py").write_text(MODULE)
    (tmp_path / "weight.txt").write_text("0.5")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [os.path.relpath(tmp_path), *sys.path])
    yield lambda name: f"mine:{name}"
    sys.modules.pop("mine", None)


BUBBLEWRAP = pytest.mark.skipif(not process.has_bubblewrap(), reason="bubblewrap is missing")


@pytest.fixture(params=[False, pytest.param(True, marks=BUBBLEWRAP)], ids=["bare", "bubblewrap"])
def behind_bubblewrap(request, monkeypatch):
    """Whether the processes of policies are behind bubblewrap."""
    monkeypatch.setattr(process, "has_bubblewrap", lambda: request.param)
    return request.param


@pytest.fixture
def bare(monkeypatch):
    """The processes of policies are not behind bubblewrap, and can write into the folder of their
    module."""
    monkeypatch.setattr(process, "has_bubblewrap", lambda: False)


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


@pytest.mark.landing
@pytest.mark.parametrize("name", ["counts", "threads"])
def test_every_batch_gets_a_fresh_process(spec, env, behind_bubblewrap, name):
    """Also a policy with threads, whose process is not forked."""
    observation = np.zeros((5, 3))
    with IsolatedPolicy(spec(name), SPATIAL) as policy:
        assert policy.bubblewrap == behind_bubblewrap
        assert policy.fallbacks == 0.0
        for _ in range(2):
            policy.reset(env.tasks)
            action, state = policy.predict(observation)
            assert set(action.flat) == {10.5}
            assert policy.predict(observation, state)[0][0, 0] == 21.5
            assert policy.predict(observation, None)[0][0, 0] == 30.5
        assert policy.predict(observation[0])[0].shape == (6,)
        assert policy.fallbacks == 3


def test_stochastic_policy_draws_other_numbers_in_each_batch(spec, env):
    """Forks of one process would repeat them."""
    drawn = set()
    with IsolatedPolicy(spec("draws"), SPATIAL) as policy:
        assert policy.stochastic
        for _ in range(2):
            policy.reset(env.tasks)
            drawn.add(policy.predict(np.zeros((5, 3)))[0][0, 0])
    assert len(drawn) == 2


def test_invalid_number_of_fallbacks_is_dropped(spec):
    with IsolatedPolicy(spec("negative"), SPATIAL) as policy:
        policy.predict(np.zeros((5, 3)))
        assert policy.fallbacks == 0


@pytest.mark.usefixtures("bare")
def test_process_gets_tasks_few_variables_and_empty_folders(spec, env, monkeypatch):
    monkeypatch.setenv("MY_SECRET_SEED", "7")
    monkeypatch.setenv("NUMBA_DEBUG_CACHE", "0")
    with IsolatedPolicy(spec("lists"), SPATIAL) as policy:
        for _ in range(2):  # what a batch leaves is not there in the next
            policy.reset(env.tasks)
            variables, arguments, task, is_empty, folders = json.loads(Path("seen").read_text())
            assert is_empty == [True] * 3
    assert "MY_SECRET_SEED" not in variables
    assert variables["NUMBA_DEBUG_CACHE"] == "0"
    assert arguments == ["-c"]
    assert not any("seed" in name or name == "payload" for name in task)
    assert str(Path.home()) not in folders
    assert os.getcwd() not in folders
    assert not any(Path(folder).exists() for folder in folders)


@BUBBLEWRAP
def test_process_behind_bubblewrap_writes_no_file_and_has_no_network(spec, env):
    Path("writes.py").write_text(
        "import socket\nfrom pathlib import Path\nimport numpy as np\n"
        "class Writes:\n"
        "    def reset(self, tasks):\n"
        f"        try: Path({os.getcwd()!r}, 'left').touch()\n"
        "        except OSError: pass\n"
        "        assert [name for _, name in socket.if_nameindex()] == ['lo']\n"
        "    def predict(self, observation, *_, **__):\n"
        "        return np.zeros((len(observation), 6)), None\n"
    )
    with IsolatedPolicy("writes.py:Writes", SPATIAL) as policy:
        policy.reset(env.tasks)
    assert not Path("left").exists()


def test_policy_that_cannot_be_loaded_gives_the_usual_error(spec):
    for name, message in (
        ("lqr", "unknown policy 'lqr'; choose one of"),
        (spec("missing"), r"the factory raised FileNotFoundError.*\(mine.py, line"),
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


@pytest.mark.landing
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_processor_time_of_ended_and_running_children_counts():
    burn = "import time\nwhile time.process_time() < 0.3: pass\n"
    before = processor_time(os.getpid())
    subprocess.run([sys.executable, "-c", burn], check=True)
    running = subprocess.Popen(
        [sys.executable, "-c", burn + "print(flush=True); input()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    running.stdout.readline()
    assert processor_time(os.getpid()) - before >= 0.55
    running.communicate(b"\n")


class Replies:
    """Stands for the replies of a process that answers after a time [s]."""

    def __init__(self, clock, needed):
        self.clock, self.needed = clock, needed

    def get(self, timeout):
        if self.clock.now + timeout < self.needed:
            self.clock.sleep(timeout)
            raise queue.Empty
        return ANSWER, b""


@pytest.mark.parametrize(
    ("processors", "needed", "message"),
    [
        (4.0, 1.4, None),
        (4.0, 3.0, "it used more than 5 s of processor time"),
        (0.0, 49.0, None),
        (0.0, 60.0, "it did not answer within 50 s"),
    ],
)
def test_deadline_ends_policies_that_compute_or_sleep(monkeypatch, processors, needed, message):
    """Four processes at once use their time together."""
    clock = Clock()
    monkeypatch.setattr(process, "time", clock)
    monkeypatch.setattr(process, "processor_time", lambda number: 7.0 + processors * clock.now)
    awaited = SimpleNamespace(_replies=Replies(clock, needed), _popen=SimpleNamespace(pid=1))
    if message is None:
        assert PolicyProcess._reply(awaited, 5.0) == (ANSWER, b"")
        return
    with pytest.raises(DeadlineError, match=message):
        PolicyProcess._reply(awaited, 5.0)


@pytest.mark.landing
@pytest.mark.usefixtures("bare")
@pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc")
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL], ids=lambda sent: sent.name)
def test_policy_that_hangs_ends_with_the_evaluation(spec, sent):
    code = "import sys; sys.path[:0] = ['']; import numpy as np\n" + (
        "from cablebot_gym.isolation import IsolatedPolicy, process\n"
        "from cablebot_gym.robots import SPATIAL\n"
        "process.has_bubblewrap = lambda: False\n"
        "IsolatedPolicy('mine:hangs', SPATIAL).predict(np.zeros((1, 3)))"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    wait_until(
        lambda: (
            parent.poll() is not None or (Path("pids").exists() and Path("pids").stat().st_size > 0)
        )
    )
    pid, server, _ = Path("pids").read_text(encoding="ascii").split()
    parent.send_signal(sent)
    parent.wait(HANG)
    wait_until(lambda: not alive(int(pid)) and not alive(int(server)))
