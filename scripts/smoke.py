"""Smoke test of an installed wheel: tries every environment, policy and command in a minute or two.

Needs only the package. It rejects a checkout, which would hide files that are missing in the wheel.
With `--extras` it instead trains, draws figures and runs a suite of the benchmark, which needs the
extras sb3 and plot.

    python scripts/smoke.py [--extras]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import warnings
from importlib.metadata import entry_points, version
from pathlib import Path

import gymnasium as gym
import numpy as np
from gymnasium.utils.env_checker import check_env

import cablebot_gym
from cablebot_gym.evaluation import evaluate_dlcc

CHECKOUT = Path(__file__).resolve().parents[1]


def reject_checkout() -> None:
    """Exits if the package is imported from the checkout."""
    imported = Path(cablebot_gym.__file__).resolve()
    if imported.is_relative_to(CHECKOUT):
        sys.exit(
            f"cablebot_gym is imported from the checkout, {imported}: run this in a venv with the wheel"
        )


def check_environment(env_id: str) -> None:
    """Checks one environment with Gymnasium, and steps three of them as one batch."""
    env = gym.make(env_id)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)
    env.close()
    envs = gym.make_vec(env_id, num_envs=3)
    envs.reset(seed=0)
    observations, rewards, *_ = envs.step(np.zeros(envs.action_space.shape, np.float32))
    assert observations.shape[0] == 3
    assert np.all(np.isfinite(rewards))
    envs.close()
    print(f"{env_id}: ok, single and vector")


def check_policies() -> None:
    """Loads every policy, and checks the DLCC of the paper's law on the paper's circle."""
    policies = entry_points(group="cablebot_gym.policies")
    assert policies, "the wheel has no policies"
    for policy in policies:
        policy.load()
    print(f"policies: {', '.join(sorted(policy.name for policy in policies))}")
    conditions = {"env_id": "CableBot-Spatial-v0", "resolution": 0.5}
    fl = evaluate_dlcc("fl", **conditions)
    assert fl.payload is not None
    assert 3 < fl.payload < 5, fl
    print(fl)


def check_commands() -> None:
    """Checks help texts, one command, and the exit status 2 of an unknown command."""
    from cablebot_gym.cli.app import command_points
    from cablebot_gym.report.page import html

    assert "<canvas" in html("smoke", [], {}), "the wheel has no report page"
    names = list(command_points())
    program = Path(sys.executable).with_name("cablebot")
    for arguments in (
        ("--help",),
        ("list",),
        *((name, "--help") for name in names[:2]),
        ("unknown",),
    ):
        ran = subprocess.run(
            [program, *arguments], check=False, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        expected = 0
        if arguments == ("unknown",):
            expected = 2
        assert ran.returncode == expected, (arguments, ran.stderr.decode())
    print(f"commands: {', '.join(names)}")


def check_extras() -> None:
    """Trains a policy, evaluates it with figures, and runs a suite of the benchmark."""
    program = Path(sys.executable).with_name("cablebot")
    with tempfile.TemporaryDirectory() as folder:
        for arguments in (
            "train CableBot-Planar-v0 --timesteps 1 --out run",
            "dlcc CableBot-Planar-v0 --policy run/policy.zip --resolution 0.5 --out figures",
            "benchmark --suite smoke --policies fl,observing --out benchmark",
        ):
            subprocess.run(
                [program, *arguments.split()], check=True, cwd=folder, stdout=subprocess.DEVNULL
            )
            print(f"cablebot {arguments}: ok")
        assert list(Path(folder, "figures").rglob("*.png")) or list(
            Path(folder, "figures").rglob("*.svg")
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--extras", action="store_true", help="train, draw and benchmark instead")
    arguments = parser.parse_args()
    reject_checkout()
    names = ["gymnasium", "numpy", "numba", "scipy", "typer", "rich"]
    if arguments.extras:
        names += ["stable-baselines3", "matplotlib", "torch"]
    print(
        f"cablebot_gym {cablebot_gym.__version__} with",
        ", ".join(f"{name} {version(name)}" for name in names),
    )
    if arguments.extras:
        check_extras()
    else:
        for env_id in cablebot_gym.ENV_IDS:
            check_environment(env_id)
        check_policies()
        check_commands()
