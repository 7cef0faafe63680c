"""``cablebot list``."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer
from rich.console import Console


def list_(as_json: Annotated[bool, typer.Option("--json", help="Print only JSON.")] = False) -> None:
    """Environments, trajectories, uncertainties and installed policies.

    Example: cablebot list --json
    """
    from cablebot_gym.envs import ENV_IDS
    from cablebot_gym.policies import policy_entries
    from cablebot_gym.trajectories import trajectory_names
    from cablebot_gym.uncertainty import PARAMETERS, UNCERTAINTIES

    entries = policy_entries().values()
    if as_json:
        policies = [{"name": item.name, "kind": item.kind, "env_ids": list(item.env_ids)} for item in entries]
        data = {
            "env_ids": list(ENV_IDS),
            "trajectories": trajectory_names(),
            "uncertainties": list(UNCERTAINTIES),
            "uncertain_parameters": list(PARAMETERS),
            "policies": policies,
        }
        print(json.dumps(data, indent=2))
        return
    console = Console(width=None if sys.stdout.isatty() else 140, highlight=False, markup=False, emoji=False)
    console.print("environments: " + ", ".join(ENV_IDS))
    console.print("trajectories: " + ", ".join(trajectory_names()))
    console.print("uncertainties: " + ", ".join(UNCERTAINTIES))
    console.print("uncertain parameters: " + ", ".join(PARAMETERS))
    console.print("policies:")
    for item in entries:
        console.print(f"  {item.name} ({item.kind}): {item.summary}; for {', '.join(item.env_ids)}")
