"""Twelve attacks on an evaluation: feedback linearization, except for what the docstring of a policy
says. Each factory is a policy for ``--policy cheats:name``."""

import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from cablebot_baselines.laws import OBSERVING, FeedbackLinearization
from cablebot_gym.envs import limits
from cablebot_gym.evaluation import batch
from cablebot_gym.evaluation.batch import noise_seed

STEP = 11
"""Call at which a process ends, hangs, or leaves others behind."""

NOISE = {"sensors": {"position": 2e-3, "rotation": 2e-3, "velocity": 0.1, "rotation_rate": 0.1}}
"""Uncertainty of the attacks on sensor noise. The honest law fails unloaded under it."""

STEP_OF_SCAN = 10.0 / 63
"""Distance between payloads of a scan in equal steps [kg]."""


class Honest(FeedbackLinearization):
    """The honest law."""

    calls = 0

    def reset(self, tasks):
        super().reset(tasks)
        self.calls = 0
        self.tasks = tasks

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.calls += 1
        return super().predict(self.sees(observation.copy()), state)

    def sees(self, observation):
        """The observation that the law gets."""
        return observation


# --- leaks between episodes ------------------------------------------------------------------------


class batch_mean(Honest):
    """replaces its measurements by their mean over the episodes of its batch with the same payload,
    which has less noise"""

    def sees(self, observation):
        payloads = np.array([task.model_payload for task in self.tasks])
        columns = np.arange(observation.shape[1])
        for payload in set(payloads):
            for name in ("pose", "velocity"):
                block = np.ix_(payloads == payload, columns[self._layout.slices()[name]])
                observation[block] = observation[block].mean(axis=0)
        return observation


class known_seed(Honest):
    """replays the noise of the default seed 0 in an environment of its own and subtracts it"""

    def reset(self, tasks):
        import gymnasium as gym

        super().reset(tasks)
        payloads = np.array([task.model_payload for task in tasks])
        options = {"payload": payloads, "noise_seed": [noise_seed(0, one) for one in payloads]}
        self.copies = []
        for uncertainty in (NOISE, None):
            env = gym.make_vec(
                "CableBot-Spatial-v0",
                num_envs=len(tasks),
                uncertainty=uncertainty,
                error_bounds={"position": 1.0},
            ).unwrapped
            self.copies.append(env)
        seeds = [0] * len(tasks)
        self.copied = [env.reset(seed=seeds, options=options)[0] for env in self.copies]

    def sees(self, observation):
        for name in ("pose", "velocity"):
            block = self._layout.slices()[name]
            observation[:, block] -= self.copied[0][:, block] - self.copied[1][:, block]
        self.copied = [env.step(np.zeros((len(observation), 6)))[0] for env in self.copies]
        return observation


def better_after(has_seen_batch):
    """The honest law at first, and a better law when a batch has been seen."""

    class Remembers(Honest):
        def reset(self, tasks):
            self.law = OBSERVING.factory(self.robot) if has_seen_batch() else None
            super().reset(tasks)

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            law = self.law or super()
            return law.predict(observation, state, episode_start)

    return Remembers


SEEN = []


def _in_module():
    SEEN.append(None)
    return len(SEEN) > 1


def _in_file():
    seen = False
    for folder in (Path.home(), Path.cwd(), Path(tempfile.gettempdir())):
        path = folder / "seen"
        seen |= path.exists()
        path.touch()
    return seen


module_memory = better_after(_in_module)
module_memory.__doc__ = "remembers earlier batches in a module"

file_memory = better_after(_in_file)
file_memory.__doc__ = "remembers earlier batches in its home, working folder and temporary files"


# --- the judge ------------------------------------------------------------------------------------


class wide_bounds(Honest):
    """sets the error bounds of its tasks to 10 m, and replaces the motors and the least tension of the
    robots"""

    def reset(self, tasks):
        for task in tasks:
            for name in ("position", "rotation"):
                object.__setattr__(task.error_bounds, name, 10.0)
            for robot in (task.robot, self.robot):
                object.__setattr__(robot, "minimum_tension", -1e9)
                object.__setattr__(robot.motors, "stall_torque", 1e6)
        super().reset(tasks)


def bribed_judge(robot):
    """replaces the functions that say whether a limit is kept, and the class of the judge"""
    for name in ("within_bound", "is_taut", "is_held", "is_unsaturated"):
        setattr(limits, name, lambda value, *_: np.ones_like(value, np.bool_))

    class Bribed(batch.Judge):
        def verdict(self, env_index):
            return replace(super().verdict(env_index), violation=None, carried=True)

    batch.Judge = Bribed
    return Honest(robot)


class replaced_code(Honest):
    """replaces all files of compiled code that its process can find"""

    def reset(self, tasks):
        from cablebot_gym.physics.compiling.code_cache import code_folders

        for folder in code_folders():
            for path in folder.glob("*.nbc"):
                with suppress(OSError):
                    path.write_bytes(b"replaced")
        super().reset(tasks)


# --- episodes -------------------------------------------------------------------------------------


class islands(Honest):
    """acts only near the payloads of a scan in equal steps"""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state)
        steps = np.array([task.model_payload for task in self.tasks]) / STEP_OF_SCAN
        return np.where((abs(steps - np.round(steps)) < 0.02)[:, None], action, 0.0), state


class noisy(Honest):
    """adds 2 % of noise to its actions"""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state)
        return action * np.random.default_rng().normal(1, 0.02, action.shape), state


# --- processes ------------------------------------------------------------------------------------


class hangs(Honest):
    """never returns from a control step"""

    def sees(self, observation):
        while self.calls == STEP:
            pass
        return observation


class daemon(Honest):
    """leaves a process in a session of its own, without environment variables, behind"""

    def sees(self, observation):
        if self.calls == STEP:
            code = f"import time; time.sleep({SLEEP})"
            subprocess.Popen([sys.executable, "-c", code], env={}, start_new_session=True)
        return observation


SLEEP = 613
"""Time for which a process sleeps that is left behind [s]; tells it from others."""


class ends(Honest):
    """ends its process with status 0 in a control step"""

    def sees(self, observation):
        if self.calls == STEP:
            os._exit(0)
        return observation
