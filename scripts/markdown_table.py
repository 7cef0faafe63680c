"""Tables in Markdown, for the blocks of pages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def markdown_table(rows: Iterable[Sequence[str]], *, right: int = 0) -> str:
    """A table whose first row is its head.

    Args:
        rows: the rows.
        right: number of right-aligned columns, the last ones.
    """
    head, *body = rows
    rule = ["---"] * (len(head) - right) + ["---:"] * right
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, rule, *body))
