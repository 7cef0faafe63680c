"""A page for each installed policy: docstrings and payloads."""

from __future__ import annotations

from typing import get_args, get_type_hints

from cablebot_gym.benchmark.tables import column_titles, entry_text, markdown_table, timing_text
from cablebot_gym.policies import PolicyEntry, policy_entries
from cablebot_gym.policies.options import option_parameters
from generate.pages import Pages, all_leaderboards


def write(pages: Pages) -> None:
    """Writes all pages."""
    for entry in policy_entries().values():
        pages.write(f"policies/{entry.name}.md", page(entry))


def page(entry: PolicyEntry) -> str:
    """The text of a policy's page."""
    policy = policy_class(entry)
    needs = "no extra"
    if entry.kind == "optimal":
        needs = "`pip install 'cablebot-gym[optimal]'`"
    kind: str = entry.kind
    if entry.known_robot:
        kind += ", known robot"
    options = ", ".join(f"`{name}`" for name in option_parameters(entry)) or "none"
    commands = ""
    for env_id in entry.env_ids:
        commands += f"cablebot dlcc {env_id} --policy {entry.name}\n"
    text = f"# `{entry.name}`\n\n{entry.summary[0].upper()}{entry.summary[1:]}.\n\n"
    text += markdown_table(
        [
            ["kind", "made for", "options", "needs"],
            [kind, ", ".join(f"`{env_id}`" for env_id in entry.env_ids), options, needs],
        ]
    )
    text += f"\n```sh\n{commands}```\n\n## Payload\n\nPayload [kg] and its fraction of the optimum, task "
    text += f"criterion unless noted, from the [leaderboard](/leaderboard.md).\n\n{payloads(entry.name)}\n"
    text += "## How it works\n\n"
    if entry.kind == "learned":
        text += f"Training: [{entry.name}](/training.md#{entry.name}).\n\n"
    text += f"Module: {{py:mod}}`{policy.__module__}`.\n\n"
    return (
        text
        + f"```{{eval-rst}}\n.. autoclass:: {policy.__module__}.{policy.__qualname__}\n   :no-index:\n```\n"
    )


def policy_class(entry: PolicyEntry) -> type:
    """The class of the policies that an entry makes, found without making one."""
    if isinstance(entry.factory, type):
        return entry.factory
    returned = get_type_hints(entry.factory)["return"]
    # The first of the classes for rigid robots and for those with springs.
    policy: type = next(iter(get_args(returned)), returned)
    return policy


def payloads(policy: str) -> str:
    """A table of a policy's payloads by condition and environment."""
    boards = [board for board in all_leaderboards() if policy in board.policies]
    rows = [["", *(f"`{board.env_id}`" for board in boards)]]
    entries: dict[str, dict[str, str]] = {}
    for board in boards:
        for title, column in zip(column_titles(board), board.columns, strict=True):
            entries.setdefault(title, {})[board.env_id] = entry_text(board, policy, column)
        entries.setdefault("median, p99 [ms], late, start [s]", {})[board.env_id] = timing_text(
            board.timings.get(policy)
        )
    for title, texts in entries.items():
        rows.append([title, *(texts.get(board.env_id, "–") for board in boards)])
    return markdown_table(rows)
