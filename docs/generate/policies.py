"""A page for each installed policy: docstrings, settings and payloads."""

from __future__ import annotations

import dataclasses
import inspect
import pprint
import re
from collections.abc import Callable
from typing import Any, get_type_hints

import numpy as np

from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.shipped import SHIPPED
from cablebot_gym.envs import ENV_ROBOTS
from cablebot_gym.policies import PolicyEntry, policy_entries
from cablebot_gym.robots import find_robot
from generate.errata import mentioned
from generate.folder import Folder, number, table
from generate.results import env_link, policy_link, policy_rows

EXTRAS = {"optimal": "optimal", "learned": None, "classical": None}
"""Extra that each kind of policy needs."""


def write(folder: Folder) -> None:
    """Writes all pages and the table that lists them."""
    rows = [["policy", "kind", "made for", "summary"]]
    for entry in policy_entries().values():
        made_for = ", ".join(map(env_link, entry.env_ids))
        rows.append([policy_link(entry.name), entry.kind, made_for, entry.summary])
        folder.write(f"policies/{entry.name}.md", page(entry))
    folder.write("policies.inc", table(rows))


def page(entry: PolicyEntry) -> str:
    """The text of a policy's page."""
    documented = [policy_class(entry), *outer_loops(entry)]
    text = f"# `{entry.name}`\n\n{entry.summary[0].upper() + entry.summary[1:]}.\n\n"
    text += table(
        [
            ["", ""],
            ["kind", entry.kind],
            ["made for", ", ".join(map(env_link, entry.env_ids))],
            ["needs", f"`pip install 'cablebot-gym[{EXTRAS[entry.kind]}]'`" if EXTRAS[entry.kind] else "no extra"],
            ["paper criterion", paper_criterion(entry)],
        ]
    )
    commands = "".join(f"cablebot dlcc {env_id} --policy {entry.name}\n" for env_id in entry.env_ids)
    text += f"\n```sh\n{commands}```\n\n## Payload\n\n"
    text += "Payload [kg] and its fraction of the best known payload, task criterion unless noted, from the "
    text += f"[leaderboard](/leaderboard.md).\n\n{table(policy_rows(entry.name))}\n"
    if entry.name in SHIPPED:
        text += f"## How it was trained\n\n{_training(entry)}\n\n## How it works\n\n"
    else:
        text += f"## Settings\n\n{settings(entry)}\n## How it works\n\n"
    module = inspect.getdoc(inspect.getmodule(documented[0]))
    errata = mentioned("\n".join([entry.summary, str(module), *(str(inspect.getdoc(one)) for one in documented)]))
    if errata:
        text += f"Misprints of the paper's equations below: {errata}.\n\n"
    for one in documented:
        text += f"```{{eval-rst}}\n.. autoclass:: {one.__module__}.{one.__qualname__}\n   :no-index:\n```\n\n"
    return text


def policy_class(entry: PolicyEntry) -> type:
    """The class of the policies that an entry makes, found without making one."""
    if isinstance(entry.factory, type):
        return entry.factory
    if entry.name in SHIPPED:
        return LearnedPolicy
    made: type = get_type_hints(entry.factory)["return"]
    return made


def outer_loops(entry: PolicyEntry) -> list[type]:
    """The classes of a law's outer loops."""
    return [] if entry.kind != "classical" else list({type(outer): 1 for outer in _outers(entry).values()})


def paper_criterion(entry: PolicyEntry) -> str:
    """Where it declares that its commands are not clipped; of laws, which alone can, and need no extra to be made."""
    if entry.kind == "classical":
        where = [env_id for env_id in entry.env_ids if getattr(_made(entry, env_id), "unsaturated_actions", False)]
        if where:
            return "applies" if len(where) == len(entry.env_ids) else f"applies on {', '.join(map(env_link, where))}"
    return "does not apply: the policy saturates its own actions"


def settings(entry: PolicyEntry) -> str:
    """Gains by environment, and the factory with its constants."""
    text = ""
    rows = [[env_id, *_values(outer)] for env_id, outer in _outers(entry).items()] if entry.kind == "classical" else []
    if rows:
        names = [_symbol(field.name) for field in dataclasses.fields(next(iter(_outers(entry).values())))]
        text += f"Outer loop by environment:\n\n{table([['id', *names], *rows])}\n"
    source = factory_source(entry.factory)
    if source:
        return f"{text}Factory, called with the nominal robot:\n\n```python\n{source}```\n"
    default = f"`{policy_class(entry).__name__}(robot)`, with the defaults of the arguments below.\n"
    return f"{text}Factory, called with the nominal robot: {default}"


def factory_source(factory: Callable[..., Any]) -> str:
    """The code of a factory function, after its constants."""
    if not inspect.isfunction(factory):
        return ""
    source = inspect.getsource(factory)
    names = dict.fromkeys(re.findall(r"\b[A-Z][A-Z_]+\b", source))
    constants = {name: factory.__globals__[name] for name in names if name in factory.__globals__}
    return "".join(f"{name} = {pprint.pformat(value, width=100)}\n\n" for name, value in constants.items()) + source


def _made(entry: PolicyEntry, env_id: str) -> Any:
    return entry.factory(find_robot(ENV_ROBOTS[env_id]))


def _outers(entry: PolicyEntry) -> dict[str, Any]:
    """The outer loop by environment."""
    found = {}
    for env_id in entry.env_ids:
        policy = _made(entry, env_id)
        outer = getattr(getattr(policy, "law", policy), "outer", None)
        if outer is not None:
            found[env_id] = outer
    return found


def _values(outer: Any) -> list[str]:
    values = (getattr(outer, field.name) for field in dataclasses.fields(outer))
    return [", ".join(number(float(one)) for one in np.atleast_1d(value)) for value in values]


def _symbol(field: str) -> str:
    return {"gains": "K_P [1/s²], K_D [1/s]", "boundary_layer": "ε", "zeta": "ζ", "phi": "φ", "q": "Q"}.get(
        field, field
    )


def _training(entry: PolicyEntry) -> str:
    shipped = SHIPPED[entry.name]
    config = f" --config {shipped.config}" if shipped.config else ""
    command = "".join(
        f"cablebot train {env_id} --algo {shipped.algorithm}{config} --out runs/{entry.name}\n"
        for env_id in shipped.env_ids
    )
    card = f"Its card has every seed, the learning curves, the held-out motions and the versions: [{entry.name}]"
    return f"{card}(/learned.md#{entry.name}). To train one like it:\n\n```sh\n{command}```"
