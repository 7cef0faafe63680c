"""Smoke test of an installed wheel: tries every environment, policy and command in a minute or two.

Needs only the package. It rejects a checkout, which would hide files that are missing in the wheel.

    python scripts/smoke.py
"""

from __future__ import annotations

import argparse
import subprocess
import sys
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
        sys.exit(f"cablebot_gym is imported from the checkout, {imported}: run this in a venv with the wheel")


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
    """Loads every policy, and checks the DLCC of the paper's law and of a learned policy on the paper's circle."""
    policies = entry_points(group="cablebot_gym.policies")
    assert policies, "the wheel has no policies"
    for policy in policies:
        policy.load()
    print(f"policies: {', '.join(sorted(policy.name for policy in policies))}")
    conditions = {"env_id": "CableBot-Spatial-v0", "resolution": 0.5}
    fl = evaluate_dlcc("fl", **conditions)
    assert fl.payload is not None
    assert 3 < fl.payload < 5, fl
    shipped = evaluate_dlcc("apg-circle", **conditions)
    assert shipped.payload is not None
    assert shipped.payload > 1.4 * fl.payload, shipped
    print(f"{fl}\n{shipped}")


def check_commands() -> None:
    """Checks help texts, one command, and the exit status 2 of an unknown command."""
    from cablebot_gym.cli.app import command_points
    from cablebot_gym.report.page import html

    assert "<canvas" in html("smoke", [], {}), "the wheel has no report page"
    names = list(command_points())
    program = Path(sys.executable).with_name("cablebot")
    for arguments in (("--help",), ("list", "--json"), *((name, "--help") for name in names[:2]), ("unknown",)):
        ran = subprocess.run([program, *arguments], check=False, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        assert ran.returncode == (2 if arguments == ("unknown",) else 0), (arguments, ran.stderr.decode())
    print(f"commands: {', '.join(names)}")


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    reject_checkout()
    names = ("gymnasium", "numpy", "numba", "scipy", "typer", "rich")
    print(f"cablebot_gym {cablebot_gym.__version__} with", ", ".join(f"{name} {version(name)}" for name in names))
    for env_id in cablebot_gym.ENV_IDS:
        check_environment(env_id)
    check_policies()
    check_commands()
