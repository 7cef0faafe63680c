"""What to say about a name that is none of those there are."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def no_such(kind: str, name: object, names: Iterable[str], otherwise: str = "") -> str:
    """The message about a name that nothing has: those that are valid, and the one that was probably meant.

    Args:
        kind: what is named, such as ``environment``.
        name: as it was given.
        names: the valid ones.
        otherwise: what could be given besides them, such as ``, or pass a Robot``.
    """
    known = {valid.lower(): valid for valid in names}
    close = get_close_matches(str(name).strip().lower(), known, 1)
    meant = f"; did you mean {known[close[0]]!r}?" if close else ""
    return f"unknown {kind} {name!r}; choose one of {', '.join(known.values())}{otherwise}{meant}"
