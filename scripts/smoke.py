"""Tries what is installed, a wheel in a venv of its own: every environment, policy and command, in a minute or two.

Needs nothing but the package. Refuses to try a checkout: what is missing in the wheel would be found beside it.

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


def refuse_checkout() -> None:
    """Ends the program where the package is not an installed one."""
    imported = Path(cablebot_gym.__file__).resolve()
    if imported.is_relative_to(CHECKOUT):
        sys.exit(f"imported from the checkout, not from the wheel: {imported}; run this in a venv that has the wheel")


def try_environment(env_id: str) -> None:
    """One environment, checked by Gymnasium, and three of them as one batch."""
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
    print(f"{env_id}: checked, made, reset and stepped, one and three at once")


def try_policies() -> None:
    """Every policy loads; the paper's law carries what the paper's circle allows, and a network more than that."""
    found = entry_points(group="cablebot_gym.policies")
    assert found, "the wheel names no policies"
    for policy in found:
        policy.load()
    print(f"policies: {', '.join(sorted(policy.name for policy in found))}")
    asked = {"env_id": "CableBot-Spatial-v0", "resolution": 0.5}
    fl = evaluate_dlcc("fl", **asked)
    assert fl.payload is not None
    assert 3 < fl.payload < 5, fl
    shipped = evaluate_dlcc("curve", **asked)
    assert shipped.payload is not None
    assert shipped.payload > 1.4 * fl.payload, shipped
    print(f"{fl}\n{shipped}")


def try_commands() -> None:
    """The parser makes helps of every kind of option, one command runs, and one that is none ends with status 2."""
    from cablebot_gym.cli.app import command_points
    from cablebot_gym.report.page import html

    assert "<canvas" in html("smoke", [], {}), "the wheel lacks the report's page"
    names = list(command_points())
    program = Path(sys.executable).with_name("cablebot")
    for arguments in (("--help",), ("list", "--json"), *((name, "--help") for name in names[:2]), ("nosuch",)):
        ran = subprocess.run([program, *arguments], check=False, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        assert ran.returncode == (2 if arguments == ("nosuch",) else 0), (arguments, ran.stderr.decode())
    print(f"commands: {', '.join(names)}")


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    refuse_checkout()
    names = ("gymnasium", "numpy", "numba", "scipy", "typer", "rich")
    print(f"cablebot_gym {cablebot_gym.__version__} with", ", ".join(f"{name} {version(name)}" for name in names))
    for env_id in cablebot_gym.ENV_IDS:
        try_environment(env_id)
    try_policies()
    try_commands()
