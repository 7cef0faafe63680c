"""Records a Minari dataset of an expert with several payloads, describes it, and replays it.

The replay gives the same observations. The expert is the learned policy `ppo-circle`, which ships
with the package. All files are written below FOLDER. Beside the data, `DATASHEET.md` describes the
dataset for people and `croissant.json` for machines. Needs the extra minari: pip install
'cablebot-gym[minari]'.

Run it: python examples/minari_dataset.py [FOLDER]
"""

import os
import sys
from datetime import date
from pathlib import Path

import gymnasium as gym
import minari
import numpy as np

import cablebot_gym
from cablebot_gym import load_policy
from cablebot_gym.datasets import describe_dataset
from cablebot_gym.robots import SPATIAL

ENV_ID = "CableBot-Spatial-v0"
NAME = "cablebot-spatial/ppo-circle-v0"
PAYLOADS = np.linspace(0, 7, 8)  # [kg]


def record() -> None:
    """Records one episode for each payload, with the payload known."""
    env = minari.DataCollector(gym.make(ENV_ID))
    expert = load_policy("ppo-circle", SPATIAL)
    for seed, payload in enumerate(PAYLOADS):
        observation, _ = env.reset(seed=seed, options={"payload": float(payload)})
        expert.reset([env.unwrapped.task])
        state, ended = None, False
        while not ended:
            action, state = expert.predict(observation, state)
            # the dataset holds exactly the actions of the episode
            action = action.astype(env.action_space.dtype)
            observation, _, terminated, truncated, _ = env.step(action)
            ended = terminated or truncated
    env.create_dataset(
        NAME,
        eval_env=ENV_ID,
        algorithm_name="ppo-circle",
        author="you",
        author_email="you@example.org",
        code_permalink="https://example.org/your/code",
        description=f"ppo-circle on circle-spatial, {PAYLOADS[0]:g} to {PAYLOADS[-1]:g} kg (known)",
        requirements=[f"cablebot-gym=={cablebot_gym.__version__}"],
    )
    env.close()


def replay(dataset: minari.MinariDataset, index: int) -> float:
    """Replays the actions of an episode and returns the largest difference of the observations."""
    episode = dataset[index]
    (metadata,) = dataset.storage.get_episode_metadata([index])
    env = dataset.recover_environment()
    observations = [env.reset(seed=metadata["seed"], options=metadata["options"])[0]]
    observations += [env.step(action)[0] for action in episode.actions]
    return float(np.abs(np.array(observations) - episode.observations).max())


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "datasets")
    os.environ["MINARI_DATASETS_PATH"] = str(folder.resolve())
    record()
    dataset = minari.load_dataset(NAME)
    describe_dataset(
        dataset,
        license="https://creativecommons.org/licenses/by/4.0/",
        purpose="An example of an expert with several payloads, to learn from offline.",
        published=date.today(),
    )
    print(f"{dataset.total_episodes} episodes of {dataset.total_steps} steps in {folder / NAME}")
    for episode, payload in zip(dataset, PAYLOADS, strict=True):
        print(f"{payload:g} kg: {len(episode)} steps, return {episode.rewards.sum():.1f}")
    print(f"replayed: observations differ by at most {replay(dataset, 3)}")
