"""Tables of the stored leaderboard results."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from cablebot_gym.benchmark.leaderboard import read_results
from cablebot_gym.benchmark.scores import Column, Leaderboard, leaderboards
from cablebot_gym.benchmark.tables import entry_text, heading, motion_title

RESULTS = Path(__file__).parents[1] / "leaderboard" / "results.json"
MAPS = Path(__file__).parents[1] / "maps" / "results.json"


@cache
def all_leaderboards() -> tuple[Leaderboard, ...]:
    """The leaderboard's tables."""
    return tuple(leaderboards(read_results(RESULTS.read_text(encoding="utf-8"))[2]))


def env_rows(leaderboard: Leaderboard) -> list[list[str]]:
    """Head and rows of a table of policies, with links to their pages."""
    columns = _shown(leaderboard)
    rows = [["policy", *map(heading, columns)]]
    for policy in leaderboard.policies:
        rows.append([policy_link(policy), *(entry_text(leaderboard, policy, column) for column in columns)])
    return rows


def policy_rows(policy: str) -> list[list[str]]:
    """Head and rows of a table of environments and motions, for one policy."""
    some = [leaderboard for leaderboard in all_leaderboards() if policy in leaderboard.policies]
    columns = list(dict.fromkeys(column for leaderboard in some for column in _shown(leaderboard)))
    rows = [["id", "motion", *map(heading, columns)]]
    for leaderboard in some:
        rows.append(
            [
                env_link(leaderboard.env_id),
                motion_title(leaderboard),
                *(entry_text(leaderboard, policy, column) for column in columns),
            ]
        )
    return rows


def policy_link(name: str) -> str:
    """To a policy's page."""
    return f"[`{name}`](/generated/policies/{name}.md)"


def env_link(env_id: str) -> str:
    """To an environment's page."""
    return f"[`{env_id}`](/generated/environments/{env_id}.md)"


def _shown(leaderboard: Leaderboard) -> list[Column]:
    """Columns with payload known or unknown; the leaderboard has the others."""
    return [column for column in leaderboard.columns if column.model_payload_factor == 1.0]
