"""What policies carry: the leaderboard's results, read from where the benchmark writes them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from cablebot_gym.benchmark.leaderboard import read_results
from cablebot_gym.benchmark.scores import Board, Column, boards
from cablebot_gym.benchmark.tables import heading, motion_title, place

RESULTS = Path(__file__).parents[1] / "leaderboard" / "results.json"
MAPS = Path(__file__).parents[1] / "maps" / "results.json"


@cache
def all_boards() -> tuple[Board, ...]:
    """The leaderboard's tables."""
    return tuple(boards(read_results(RESULTS.read_text(encoding="utf-8"))[2]))


def env_rows(board: Board) -> list[list[str]]:
    """Head and rows of a table of policies, with links to their pages."""
    columns = _shown(board)
    rows = [["policy", *map(heading, columns)]]
    for policy in board.policies:
        rows.append([policy_link(policy), *(place(board, policy, column) for column in columns)])
    return rows


def policy_rows(policy: str) -> list[list[str]]:
    """Head and rows of a table of environments and motions, for one policy."""
    some = [board for board in all_boards() if policy in board.policies]
    columns = list(dict.fromkeys(column for board in some for column in _shown(board)))
    rows = [["id", "motion", *map(heading, columns)]]
    for board in some:
        rows.append(
            [env_link(board.env_id), motion_title(board), *(place(board, policy, column) for column in columns)]
        )
    return rows


def policy_link(name: str) -> str:
    """To a policy's page."""
    return f"[`{name}`](/generated/policies/{name}.md)"


def env_link(env_id: str) -> str:
    """To an environment's page."""
    return f"[`{env_id}`](/generated/environments/{env_id}.md)"


def _shown(board: Board) -> list[Column]:
    """Columns whose policies are told the payload, or nothing of it: the leaderboard has the others."""
    return [column for column in board.columns if column.information in ("told", "untold")]
