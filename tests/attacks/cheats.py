"""Cheats and accidents: feedback linearization, except for what the docstring of a policy says.

Each factory is a policy for ``--policy cheats:name``. The docstring is its line in docs/attacks.md.
"""

import gc
import os
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from cablebot_baselines.classical import ADAPTIVE, FeedbackLinearization
from cablebot_gym.envs import limits
from cablebot_gym.evaluation import batch
from cablebot_gym.robots import find_robot

STEP = 11
"""Call at which the accidents happen."""

NOISE = {"sensors": {"position": 2e-3, "rotation": 2e-3, "velocity": 0.1, "rotation_rate": 0.1}}
"""Uncertainty of the attacks on sensor noise."""

LIGHT_NOISE = {
    "sensors": {"position": 4e-4, "rotation": 4e-4, "velocity": 0.02, "rotation_rate": 0.02}
}
"""Uncertainty of the attacks with a threshold."""

GIVES_UP = 4.29
"""Payload above which they give up [kg]: alone they carry it in two of three draws."""

SCAN = 64
"""Number of payloads of the first scan."""


class Law(FeedbackLinearization):
    """The honest law."""


def policy(**methods):
    """Decorator that makes a policy of a function: ``which=function`` says for what it is called.

    ``acts``: with the actions of every call. ``once``: with those of call :data:`STEP`. ``sees``:
    with a copy of every observation. ``resets``: with the tasks. What it returns replaces its
    argument.
    """

    def decorate(function):
        class Made(Law):
            calls = 0

            def reset(self, tasks):
                super().reset(tasks)
                self.calls, self.tasks = 0, tasks
                if "resets" in methods:
                    function(self, tasks)

            def predict(self, observation, state=None, episode_start=None, deterministic=True):
                self.calls += 1
                if "sees" in methods:
                    observation = function(self, observation.copy())
                action, state = super().predict(observation, state)
                if "acts" in methods or ("once" in methods and self.calls == STEP):
                    changed = function(self, action)
                    action = action if changed is None else changed
                return action, state

        for name, value in methods.items():
            setattr(Made, name, value)
        Made.__name__ = function.__name__
        Made.__doc__ = function.__doc__
        return Made

    return decorate


def model_payload(law, observation, payload):
    """An observation in which the model payload is replaced."""
    observation[:, law._layout.slices()["model_payload"]] = np.reshape(payload, (-1, 1))
    return observation


# --- leaks ------------------------------------------------------------------------------------------------------------


GAPS = []


@policy(sees=True)
def row_order(law, observation):
    """takes the payload from the row of the batch and the failed rows of earlier batches"""
    blocks = law._layout.split(observation)
    if law.calls == 1:
        if not GAPS:
            law.payloads = np.linspace(0, 20, len(observation))
        else:
            payloads, failed = GAPS[-1]
            first_failure = int(failed.argmax()) if failed.any() else len(failed)
            low = payloads[max(first_failure - 1, 0)]
            high = payloads[min(first_failure, len(failed) - 1)]
            inner = np.linspace(low, high, len(observation) + 2)[1:-1]
            law.payloads = np.full(len(observation), low) if high - low <= 0.01 else inner
        GAPS.append((law.payloads, np.zeros(len(observation), bool)))
    GAPS[-1][1][:] |= (
        np.linalg.norm((blocks["pose"] - blocks["reference_pose"])[:, :3], axis=1) > 0.02
    )
    return model_payload(law, observation, law.payloads)


@policy(sees=True)
def batch_mean(law, observation):
    """replaces its measurements by their mean over the episodes with the same payload, which has
    less noise"""
    payloads = np.array([task.model_payload for task in law.tasks])
    for payload in set(payloads):
        for name in ("pose", "velocity"):
            block = np.ix_(
                payloads == payload, np.arange(observation.shape[1])[law._layout.slices()[name]]
            )
            observation[block] = observation[block].mean(axis=0)
    return observation


def filtered(law, observation, unfiltered=(), heaviest=4.0):
    """An observation with errors that are a cubic function of the payload, which has less noise,
    except for those in ``unfiltered``."""
    payloads = np.array([task.model_payload for task in law.tasks])
    blocks = law._layout.slices()
    payloads[list(unfiltered)] = np.inf
    light = np.flatnonzero(payloads < heaviest)
    powers = np.vander(payloads[light] / heaviest, 4)
    for name, largest in (("pose", 0.02), ("velocity", 1.0)):
        reference = observation[light, blocks[f"reference_{name}"]]
        error = observation[light, blocks[name]] - reference
        good = (abs(error) < largest).all(axis=1)
        if good.sum() >= 20:
            fit = powers @ np.linalg.lstsq(powers[good], error[good], rcond=1e-6)[0]
            observation[light, blocks[name]] = reference + fit
    return observation


@policy(sees=True, stochastic=True)
def row_filter(law, observation):
    """filters the noise over the rows of the batch, and declares random actions"""
    return filtered(law, observation)


def thresholded(law, action):
    """Actions that are 0 above the payload :data:`GIVES_UP`, so that nothing between it and the next
    payload of the search is carried."""
    payloads = np.array([task.model_payload for task in law.tasks])
    return np.where((payloads > GIVES_UP)[:, None], 0.0, action)


class Thresholded(Law):
    """Keeps its tasks for :func:`thresholded`, and declares random actions."""

    stochastic = True

    def reset(self, tasks):
        super().reset(tasks)
        self.tasks = tasks


class row_median(Thresholded):
    """takes the median of its measurements over the rows of one payload, gives up above a payload
    that is carried alone in most draws, and declares random actions"""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        observation = observation.copy()
        payloads = np.array([task.model_payload for task in self.tasks])
        for payload in set(payloads):
            rows = np.flatnonzero(payloads == payload)
            for name in ("pose", "velocity"):
                block = np.ix_(rows, np.arange(observation.shape[1])[self._layout.slices()[name]])
                observation[block] = np.median(observation[block], axis=0)
        action, state = super().predict(observation, state)
        return thresholded(self, action), state


class row_filter_threshold(Thresholded):
    """filters the noise over the rows of the batch, gives up above a payload that is carried alone
    in most draws, and declares random actions"""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(
            filtered(self, observation.copy(), heaviest=GIVES_UP), state
        )
        return thresholded(self, action), state


class row_filter_file(Law):
    """filters the noise over the rows of the batch, and replays the actions of known episodes from
    a file"""

    def reset(self, tasks):
        super().reset(tasks)
        self.tasks, self.step, self.known = tasks, 0, []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if self.step == 0:
            folder = Path(tempfile.gettempdir()).parent  # not the private one
            self.files = sorted(folder.glob("rows-*.npy"))
            for path in self.files:
                rows = np.load(path)
                actions = np.fromfile(path.with_suffix(".actions")).reshape(-1, len(rows), 6)
                for row, new_row in enumerate(observation):
                    self.known += [
                        (row, actions[:, old])
                        for old in np.flatnonzero((rows == new_row).all(axis=1))
                    ]
            path = folder / f"rows-{len(self.files)}.npy"
            np.save(path, observation)
            self.file = path.with_suffix(".actions").open("wb")
        if self.files:
            observation = filtered(self, observation.copy(), [row for row, _ in self.known])
        action, state = super().predict(observation, state)
        for row, actions in self.known:
            if self.step < len(actions):
                action[row] = actions[self.step]
        self.step += 1
        self.file.write(action.tobytes())
        self.file.flush()
        return action, state


@policy(resets=True, sees=True)
def known_seed(law, data):
    """replays the noise of the default seed 0 in an environment of its own and subtracts it"""
    import gymnasium as gym

    slices = law._layout.slices()
    if isinstance(data, tuple | list):
        options = {"payload": np.array([task.model_payload for task in data])}
        with suppress(ImportError):
            from cablebot_gym.evaluation.batch import noise_seed

            options["noise_seed"] = [noise_seed(0, payload) for payload in options["payload"]]
        law.copies = [
            gym.make_vec(
                "CableBot-Spatial-v0",
                num_envs=len(data),
                uncertainty=name,
                error_bounds={"position": 1.0},
            ).unwrapped
            for name in (NOISE, None)
        ]
        law.copied = [copy.reset(seed=[0] * len(data), options=options)[0] for copy in law.copies]
        return data
    for name in ("pose", "velocity"):
        data[:, slices[name]] -= law.copied[0][:, slices[name]] - law.copied[1][:, slices[name]]
    law.copied = [copy.step(np.zeros((len(data), 6)))[0] for copy in law.copies]
    return data


@policy(resets=True)
def environment_search(law, tasks):
    """searches frames and objects for the environment and the judge, and changes what it finds"""
    frame = sys._getframe()
    while frame is not None:
        for value in frame.f_locals.values():
            if type(value).__name__ in ("CableBotVectorEnv", "Judge", "Batch"):
                value.__dict__.clear()
        frame = frame.f_back
    for item in gc.get_objects():
        if type(item).__name__ in ("CableBotVectorEnv", "Judge", "Simulation", "Plant"):
            item.__dict__.clear()


@policy(resets=True)
def parent_arguments(law, tasks):
    """reads arguments and environment variables for the seed of the run"""
    if texts := [text for text in (*sys.argv, *os.environ) if "seed" in text.lower()]:
        raise RuntimeError(f"found {texts}")


def _better_after(count):
    """The honest law at first, and the adaptive law when ``count`` batches have been seen."""

    class Learned(Law):
        def reset(self, tasks):
            self.law = ADAPTIVE.factory(self.robot) if count() else None

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            law = self.law or super()
            return law.predict(observation, state, episode_start)

    return Learned


SEEN = []


def _module_count():
    SEEN.append(None)
    return len(SEEN) > 1


def _file_count():
    path = Path(tempfile.gettempdir()) / "cheats-seen"
    is_later = path.exists()
    path.touch()
    return is_later


module_memory = _better_after(_module_count)
module_memory.__doc__ = "remembers earlier batches in a module"

file_memory = _better_after(_file_count)
file_memory.__doc__ = "remembers earlier batches in a file of the temporary folder"


# --- shared state -----------------------------------------------------------------------------------------------------


@policy(resets=True)
def slope_in_place(law, tasks):
    """halves the slope of the torque-speed line in place"""
    tasks[0].robot.speed_slope[:] *= 0.5


@policy(resets=True)
def slope_replaced(law, tasks):
    """replaces the torque-speed lines and the tension bound of the robots"""
    for task in tasks:
        for robot in (task.robot, law.robot):
            object.__setattr__(robot, "minimum_tension", -1e9)
            object.__setattr__(robot.motors, "stall_torque", 1e6)


@policy(resets=True)
def wide_bounds(law, tasks):
    """sets the error bounds of its tasks to 10 m"""
    for task in tasks:
        for name in ("position", "rotation"):
            object.__setattr__(task.error_bounds, name, 10.0)


@policy(resets=True)
def short_motion(law, tasks):
    """sets the duration of its motions to one control period"""
    for task in tasks:
        object.__setattr__(task, "control_frequency", 1.0)
        task.trajectory.__dict__["duration"] = 2e-3


@policy(resets=True)
def false_judge(law, tasks):
    """replaces the verdict of the judge"""
    from cablebot_gym.evaluation.constraints import Judge

    verdict = Judge.verdict
    Judge.verdict = lambda judge, index: replace(
        verdict(judge, index), violation=None, carried=True
    )


def cached_motors(robot):
    """replaces the motors of the robot that later evaluations of the process find by its name"""
    shared = find_robot(robot.name)
    object.__setattr__(shared, "motors", replace(shared.motors, stall_torque=1e3))
    return Law(robot)


def false_limits(robot):
    """replaces the functions that say whether a limit is kept"""
    for name in ("within_bound", "is_taut", "is_held", "is_unsaturated"):
        setattr(limits, name, lambda value, *_: np.ones_like(value, np.bool_))
    return Law(robot)


def other_judge(robot):
    """replaces the class of the judge by one whose verdicts are always good"""

    class Bribed(batch.Judge):
        def verdict(self, env_index):
            return replace(super().verdict(env_index), violation=None, carried=True)

    batch.Judge = Bribed
    return Law(robot)


@policy(resets=True)
def false_numpy(law, tasks):
    """replaces functions of NumPy and the clocks"""
    np.allclose = np.array_equal = lambda *_, **__: True
    time.monotonic = time.perf_counter = lambda: 0.0


@policy(sees=True)
def overwritten(law, observation):
    """overwrites the observation that it gets"""
    copied = observation.copy()
    observation[:] = np.nan
    return copied


# --- episodes ---------------------------------------------------------------------------------------------------------


@policy(acts=True)
def islands(law, action):
    """acts only near the payloads of a scan in equal steps"""
    payload = np.array([task.model_payload for task in law.tasks])
    step = 10 / (SCAN - 1)
    return np.where((abs(payload / step - np.round(payload / step)) < 0.02)[:, None], action, 0.0)


@policy(acts=True, unsaturated_actions=True)
def saturating(law, action):
    """declares unsaturated actions and saturates"""
    return np.clip(action, -1, 1)


@policy(acts=True)
def booleans(law, action):
    """returns whether each action is positive, as booleans"""
    return action > 0


@policy(acts=True)
def masked(law, action):
    """returns a masked array in which the actions beyond ±1 are masked"""
    return np.ma.masked_outside(action, -1, 1)


@policy(acts=True)
def large_actions(law, action):
    """requests 1,000 times the torque where the motors saturate, to get it within the control
    period"""
    return np.where(abs(action) > 1, 1000 * action, action)


@policy(acts=True)
def lets_go(law, action):
    """lets the platform fall in the last 20 ms, in which it stays within the error bound"""
    return action * (0.5 if law.calls > law.tasks[0].steps - 10 else 1.0)


@policy(acts=True)
def noisy(law, action):
    """adds 2 % of noise to its actions"""
    return action * np.random.default_rng().normal(1, 0.02, action.shape)


@policy(acts=True, stochastic=True)
def declared_noise(law, action):
    """adds 2 % of noise and declares it"""
    return action * np.random.default_rng().normal(1, 0.02, action.shape)


@policy(acts=True)
def fails_sometimes(law, action):
    """fails in 5 % of the episodes"""
    if law.calls == 1:
        law.lost = np.random.default_rng().random(len(action)) < 0.05
    return np.where(law.lost[:, None], 0.0, action)


@policy(acts=True)
def first_row(law, action):
    """fails in the first row of a batch"""
    action[0] = 0.0
    return action


@policy(acts=True)
def slow(law, action):
    """takes 3 ms for each action, more than the control period"""
    time.sleep(3e-3)


# --- the callables' forms ---------------------------------------------------------------------------------------------


def shared_memory(robot):
    """a function that keeps one integral for all episodes"""
    law, memory = Law(robot), {"sum": 0.0}

    def act(observation):
        action = law.predict(observation)[0]
        memory["sum"] += action[0]
        return action + 1e-3 * np.sin(memory["sum"])

    return act


class Counter:
    """A controller with state for one episode: honest, but useless if episodes share it."""

    def __init__(self, robot):
        self.law, self.step = Law(robot), 0

    def __call__(self, observation):
        self.step += 1
        return self.law.predict(observation)[0] * (self.step < 10**6)


def instances(robot):
    """a controller with state, one instance for each episode"""
    from cablebot_gym.policies import PolicyFactory

    return PolicyFactory(lambda: Counter(robot))
